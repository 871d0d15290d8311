"""Skinning of the same garment in Warp, on one thread. Imported only where Warp is."""

from __future__ import annotations

import warp as wp

from physkin_bench.cases import SkinningCase

__all__ = ["warp_skinning"]


@wp.kernel
def skin_vertex(
    matrices: wp.array2d(dtype=wp.vec4),
    nodes: wp.array2d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.float32),
    vertices: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    out: wp.array2d(dtype=wp.vec3),
):
    """Position and unit normal of a vertex by its blended matrix and that one's cofactors."""
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


def warp_skinning(case: SkinningCase):
    """A recorded launch on the CPU, and what gives its result."""
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    bound = case.bound
    kinds = (wp.vec4, wp.int32, wp.float32, wp.vec3, wp.vec3)
    arrays = (case.matrices, bound.influence_nodes, bound.influence_weights, bound.vertices, bound.normals)
    inputs = [wp.array(array, dtype=kind, device="cpu") for array, kind in zip(arrays, kinds)]
    out = wp.empty((len(bound.vertices), 2), dtype=wp.vec3, device="cpu")
    command = wp.launch(skin_vertex, len(bound.vertices), inputs, outputs=[out], device="cpu", record_cmd=True)
    return command.launch, out.numpy
