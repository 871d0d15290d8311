"""The list of topics that usage text and reference are made of, against what a running node opens."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from physkin_ros.messages.topics import TOPICS  # noqa: E402

OWN = ("physkin_msgs", "sensor_msgs", "geometry_msgs", "visualization_msgs", "diagnostic_msgs")
"""Packages of our types; those of others (parameters, lifecycle, clock) every node of ROS has."""


@pytest.mark.parametrize("orientation", ["gravity", "imu"])
def test_every_topic_is_listed_with_its_type(orientation, running_node, model_path):
    """No more and no less, with all that parameters open."""
    wanted = {"model": str(model_path), "orientation": orientation, "marker": True, "separate_limbs": True}
    with running_node(wanted, connect=False) as node:
        opened = {("out", each.topic_name, named(each.msg_type)) for each in node.publishers}
        opened |= {("in", each.topic_name, named(each.msg_type)) for each in node.subscriptions}
    listed = {
        (topic.direction, resolved(topic.name), topic.type)
        for topic in TOPICS
        if topic.direction != "service"  # a node of their own has them
        and (not topic.needs.startswith("orientation") or topic.needs.endswith(orientation))
    }
    assert {each for each in opened if each[2].startswith(OWN)} == listed


def named(kind: type) -> str:
    """package/Type of a message or service class."""
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def resolved(name: str) -> str:
    """What a node of the default name makes of it."""
    return name.replace("~", "/drape_node") if name[0] in "~/" else f"/{name}"
