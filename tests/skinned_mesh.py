"""A `physkin_mesh` of physkin.h for tests, and the C library that skins by it."""

import ctypes

import numpy as np
from native_library import c_library

__all__ = ["Mesh", "mesh_of", "opened_skinner", "skinning_library"]

FLOATS, INDICES = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint32)
COUNTS = ("vertex_count", "face_count", "node_count", "influences")
COUNTS += ("detail_node_count", "detail_influences")
ARRAYS = {"faces": INDICES, "rest_vertices": FLOATS, "rest_normals": FLOATS, "node_rest": FLOATS}
ARRAYS |= {"influence_nodes": INDICES, "influence_weights": FLOATS}
ARRAYS |= {"detail_nodes": INDICES, "detail_weights": FLOATS}


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
    counts += (bound.detail_node_count, bound.detail_nodes.shape[1])
    numbers = dict(zip(COUNTS, counts)) | changes
    pointers = {
        name: given[name].ctypes.data_as(kind) if given[name].size else None
        for name, kind in ARRAYS.items()
        if name not in changes
    }
    mesh = Mesh(size=ctypes.sizeof(Mesh), **pointers | numbers)
    mesh.kept = given
    return mesh


def skinning_library():
    """The library, which is told what functions take."""
    loaded = c_library()
    loaded.physkin_skin.argtypes = [*[ctypes.c_void_p] * 4, ctypes.c_int32, ctypes.c_ssize_t]
    loaded.physkin_skinner_open.argtypes = [ctypes.c_void_p] * 3
    loaded.physkin_skinner_close.argtypes = [ctypes.c_void_p]
    return loaded


def opened_skinner(c, mesh, how=None):
    """Status and handle."""
    skinner = ctypes.c_void_p()
    status = c.physkin_skinner_open(
        ctypes.byref(mesh), None if how is None else ctypes.byref(how), ctypes.byref(skinner)
    )
    return status, skinner
