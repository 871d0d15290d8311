"""Joint states to joint positions, and clouds to arrays and back."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar
from physkin_ros.conversions import JointStateError, JointStateReader
from physkin_ros.joint_map import MappedJoint

NAMES = ("hip", "knee", "ankle", "neck")
REST = np.array([0.1, 0.2, 0.3, 0.4])


def positions(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float32)


def test_joints_in_any_order():
    """The order in the message does not matter."""
    read = JointStateReader(NAMES, REST).read(["neck", "hip", "ankle", "knee"], [4, 1, 3, 2])
    np.testing.assert_array_equal(read, positions(1, 2, 3, 4))


def test_missing_joints_keep_their_last_position():
    """At first that is the canonical rest, afterwards what was accepted last."""
    reader = JointStateReader(NAMES, REST)
    reader.positions = reader.read(["knee"], [2.0])
    np.testing.assert_array_equal(reader.positions, positions(0.1, 2, 0.3, 0.4))
    np.testing.assert_array_equal(reader.read(["hip"], [1.0]), positions(1, 2, 0.3, 0.4))


def test_unknown_joints_are_reported_once_for_each_set_of_names():
    """Two publishers that take turns on one topic are told apart by their names."""
    reported = []
    reader = JointStateReader(NAMES, REST, on_unknown=reported.append)
    for _ in range(3):
        np.testing.assert_array_equal(reader.read(["tail", "hip"], [9.0, 1.0]), positions(1, 0.2, 0.3, 0.4))
        reader.read(["hip", "left_ear", "right_ear"], [1.0, 2.0, 3.0])
    assert reported == [["tail"], ["left_ear", "right_ear"]]


def test_values_of_unknown_joints_do_not_matter():
    """A driver's NaN for a joint the garment does not read is no reason to stop."""
    read = JointStateReader(NAMES, REST).read(["gripper", "hip"], [np.nan, 1.0])
    np.testing.assert_array_equal(read, positions(1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize(
    ("names", "values", "reason"),
    [
        ([], [], "names no joints"),
        (["hip", "knee"], [1.0], "2 names but 1 positions"),
        (["hip"], [], "1 names but 0 positions"),
        (["hip", "knee"], [1.0, np.nan], "'knee' is nan"),
        (["hip", "knee"], [np.inf, 1.0], "'hip' is inf"),
        (["hip"], [1e300], "'hip' is 1e"),
        (["hip", "knee", "hip"], [1.0, 2.0, 3.0], "'hip' and 'hip' are the same joint"),
        (["tail", "fin"], [1.0, 2.0], "no joint is known among tail, fin"),
    ],
)
def test_bad_joint_states_are_refused(names, values, reason):
    """Each says what is wrong, every time it comes, and changes nothing."""
    reader = JointStateReader(NAMES, REST)
    for _ in range(2):
        with pytest.raises(JointStateError, match=reason):
            reader.read(names, values)
    np.testing.assert_array_equal(reader.positions, REST.astype(np.float32))


def test_joint_map_renames_and_scales():
    """Mapped names drive the rig's joints; the rig's own names go on working."""
    reader = JointStateReader(NAMES, REST, joint_map={"Knee_L": MappedJoint("knee", scale=-2.0, offset=0.5)})
    np.testing.assert_allclose(reader.read(["neck", "Knee_L"], [7.0, 1.0]), positions(0.1, -1.5, 0.3, 7))
    with pytest.raises(JointStateError, match="'knee' and 'Knee_L' are the same joint"):
        reader.read(["knee", "Knee_L"], [1.0, 1.0])


def test_cloud_is_written_in_place():
    """The view is the message's data, in the layout readers expect."""
    conversions = cloud_conversions()
    cloud = conversions.GarmentCloud(5, "torso")
    cloud.points[:] = np.arange(30).reshape(5, 6)
    message = cloud.message
    assert (message.height, message.width, message.point_step, message.row_step) == (1, 5, 24, 120)
    assert message.is_dense and message.header.frame_id == "torso"
    assert [field.name for field in message.fields] == list(conversions.CLOUD_FIELDS)
    np.testing.assert_array_equal(conversions.read_cloud(message), cloud.points)
    np.testing.assert_array_equal(np.frombuffer(message.data, np.float32), np.arange(30))


def test_other_clouds_are_refused():
    """Fields in another order, and data shorter than stated."""
    conversions = cloud_conversions()
    message = conversions.GarmentCloud(5, "torso").message
    message.width = 6
    with pytest.raises(ValueError, match="120 bytes of data for 6 points"):
        conversions.read_cloud(message)
    message.fields = message.fields[::-1]
    with pytest.raises(ValueError, match="no garment cloud"):
        conversions.read_cloud(message)


def test_description_of_a_point_set(garment_model):
    """It has no faces, whatever the garment's mesh has, and as many rest vertices as points."""
    pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")
    avatar, garment = load_avatar(BUNDLED_AVATAR, garment_model.rig), garment_model.garment
    points = garment.vertices[::7]
    for arguments, vertices, faces in (({}, garment.vertices, garment.faces), ({"points": points}, points, [])):
        draper = Draper(garment_model, avatar, **arguments)
        message = cloud_conversions().garment_description(draper, "torso")
        assert message.vertex_count == len(vertices)
        np.testing.assert_allclose(np.reshape(message.rest_vertices, (-1, 3)), vertices, atol=1e-6)
        np.testing.assert_array_equal(message.faces, np.ravel(faces))


def cloud_conversions():
    pytest.importorskip("sensor_msgs", reason="needs sensor_msgs: pip install 'physkin[ros]'")
    from physkin_ros import conversions

    return conversions
