"""Executors, and waiting: for something, while callbacks are served, and for readers."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException

__all__ = ["new_executor", "spin_until", "wait_for_subscribers"]

DISCOVERY_SECONDS = 30.0
SETTLING_SECONDS = 0.5  # the reader may know of the writer a moment after the writer knows of the reader


def new_executor(kind: Callable[..., Executor], context: Context) -> Executor:
    """An executor of a context. Raises ExternalShutdownException where a signal has ended that: rclpy's would then be
    half made, and say so when it is collected."""
    if not context.ok():
        raise ExternalShutdownException
    return kind(context=context)


def spin_until(executor: Executor, seconds: float, done: Callable[[], object]) -> bool:
    """Serve callbacks until `done()` or for `seconds`; whether it is done."""
    deadline = time.monotonic() + seconds
    while rclpy.ok() and not done() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    return bool(done())


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
