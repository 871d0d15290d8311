"""Garment nodes that come from elsewhere, skinned through the C interface: Python's bits, and what is refused."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest
from native_library import BAD_ARGUMENT, BAD_POSE, OK, options
from skinned_mesh import Mesh, mesh_of, opened_skinner, skinning_library

from physkin_core.runtime.evaluator import Skinner


@pytest.fixture(scope="module")
def c():
    return skinning_library()


@pytest.fixture
def garment(make_garment):
    return make_garment(np.random.default_rng(90), detail_nodes=17)


@pytest.fixture
def faces(garment):
    return np.random.default_rng(91).integers(0, len(garment.vertices), size=(90, 3)).astype(np.int32)


def node_frame(garment, rng):
    transforms = rng.normal(size=(len(garment.node_rest), 3, 4)).astype(np.float32)
    return transforms, rng.normal(size=(garment.detail_node_count, 3)).astype(np.float32)


@pytest.mark.parametrize("detail_nodes", [0, 17])
def test_vertices_are_those_of_python(detail_nodes, c, make_garment, faces):
    """Bit for bit, with normals and without, into rows at any distance; the mesh may be freed."""
    rng = np.random.default_rng(92)
    garment = make_garment(rng, detail_nodes=detail_nodes)
    transforms, offsets = node_frame(garment, rng)
    data = replace(garment, faces=faces)
    expected = np.empty((len(garment.vertices), 6), dtype=np.float32)
    Skinner(data).skin(transforms, expected, offsets)
    status, skinner = opened_skinner(c, mesh_of(garment, faces))
    assert status == OK, c.physkin_last_error()
    out = np.full((len(expected), 9), 7, dtype=np.float32)
    given = (transforms.ctypes.data, offsets.ctypes.data if offsets.size else None)
    assert c.physkin_skin(skinner, *given, out.ctypes.data, 6, 9) == OK, c.physkin_last_error()
    assert np.array_equal(out[:, :6], expected) and (out[:, 6:] == 7).all()
    assert c.physkin_skin(skinner, *given, out.ctypes.data, 3, 3) == OK
    assert np.array_equal(out.reshape(-1)[: expected[:, :3].size].reshape(-1, 3), expected[:, :3])
    c.physkin_skinner_close(skinner)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"size": 8}, b"mesh.size is 8"),
        ({"vertex_count": -1}, b"a count of the mesh is -1; none is negative"),
        ({"node_count": 2}, b"influence_nodes"),
        ({"detail_node_count": 2}, b"detail_nodes"),
        ({"detail_node_count": 2**31 - 1}, b"detail_node_count is 2147483647; allowed: 0 to"),
        ({"rest_normals": None}, b"an array of the mesh is null"),
        ({"detail_weights": None}, b"an array of the mesh is null"),
        ({"influences": 0}, b"at least one garment node, vertex and influence"),
    ],
)
def test_bad_meshes(changes, said, c, garment, faces):
    mesh = mesh_of(garment, faces, **{name: value for name, value in changes.items() if name != "size"})
    mesh.size = changes.get("size", mesh.size)
    status, skinner = opened_skinner(c, mesh)
    assert (status, skinner.value) == (BAD_ARGUMENT, None)
    assert said in c.physkin_last_error()


def test_bad_frames(c, garment, faces):
    """They write nothing."""
    transforms, offsets = node_frame(garment, np.random.default_rng(93))
    _, skinner = opened_skinner(c, mesh_of(garment, faces))
    out = np.full((len(garment.vertices), 6), 7, dtype=np.float32)
    assert c.physkin_skin(skinner, transforms.ctypes.data, None, out.ctypes.data, 6, 6) == BAD_ARGUMENT
    assert c.physkin_skin(skinner, transforms.ctypes.data, offsets.ctypes.data, out.ctypes.data, 4, 6) == BAD_ARGUMENT
    transforms[2, 0, 1] = np.nan
    assert c.physkin_skin(skinner, transforms.ctypes.data, offsets.ctypes.data, out.ctypes.data, 6, 6) == BAD_POSE
    assert b"node_transforms[25] is nan" in c.physkin_last_error() and (out == 7).all()
    transforms[2, 0, 1], offsets[3, 1] = 0.0, np.inf
    assert c.physkin_skin(skinner, transforms.ctypes.data, offsets.ctypes.data, out.ctypes.data, 6, 6) == BAD_POSE
    assert b"detail_offsets[10] is inf" in c.physkin_last_error() and (out == 7).all()
    c.physkin_skinner_close(skinner)
    c.physkin_skinner_close(None)
    assert opened_skinner(c, Mesh(size=ctypes.sizeof(Mesh)), options(precision=b"fp8"))[0] == BAD_ARGUMENT
