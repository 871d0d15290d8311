"""Outfits in the plain C interface: one mesh of parts, as Python drapes them; what their file may hold."""

import ctypes
import re
from dataclasses import replace

import numpy as np
import pytest
from native_library import BAD_FILE, OK, c_library, load, step_moving

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.runtime.bound_file import save_bound_outfit


@pytest.fixture(scope="module")
def c():
    return c_library()


@pytest.fixture(scope="module")
def two_layers():
    """A T-shirt over trousers, all of it, on the bundled avatar."""
    models = [load_garment_model(name) for name in ("trousers", "tshirt")]
    return Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig), hide_covered=False)


@pytest.fixture(scope="module")
def stored(two_layers, tmp_path_factory):
    """The file of them."""
    path = tmp_path_factory.mktemp("outfit") / "outfit"
    two_layers.save_bound(path)
    return path.read_bytes()


def test_an_outfit_is_one_mesh_of_parts(c, two_layers, stored):
    """Python's bits, the order of layers among them, over a walk whose root moves."""
    assert len(two_layers.orders) == 1
    status, outfit = load(c, stored)
    assert status == OK, c.physkin_last_error()
    assert [c.physkin_part_name(outfit, k) for k in range(-1, 3)] == [None, b"trousers", b"tshirt", None]
    ranges = [ranges_of(c, outfit, part) for part in range(2)]
    inner, outer = two_layers.layers
    assert ranges[0] == [0, inner.vertex_count, 0, len(inner.faces)]
    assert ranges[1] == [inner.vertex_count, outer.vertex_count, len(inner.faces), len(outer.faces)]
    count = c.physkin_face_count(outfit)
    faces = np.ctypeslib.as_array(c.physkin_faces(outfit), shape=(count, 3))
    assert np.array_equal(faces, np.concatenate([inner.faces, outer.faces + inner.vertex_count]))
    with pytest.raises(AssertionError, match="part is 2; must be from 0 to 1"):
        ranges_of(c, outfit, 2)
    motion = load_motion("dance")
    out = np.empty((c.physkin_vertex_count(outfit), 6), dtype=np.float32)
    poses = motion.positions_for(two_layers.rig).astype(np.float32)[:60]
    for pose, time, root in zip(poses, motion.times, motion.root):
        assert step_moving(c, outfit, pose, time, root, out) == OK, c.physkin_last_error()
        assert np.array_equal(out, np.concatenate(two_layers.drape(pose, time=time, root=root)))
    c.physkin_close(outfit)


def ranges_of(c, outfit, part):
    """First vertex, vertices, first face, faces."""
    numbers = [ctypes.c_int32() for _ in range(4)]
    status = c.physkin_part_range(outfit, part, *map(ctypes.byref, numbers))
    assert status == OK, c.physkin_last_error()
    return [number.value for number in numbers]


@pytest.mark.parametrize(
    ("order", "heads", "message"),
    [
        (lambda o: {"steady": 2}, 0, "the file holds 2 for a layer of order 0; allowed: 0 to 1"),
        (lambda o: {"steady": 1}, 0, "layers 1 and 1 must be two of 2"),
        (lambda o: {"edge": np.nan}, 0, "edge of order 0 is nan m; must be above 0, below 1"),
        (lambda o: {"contact": np.r_[np.int32(-1), o.contact[1:]]}, 0, r"contact\[0\] is -1"),
        (lambda o: {}, 9, "garment 1 has another rig or body"),
    ],
)
def test_other_outfits_are_refused(order, heads, message, c, two_layers, tmp_path):
    bounds = [layer.bound_visible for layer in two_layers.layers]
    bounds[1] = replace(bounds[1], bone_heads=bounds[1].bone_heads + np.float32(heads))
    (first,) = two_layers.orders
    names = {"names": ["a", "b"], "joint_names": two_layers.joint_names, "fabrics": [["as bound"]] * 2}
    save_bound_outfit(bounds, tmp_path / "o", **names, orders=[replace(first, **order(first))])
    status, outfit = load(c, (tmp_path / "o").read_bytes())
    assert (status, outfit.value) == (BAD_FILE, None)
    assert re.search(message, c.physkin_last_error().decode()), c.physkin_last_error()


def test_matrices_on_steps_are_stored_in_bytes(stored):
    """Those of shipped models, to the bit, as the walk above shows: their file takes half, and 0.7 MB a garment for
    contact."""
    assert len(stored) < 1.2e7
