"""Bodies that come and go, without ROS."""

from __future__ import annotations

from physkin_ros.node.body_discovery import PATIENCE, BodyDiscovery, body_publishers


def test_come_and_go():
    """A body is gone when it has been missing for a while, not at once."""
    discovery = BodyDiscovery(most=4)
    assert discovery.look({"ann": 1, "bob": 0}) == (["ann"], [])
    assert discovery.look({"ann": 1, "bob": 2}) == (["bob"], [])
    for _ in range(PATIENCE - 1):
        assert discovery.look({"bob": 1}) == ([], [])
    assert discovery.look({"ann": 1, "bob": 1}) == ([], [])
    for _ in range(PATIENCE - 1):
        discovery.look({"bob": 1})
    assert discovery.look({"bob": 1}) == ([], ["ann"])
    assert discovery.bodies == ("bob",)


def test_topics_of_the_graph():
    """Of the right name and type; their publishers are counted."""

    class Graph:
        def get_topic_names_and_types(self):
            joint_state = ["sensor_msgs/msg/JointState"]
            return [
                ("/humans/bodies/ann/joint_states", joint_state),
                ("/humans/bodies/bob/joint_states", ["std_msgs/msg/String"]),
                ("/humans/bodies/a/b/joint_states", joint_state),
                ("/humans/faces/eve/joint_states", joint_state),
            ]

        def count_publishers(self, topic):
            return len(topic)

    assert body_publishers(Graph()) == {"ann": len("/humans/bodies/ann/joint_states")}
