"""Waiting until the readers of a topic are known."""

from __future__ import annotations

import time

__all__ = ["wait_for_subscribers"]

DISCOVERY_SECONDS = 30.0
SETTLING_SECONDS = 0.5  # the reader may know of the writer a moment after the writer knows of the reader


def wait_for_subscribers(*publishers) -> None:
    """Wait until each publisher of a ROS node has a subscriber. Raises TimeoutError naming one that has none."""
    deadline = time.monotonic() + DISCOVERY_SECONDS
    while alone := [publisher.topic_name for publisher in publishers if not publisher.get_subscription_count()]:
        if time.monotonic() > deadline:
            raise TimeoutError(
                f"nobody has subscribed to {alone[0]} for {DISCOVERY_SECONDS:.0f} s; is the node running?"
            )
        time.sleep(0.02)
    time.sleep(SETTLING_SECONDS)
