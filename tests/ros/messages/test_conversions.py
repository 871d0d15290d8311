"""Clouds to arrays and back."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from physkin_ros.messages.conversions import CLOUD_FIELDS, GarmentCloud, read_cloud  # noqa: E402


@pytest.mark.parametrize("frame_id", ["torso", "", "a_rather_long_name"])
def test_cloud_is_written_in_place(frame_id, published):
    """The view is the serialised message's data, in the layout readers expect, whatever the frame's name."""
    cloud = GarmentCloud(5, frame_id)
    assert not cloud.points.any()
    cloud.points[:] = np.arange(30).reshape(5, 6)
    message = deserialize_message(published(cloud, -3, 4), PointCloud2)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (-3, 4)
    assert (message.height, message.width, message.point_step, message.row_step) == (1, 5, 24, 120)
    assert message.is_dense and message.header.frame_id == frame_id
    assert [field.name for field in message.fields] == list(CLOUD_FIELDS)
    np.testing.assert_array_equal(read_cloud(message), cloud.points)
    np.testing.assert_array_equal(np.frombuffer(message.data, np.float32), np.arange(30))


def test_other_clouds_are_refused(published):
    """Fields in another order, and data shorter than stated."""
    message = deserialize_message(published(GarmentCloud(5, "torso"), 0, 0), PointCloud2)
    message.width = 6
    with pytest.raises(ValueError, match="120 bytes of data for 6 points"):
        read_cloud(message)
    message.fields = message.fields[::-1]
    with pytest.raises(ValueError, match="no garment cloud"):
        read_cloud(message)
