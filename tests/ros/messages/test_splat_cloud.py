"""Splats to messages and back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import Splats

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from physkin_ros.messages.splat_cloud import SplatCloud, read_splats, splat_attributes  # noqa: E402


@pytest.fixture
def sent(published):
    """Splats of any size from a tenth of a millimetre to a metre, and the message that they come to."""
    generator = np.random.default_rng(3)
    turns = Rotation.random(500, rng=generator).as_quat()
    splats = Splats(generator.normal(size=(500, 3)), turns, 10 ** generator.uniform(-4, 0, size=(500, 3)))
    cloud = SplatCloud(500, "hips")
    cloud.fill(splats)

    return splats, deserialize_message(published(cloud, 5, 6), PointCloud2)


def test_little_is_lost_of_28_bytes_each(sent):
    """Nothing of places, 0.1 % of scales, hundredths of a degree of rotations."""
    splats, message = sent
    assert (message.header.stamp.sec, message.header.frame_id, message.width) == (5, "hips", 500)
    assert len(message.data) == 500 * message.point_step == 500 * 28
    read = read_splats(message)
    np.testing.assert_array_equal(read.centres, splats.centres)
    np.testing.assert_allclose(read.scales, splats.scales, rtol=6e-4)
    apart = Rotation.from_quat(read.rotations).inv() * Rotation.from_quat(splats.rotations)
    assert np.degrees(apart.magnitude()).max() < 0.01


def test_what_is_no_splats_is_refused(sent):
    _, message = sent
    message.data = message.data[:-1]
    with pytest.raises(ValueError, match="13999 bytes; expected .* 14000 bytes"):
        read_splats(message)
    with pytest.raises(ValueError, match="no splats: fields"):
        read_splats(PointCloud2())


@pytest.mark.parametrize("order", ["<", ">"])
def test_look(order):
    """Columns of any type under their names, whatever the file's byte order."""
    records = np.zeros(7, dtype=[("x", f"{order}f4"), ("red", "u1"), ("f_dc_0", f"{order}f8")])[["red", "f_dc_0"]]
    records["red"], records["f_dc_0"] = range(7), np.arange(7) / 3
    message = deserialize_message(serialize_message(splat_attributes(records, "hips")), PointCloud2)
    fields = [(field.name, field.offset, field.datatype) for field in message.fields]
    assert fields == [("red", 0, 2), ("f_dc_0", 1, 8)] and message.point_step == 9
    read = np.frombuffer(message.data, dtype=[("red", "u1"), ("f_dc_0", "f8")])
    np.testing.assert_array_equal(read["f_dc_0"], np.arange(7) / 3)
    assert list(read["red"]) == list(range(7))
