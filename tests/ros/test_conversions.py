"""Clouds to arrays and back."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar


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
