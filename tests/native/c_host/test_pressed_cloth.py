"""Whoever skins elsewhere shows the cloth that the evaluator shows, where an arm presses on it.

What keeps cloth out of the skin moves detail nodes, by more than the networks give. Offsets of a frame hold all of it.
"""

import ctypes

import numpy as np
import pytest
from native_library import OK
from skinned_mesh import mesh_of, opened_skinner, skinning_library

import physkin_core as physkin
from physkin_core.points.splat_draper import SplatSkinner, bind_splats
from physkin_core.runtime.evaluator import Skinner

FOREARM_ON_BELLY = {"upperarm01.L_x": -0.9, "upperarm01.L_z": -0.3, "lowerarm01.L_z": -1.8}


@pytest.fixture(scope="module")
def drapers():
    """Of the shipped T-shirt: as it is, and with no skin in its way."""
    model = physkin.load_garment_model("tshirt")
    avatar = physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig)
    worn, free = (physkin.Draper(model, avatar) for _ in range(2))
    free.outfit = free.outfit.with_bound_garment(0, free.layer.bound_visible.without_contact)
    return worn, free


def skinned(draper, nodes, offsets):
    out = np.empty((draper.layer.vertex_count, 6), dtype=np.float32)
    Skinner(draper.layer.bound_visible).skin(nodes, out, offsets)
    return out


def skinned_in_c(draper, nodes, offsets):
    c, bound = skinning_library(), draper.layer.bound_visible
    status, skinner = opened_skinner(c, mesh_of(bound, bound.faces))
    out = np.empty((len(bound.vertices), 6), dtype=np.float32)
    given = (each.ctypes.data_as(ctypes.c_void_p) for each in (nodes, offsets, out))
    assert status == OK == c.physkin_skin(skinner, *given, 6, 6), c.physkin_last_error()
    c.physkin_skinner_close(skinner)
    return out


def skinned_by_message(draper, nodes, offsets):
    messages = pytest.importorskip(
        "physkin_msgs.msg", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install"
    )
    from physkin_ros.client import GarmentSkin
    from physkin_ros.messages.conversions import garment_mesh

    frame = messages.GarmentNodes(revision=1, transforms=nodes.ravel(), detail_offsets=offsets.ravel())
    return GarmentSkin(garment_mesh(draper.outfit, 0, "base_link")).skin(frame)


def splat_centres(draper, nodes, offsets):
    vertices = draper.layer.model.garment.vertices
    splats = physkin.Splats(vertices, np.tile([0.0, 0, 0, 1], (len(vertices), 1)), np.full((len(vertices), 3), 0.004))
    return SplatSkinner(bind_splats(draper.layer, splats)).skin(nodes, offsets).centres


@pytest.mark.parametrize("reader", [skinned, skinned_in_c, skinned_by_message, splat_centres])
def test_readers_see_what_presses_on_cloth(reader, drapers):
    """Bit for bit; splats, whose places are found anew on the cloth, to 2 um. By what the networks alone give, cloth
    would be centimetres inside the arm."""
    worn, free = drapers
    cloud = worn.drape(FOREARM_ON_BELLY).copy()
    nodes, offsets = worn.node_transforms(), worn.detail_offsets()
    free.drape(FOREARM_ON_BELLY)
    pressed = np.linalg.norm(offsets - free.detail_offsets(), axis=1)
    assert pressed.max() > 0.01 and (pressed > 0.001).sum() > 40
    found = reader(worn, nodes, offsets)
    if reader is splat_centres:
        np.testing.assert_allclose(found, cloud[:, :3], atol=2e-6)
    else:
        np.testing.assert_array_equal(found, cloud)
    by_networks = reader(worn, nodes, free.detail_offsets())
    assert np.abs(by_networks - cloud[:, : by_networks.shape[1]])[:, :3].max() > 0.005
