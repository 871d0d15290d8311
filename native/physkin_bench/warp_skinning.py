"""Skinning of the same garment in Warp, on one thread.

Dimensions: `n` vertices, `m` garment nodes, `K` influences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from physkin_core.model.skinning import skin, skinning_matrices
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["SkinningCase", "skinning_case", "warp_skinning"]


@dataclass(frozen=True)
class SkinningCase:
    """Input and right answer. matrices: (m, 3, 4) float32, from rest to posed garment. expected: (n, 6) float64."""

    bound: BoundGarment
    matrices: np.ndarray
    expected: np.ndarray


def skinning_case(bound: BoundGarment, node_transforms: np.ndarray) -> SkinningCase:
    """The skinning of a bound garment by given garment nodes (m, 3, 4): positions and unit normals."""
    transforms = node_transforms.astype(np.float64)
    posed = skin(
        transforms, bound.node_rest, bound.vertices, bound.normals, bound.influence_nodes, bound.influence_weights
    )
    matrices = skinning_matrices(transforms, bound.node_rest).astype(np.float32)
    return SkinningCase(bound, matrices, np.concatenate(posed, axis=1))


@cache
def _kernel():
    import warp as wp

    def skin_vertex(matrices, nodes, weights, vertices, normals, out):
        v = wp.tid()
        a, b, c = wp.vec4(), wp.vec4(), wp.vec4()
        for k in range(nodes.shape[1]):
            node, weight = nodes[v, k], weights[v, k]
            a += weight * matrices[node, 0]
            b += weight * matrices[node, 1]
            c += weight * matrices[node, 2]
        x, n = vertices[v], normals[v]
        point = wp.vec4(x[0], x[1], x[2], 1.0)
        first, second, third = wp.vec3(a[0], a[1], a[2]), wp.vec3(b[0], b[1], b[2]), wp.vec3(c[0], c[1], c[2])
        out[v, 0] = wp.vec3(wp.dot(a, point), wp.dot(b, point), wp.dot(c, point))
        turned = wp.vec3(
            wp.dot(wp.cross(second, third), n), wp.dot(wp.cross(third, first), n), wp.dot(wp.cross(first, second), n)
        )
        out[v, 1] = wp.normalize(turned)

    # Types as objects: annotations are strings in this file, and Warp is imported only here.
    kinds = (wp.array2d(dtype=wp.vec4), wp.array2d(dtype=wp.int32), wp.array2d(dtype=wp.float32))
    kinds += (wp.array(dtype=wp.vec3), wp.array(dtype=wp.vec3), wp.array2d(dtype=wp.vec3))
    skin_vertex.__annotations__ = dict(zip(("matrices", "nodes", "weights", "vertices", "normals", "out"), kinds))
    return wp.kernel(skin_vertex)


def warp_skinning(case: SkinningCase):
    """A recorded launch on the CPU, and what gives its result."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    bound = case.bound
    kinds = (wp.vec4, wp.int32, wp.float32, wp.vec3, wp.vec3)
    arrays = (case.matrices, bound.influence_nodes, bound.influence_weights, bound.vertices, bound.normals)
    inputs = [wp.array(array, dtype=kind, device="cpu") for array, kind in zip(arrays, kinds)]
    out = wp.empty((len(bound.vertices), 2), dtype=wp.vec3, device="cpu")
    command = wp.launch(_kernel(), len(bound.vertices), inputs, outputs=[out], device="cpu", record_cmd=True)
    return command.launch, out.numpy
