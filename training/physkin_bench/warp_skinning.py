"""Skinning of the same garment in Warp, on one thread, with normals of its faces. Imported only where Warp is."""

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
    detail_nodes: wp.array2d(dtype=wp.int32),
    detail_weights: wp.array2d(dtype=wp.float32),
    moved: wp.array2d(dtype=wp.float32),
    out: wp.array2d(dtype=wp.vec3),
):
    """Position of a vertex, which detail nodes move before it is skinned, and a normal of zero."""
    v = wp.tid()
    a, b, c = wp.vec4(), wp.vec4(), wp.vec4()
    for k in range(nodes.shape[1]):
        node, weight = nodes[v, k], weights[v, k]
        a += weight * matrices[node, 0]
        b += weight * matrices[node, 1]
        c += weight * matrices[node, 2]
    x = vertices[v]
    for k in range(detail_nodes.shape[1]):
        detail = detail_nodes[v, k]
        x += detail_weights[v, k] * wp.vec3(moved[detail, 0], moved[detail, 1], moved[detail, 2])
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

    inputs = [array(case.matrices, wp.vec4), array(bound.influence_nodes, wp.int32)]
    inputs += [array(bound.influence_weights, wp.float32), array(bound.vertices, wp.vec3)]
    inputs += [array(bound.detail_nodes, wp.int32), array(bound.detail_weights, wp.float32)]
    out = wp.empty((len(bound.vertices), 2), dtype=wp.vec3, device="cpu")
    record(skin_vertex, len(bound.vertices), [*inputs, array(case.detail_offsets, wp.float32)], out)
    record(add_face, len(bound.faces), [array(bound.faces, wp.int32)], out)
    record(normalise, len(bound.vertices), [], out)

    def launch():
        for each in launches:
            each.launch()

    return launch, out.numpy
