"""Garment nodes that come from elsewhere, skinned through the C interface: Python's bits, and what is refused."""

import ctypes

import numpy as np
import pytest
from native_library import BAD_ARGUMENT, BAD_POSE, OK, c_library, options

from physkin_core.runtime.evaluator import PRECISIONS, Skinner

FLOATS, INDICES = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint32)
COUNTS = ("vertex_count", "face_count", "node_count", "influences")
COUNTS += ("feature_count", "detail_node_count", "detail_influences")
ARRAYS = {"faces": INDICES, "rest_vertices": FLOATS, "rest_normals": FLOATS, "node_rest": FLOATS}
ARRAYS |= {"influence_nodes": INDICES, "influence_weights": FLOATS}
ARRAYS |= {"detail_nodes": INDICES, "detail_weights": FLOATS, "detail_offsets": FLOATS}


class Mesh(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_uint32),
        *((name, ctypes.c_int32) for name in COUNTS),
        *ARRAYS.items(),
    ]


def mesh_of(bound, faces, **changes):
    """What a node would publish of a garment, with other counts or arrays; it must outlive the call."""
    given = {"faces": faces.astype(np.uint32), "rest_vertices": bound.vertices, "rest_normals": bound.normals}
    given |= {name: getattr(bound, name) for name in ARRAYS if name not in given}
    counts = (len(bound.vertices), len(faces), len(bound.node_rest), bound.influence_nodes.shape[1])
    counts += (bound.detail_offsets.shape[1], len(bound.detail_offsets) // 3, bound.detail_nodes.shape[1])
    numbers = dict(zip(COUNTS, counts)) | changes
    pointers = {
        name: given[name].ctypes.data_as(kind) if given[name].size else None
        for name, kind in ARRAYS.items()
        if name not in changes
    }
    mesh = Mesh(size=ctypes.sizeof(Mesh), **pointers | numbers)
    mesh.kept = given
    return mesh


@pytest.fixture(scope="module")
def c():
    loaded = c_library()
    loaded.physkin_skin.argtypes = [*[ctypes.c_void_p] * 4, ctypes.c_int32, ctypes.c_ssize_t]
    loaded.physkin_skinner_open.argtypes = [ctypes.c_void_p] * 3
    loaded.physkin_skinner_close.argtypes = [ctypes.c_void_p]
    return loaded


def opened(c, mesh, how=None):
    skinner = ctypes.c_void_p()
    status = c.physkin_skinner_open(
        ctypes.byref(mesh), None if how is None else ctypes.byref(how), ctypes.byref(skinner)
    )
    return status, skinner


@pytest.fixture
def garment(make_garment):
    return make_garment(np.random.default_rng(90), detail_nodes=17)


@pytest.fixture
def faces(garment):
    return np.random.default_rng(91).integers(0, len(garment.vertices), size=(90, 3)).astype(np.int32)


def node_frame(garment, rng):
    transforms = rng.normal(size=(len(garment.node_rest), 3, 4)).astype(np.float32)
    return transforms, rng.normal(size=garment.detail_offsets.shape[1]).astype(np.float32)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("detail_nodes", [0, 17])
def test_vertices_are_those_of_python(detail_nodes, precision, c, make_garment, faces):
    """Bit for bit, with normals and without, into rows at any distance; the mesh may be freed."""
    rng = np.random.default_rng(92)
    garment = make_garment(rng, detail_nodes=detail_nodes)
    transforms, features = node_frame(garment, rng)
    data = type(garment)(**{**garment.__dict__, "faces": faces})
    expected = np.empty((len(garment.vertices), 6), dtype=np.float32)
    Skinner(data, precision=precision).skin(transforms, expected, features)
    status, skinner = opened(c, mesh_of(garment, faces), options(precision=precision.encode()))
    assert status == OK, c.physkin_last_error()
    out = np.full((len(expected), 9), 7, dtype=np.float32)
    given = (transforms.ctypes.data, features.ctypes.data if features.size else None)
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
        ({"rest_normals": None}, b"an array of the mesh is null"),
        ({"detail_offsets": None}, b"an array of the mesh is null"),
        ({"influences": 0}, b"at least one garment node, vertex and influence"),
    ],
)
def test_bad_meshes(changes, said, c, garment, faces):
    mesh = mesh_of(garment, faces, **{name: value for name, value in changes.items() if name != "size"})
    mesh.size = changes.get("size", mesh.size)
    status, skinner = opened(c, mesh)
    assert (status, skinner.value) == (BAD_ARGUMENT, None)
    assert said in c.physkin_last_error()


def test_bad_frames(c, garment, faces):
    """They write nothing."""
    transforms, features = node_frame(garment, np.random.default_rng(93))
    _, skinner = opened(c, mesh_of(garment, faces))
    out = np.full((len(garment.vertices), 6), 7, dtype=np.float32)
    assert c.physkin_skin(skinner, transforms.ctypes.data, None, out.ctypes.data, 6, 6) == BAD_ARGUMENT
    assert c.physkin_skin(skinner, transforms.ctypes.data, features.ctypes.data, out.ctypes.data, 4, 6) == BAD_ARGUMENT
    transforms[2, 0, 1] = np.nan
    assert c.physkin_skin(skinner, transforms.ctypes.data, features.ctypes.data, out.ctypes.data, 6, 6) == BAD_POSE
    assert b"node_transforms[25] is nan" in c.physkin_last_error() and (out == 7).all()
    c.physkin_skinner_close(skinner)
    c.physkin_skinner_close(None)
    assert opened(c, Mesh(size=ctypes.sizeof(Mesh)), options(precision=b"fp8"))[0] == BAD_ARGUMENT
