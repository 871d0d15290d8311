"""Skinning of the same garment in Warp, on one thread. Imported only where Warp is."""

from __future__ import annotations

import warp as wp

from physkin_bench.cases import SkinningCase

__all__ = ["warp_skinning"]


@wp.func
def blended(
    matrices: wp.array2d(dtype=wp.vec4),
    nodes: wp.array2d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.float32),
    v: int,
):
    """Rows of a vertex's blended matrix."""
    a, b, c = wp.vec4(), wp.vec4(), wp.vec4()
    for k in range(nodes.shape[1]):
        node, weight = nodes[v, k], weights[v, k]
        a += weight * matrices[node, 0]
        b += weight * matrices[node, 1]
        c += weight * matrices[node, 2]
    return a, b, c


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
    a, b, c = blended(matrices, nodes, weights, v)
    x, n = vertices[v], normals[v]
    point = wp.vec4(x[0], x[1], x[2], 1.0)
    first, second, third = wp.vec3(a[0], a[1], a[2]), wp.vec3(b[0], b[1], b[2]), wp.vec3(c[0], c[1], c[2])
    out[v, 0] = wp.vec3(wp.dot(a, point), wp.dot(b, point), wp.dot(c, point))
    turned = wp.vec3(
        wp.dot(wp.cross(second, third), n), wp.dot(wp.cross(third, first), n), wp.dot(wp.cross(first, second), n)
    )
    out[v, 1] = wp.normalize(turned)


@wp.kernel
def move_detail(
    offsets: wp.array2d(dtype=wp.float32), features: wp.array(dtype=wp.float32), moved: wp.array2d(dtype=wp.float32)
):
    """One number of the detail nodes' offsets (D, 3)."""
    row = wp.tid()
    total = wp.float32(0.0)
    for k in range(features.shape[0]):
        total += offsets[row, k] * features[k]
    moved[row // 3, row % 3] = total


@wp.kernel
def skin_folded_vertex(
    matrices: wp.array2d(dtype=wp.vec4),
    nodes: wp.array2d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.float32),
    vertices: wp.array(dtype=wp.vec3),
    detail_nodes: wp.array2d(dtype=wp.int32),
    detail_weights: wp.array2d(dtype=wp.float32),
    moved: wp.array2d(dtype=wp.float32),
    out: wp.array2d(dtype=wp.vec3),
):
    """Position of a vertex that detail nodes move before, and a normal of zero."""
    v = wp.tid()
    a, b, c = blended(matrices, nodes, weights, v)
    x = vertices[v]
    for k in range(detail_nodes.shape[1]):
        node = detail_nodes[v, k]
        x += detail_weights[v, k] * wp.vec3(moved[node, 0], moved[node, 1], moved[node, 2])
    point = wp.vec4(x[0], x[1], x[2], 1.0)
    out[v, 0] = wp.vec3(wp.dot(a, point), wp.dot(b, point), wp.dot(c, point))
    out[v, 1] = wp.vec3()


@wp.kernel
def add_face(faces: wp.array2d(dtype=wp.int32), out: wp.array2d(dtype=wp.vec3)):
    """A face's normal, as long as twice its area, to its corners'."""
    face = wp.tid()
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    normal = wp.cross(out[b, 0] - out[a, 0], out[c, 0] - out[a, 0])
    for k in range(3):
        wp.atomic_add(out, faces[face, k], 1, normal)


@wp.kernel
def normalise(out: wp.array2d(dtype=wp.vec3)):
    v = wp.tid()
    out[v, 1] = wp.normalize(out[v, 1])


def warp_skinning(case: SkinningCase):
    """Recorded launches on the CPU, and what gives their result."""
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    bound, launches = case.bound, []

    def array(values, kind):
        return wp.array(values, dtype=kind, device="cpu")

    def record(kernel, count, inputs, output):
        launches.append(wp.launch(kernel, count, inputs, outputs=[output], device="cpu", record_cmd=True))

    blend = [array(case.matrices, wp.vec4), array(bound.influence_nodes, wp.int32)]
    blend += [array(bound.influence_weights, wp.float32), array(bound.vertices, wp.vec3)]
    out = wp.empty((len(bound.vertices), 2), dtype=wp.vec3, device="cpu")
    if case.has_normals_of_faces:
        moved = wp.empty((len(bound.detail_offsets) // 3, 3), dtype=wp.float32, device="cpu")
        offsets = [array(bound.detail_offsets, wp.float32), array(case.features, wp.float32)]
        detail = [array(bound.detail_nodes, wp.int32), array(bound.detail_weights, wp.float32), moved]
        record(move_detail, len(bound.detail_offsets), offsets, moved)
        record(skin_folded_vertex, len(bound.vertices), blend + detail, out)
        record(add_face, len(bound.faces), [array(bound.faces, wp.int32)], out)
        record(normalise, len(bound.vertices), [], out)
    else:
        record(skin_vertex, len(bound.vertices), [*blend, array(bound.normals, wp.vec3)], out)
    if len(launches) == 1:
        return launches[0].launch, out.numpy

    def launch():
        for each in launches:
            each.launch()

    return launch, out.numpy
