"""ROS4HRI bodies (REP-155) as they come and go: found by their joint-state topics, without hri_msgs."""

from __future__ import annotations

import re
from collections.abc import Mapping

__all__ = ["BodyDiscovery", "body_publishers"]

TOPIC = re.compile(r"/humans/bodies/([A-Za-z_][A-Za-z0-9_]*)/joint_states")
JOINT_STATE = "sensor_msgs/msg/JointState"
PATIENCE = 3
"""Looks in a row that a body must be missing for before it is gone: a publisher may only be restarting."""


class BodyDiscovery:
    """Compares each look at the ROS graph with the last. most: bodies that are dressed at a time, first come first."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._missed: dict[str, int] = {}
        self.waiting: frozenset[str] = frozenset()

    @property
    def bodies(self) -> tuple[str, ...]:
        """Ids of the bodies that are there."""
        return tuple(self._missed)

    def look(self, publishers: Mapping[str, int]) -> tuple[list[str], list[str]]:
        """Ids of bodies that came and of those that went. publishers: number of them by body id."""
        seen = {body for body, count in publishers.items() if count}
        went = []
        for body in list(self._missed):
            self._missed[body] = 0 if body in seen else self._missed[body] + 1
            if self._missed[body] >= PATIENCE:
                del self._missed[body]
                went.append(body)
        new = sorted(seen - self._missed.keys())
        came = new[: self._most - len(self._missed)]
        self.waiting = frozenset(new[len(came) :])
        self._missed |= dict.fromkeys(came, 0)
        return came, went


def body_publishers(node) -> dict[str, int]:
    """Number of publishers of joint states by body id, as the ROS graph has them now."""
    found = {}
    for topic, types in node.get_topic_names_and_types():
        if (match := TOPIC.fullmatch(topic)) and JOINT_STATE in types:
            found[match[1]] = node.count_publishers(topic)
    return found
