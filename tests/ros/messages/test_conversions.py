"""Clouds to arrays and back."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar


@pytest.mark.parametrize("frame_id", ["torso", "", "a_rather_long_name"])
def test_cloud_is_written_in_place(frame_id):
    """The view is the serialised message's data, in the layout readers expect, whatever the frame's name."""
    conversions = cloud_conversions()
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import PointCloud2

    cloud = conversions.GarmentCloud(5, frame_id)
    assert not cloud.points.any()
    cloud.points[:] = np.arange(30).reshape(5, 6)
    message = deserialize_message(cloud.stamped(-3, 4), PointCloud2)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (-3, 4)
    assert (message.height, message.width, message.point_step, message.row_step) == (1, 5, 24, 120)
    assert message.is_dense and message.header.frame_id == frame_id
    assert [field.name for field in message.fields] == list(conversions.CLOUD_FIELDS)
    np.testing.assert_array_equal(conversions.read_cloud(message), cloud.points)
    np.testing.assert_array_equal(np.frombuffer(message.data, np.float32), np.arange(30))


def test_other_clouds_are_refused():
    """Fields in another order, and data shorter than stated."""
    conversions = cloud_conversions()
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import PointCloud2

    message = deserialize_message(conversions.GarmentCloud(5, "torso").stamped(0, 0), PointCloud2)
    message.width = 6
    with pytest.raises(ValueError, match="120 bytes of data for 6 points"):
        conversions.read_cloud(message)
    message.fields = message.fields[::-1]
    with pytest.raises(ValueError, match="no garment cloud"):
        conversions.read_cloud(message)


def test_mesh_of_a_point_set(garment_model):
    """It has no faces, whatever the garment's mesh has, and as many rest vertices as points."""
    pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")
    avatar, garment = load_avatar(BUNDLED_AVATAR, garment_model.rig), garment_model.garment
    points = garment.vertices[::7]
    for arguments, vertices, faces in (({}, garment.vertices, garment.faces), ({"points": points}, points, [])):
        draper = Draper(garment_model, avatar, **arguments)
        message = cloud_conversions().garment_mesh(draper, "torso")
        assert message.vertex_count == len(vertices)
        np.testing.assert_allclose(np.reshape(message.rest_vertices, (-1, 3)), vertices, atol=1e-6)
        np.testing.assert_array_equal(message.faces, np.ravel(faces))


def test_marker_has_a_corner_for_every_face_corner():
    """In the cloud's positions, faces one after another."""
    conversions = cloud_conversions()
    from rclpy.serialization import deserialize_message
    from visualization_msgs.msg import Marker

    marker = conversions.TriangleMarker(np.array([[0, 1, 2], [2, 1, 3]]), "torso", "alice/top")
    points = np.arange(24, dtype=np.float32).reshape(4, 6)
    message = deserialize_message(marker.stamped(points, 5, 6), Marker)
    corners = [(point.x, point.y, point.z) for point in message.points]
    assert corners == [(6.0 * k, 6.0 * k + 1, 6.0 * k + 2) for k in (0, 1, 2, 2, 1, 3)]
    assert (message.type, message.ns, message.header.frame_id) == (Marker.TRIANGLE_LIST, "alice/top", "torso")
    assert message.color.a == 1.0 and message.pose.orientation.w == 1.0 and message.header.stamp.nanosec == 6


def cloud_conversions():
    pytest.importorskip("sensor_msgs", reason="needs sensor_msgs: pip install 'physkin[ros]'")
    from physkin_ros.messages import conversions

    return conversions
