"""Exact queries of a garment against a body and against itself, on the CPU.

Dimensions: `n` points, `f` faces, `e` edges. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_training.quiet_warp import wp

__all__ = [
    "FARTHEST",
    "BodySurface",
    "Closest",
    "closest_on_face",
    "covering_faces",
    "goes_through",
    "layers_near",
    "piercing_edges",
]

FARTHEST = 10.0
"""The body is looked for up to this distance [m]."""

wp.set_module_options({"enable_backward": False})


@wp.kernel
def closest_kernel(
    points: wp.array(dtype=wp.vec3),
    body: wp.uint64,
    farthest: wp.float32,
    distance: wp.array(dtype=wp.float32),
    outward: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=wp.int32),
    barycentric: wp.array(dtype=wp.vec3),
):
    """Signed distance, the direction in which it grows, and where on the body the closest point is."""
    i = wp.tid()
    hit = wp.mesh_query_point_sign_normal(body, points[i], farthest)
    face[i] = hit.face
    barycentric[i] = wp.vec3(hit.u, hit.v, 1.0 - hit.u - hit.v)
    gap = points[i] - wp.mesh_eval_position(body, hit.face, hit.u, hit.v)
    length = wp.length(gap)
    distance[i] = hit.sign * length
    out = wp.mesh_eval_face_normal(body, hit.face)
    if length > 1.0e-6:
        out = gap * (hit.sign / length)
    outward[i] = out


@wp.kernel
def met_kernel(
    points: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    mesh_id: wp.uint64,
    reach: wp.float32,
    side: wp.float32,
    face: wp.array(dtype=wp.int32),
    barycentric: wp.array(dtype=wp.vec3),
):
    """The first face that a ray meets within `reach`, if it is met from the wanted side, 1 outside or -1 inside; else
    -1."""
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh_id, points[i], directions[i], reach)
    face[i] = -1
    if hit.result and side * wp.dot(hit.normal, directions[i]) < 0.0:
        face[i] = hit.face
        barycentric[i] = wp.vec3(hit.u, hit.v, 1.0 - hit.u - hit.v)


@wp.func
def closest_on_face(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Barycentric coordinates of the closest point (Ericson 2005, *Real-time collision detection*, section 5.1.5)."""
    ab, ac, ap, bp, cp = b - a, c - a, p - a, p - b, p - c
    d1, d2, d3, d4, d5, d6 = (
        wp.dot(ab, ap),
        wp.dot(ac, ap),
        wp.dot(ab, bp),
        wp.dot(ac, bp),
        wp.dot(ab, cp),
        wp.dot(ac, cp),
    )
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return wp.vec3(1.0 - v, v, 0.0)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return wp.vec3(1.0 - w, 0.0, w)
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - w, w)
    return wp.vec3(va, vb, vc) / (va + vb + vc)


@wp.func
def goes_through(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Whether the edge from p to q crosses the face a, b, c (Moeller and Trumbore 1997)."""
    side1, side2 = b - a, c - a
    across = wp.cross(q - p, side2)
    volume = wp.dot(side1, across)
    if wp.abs(volume) <= 1.0e-16:
        return False
    turned = wp.cross(p - a, side1)
    u, v = wp.dot(p - a, across) / volume, wp.dot(q - p, turned) / volume
    along = wp.dot(side2, turned) / volume
    return u > 0.0 and v > 0.0 and u + v < 1.0 and along > 0.0 and along < 1.0


@wp.kernel
def piercing_kernel(
    mesh_id: wp.uint64,
    edges: wp.array2d(dtype=wp.int32),
    pierces: wp.array(dtype=wp.bool),
):
    """Whether an edge crosses a face that shares no vertex with it."""
    i = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    a, b = edges[i, 0], edges[i, 1]
    p, q = mesh.points[a], mesh.points[b]
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q), wp.max(p, q))
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        i0, i1, i2 = mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2]
        if i0 != a and i1 != a and i2 != a and i0 != b and i1 != b and i2 != b:
            if goes_through(p, q, mesh.points[i0], mesh.points[i1], mesh.points[i2]):
                pierces[i] = True


@wp.kernel
def layers_kernel(
    mesh_id: wp.uint64,
    reach: wp.float32,
    start: wp.float32,
    over: wp.array(dtype=wp.bool),
    under: wp.array(dtype=wp.bool),
):
    """Whether a ray from a face's centre, outwards and inwards, meets a nearly parallel face within `reach`."""
    i = wp.tid()
    centre = wp.mesh_eval_position(mesh_id, i, 1.0 / 3.0, 1.0 / 3.0)
    normal = wp.mesh_eval_face_normal(mesh_id, i)
    above = wp.mesh_query_ray(mesh_id, centre + normal * start, normal, reach - start)
    below = wp.mesh_query_ray(mesh_id, centre - normal * start, -normal, reach - start)
    over[i] = above.result and wp.abs(wp.dot(above.normal, normal)) > 0.7
    under[i] = below.result and wp.abs(wp.dot(below.normal, normal)) > 0.7


@dataclass(frozen=True)
class Closest:
    """Where points are: signed distance (n,) [m], negative inside; outward (n, 3) unit vectors of its growth; the
    closest point's face (n,) and barycentric coordinates (n, 3)."""

    distance: np.ndarray
    outward: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray


class BodySurface:
    """A body, or a garment: vertices (V, 3) [m], faces (f, 3) counter-clockwise seen from outside. A body is closed."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
        self.normals = vertex_normals(self.vertices, self.faces)
        self._mesh = _mesh(self.vertices, self.faces)

    def closest(self, points: np.ndarray) -> Closest:
        """The closest point of the body to each of points (n, 3)."""
        given = [_vectors(points), self._mesh.id, FARTHEST]
        return Closest(*_launched(closest_kernel, len(points), given, wp.float32, wp.vec3, wp.int32, wp.vec3))

    def facing(
        self, points: np.ndarray, directions: np.ndarray, reach: float, *, from_inside: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where rays from points (n, 3) along unit vectors (n, 3) first meet the body: faces (n,), -1 where they do not
        within `reach` [m] or come from inside, and barycentric coordinates (n, 3). from_inside: only rays that come
        from there."""
        given = [_vectors(points), _vectors(directions), self._mesh.id, reach, -1.0 if from_inside else 1.0]
        face, barycentric = _launched(met_kernel, len(points), given, wp.int32, wp.vec3)
        return face, barycentric

    def push_out(self, points: np.ndarray, clearance: float, *, iterations: int = 30, step: float = 0.02) -> np.ndarray:
        """`points` (n, 3), those closer than `clearance` [m] moved out, at most `step` [m] an iteration."""
        points = np.array(points, dtype=np.float64)
        for _ in range(iterations):
            closest = self.closest(points)
            if closest.distance.min() >= clearance:
                break
            # A micrometre more: single precision must not leave a point just short of the clearance.
            missing = np.where(closest.distance < clearance, clearance + 1e-6 - closest.distance, 0.0)
            points += closest.outward * np.minimum(missing, step)[:, None]
        return points


def piercing_edges(vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Which edges (e, 2) of a mesh cross one of its faces, (e,) bool. Touching does not count."""
    mesh = _mesh(vertices, faces)
    given = [mesh.id, wp.array(edges, dtype=wp.int32, device="cpu")]
    return _launched(piercing_kernel, len(edges), given, wp.bool)[0]


def layers_near(vertices: np.ndarray, faces: np.ndarray, reach: float) -> np.ndarray:
    """Which faces have another, nearly parallel one over them within `reach` [m], where their normals point, and which
    under them, (f, 2) bool."""
    mesh = _mesh(vertices, faces)
    return np.stack(_launched(layers_kernel, len(faces), [mesh.id, reach, 1e-5], wp.bool, wp.bool), axis=1)


def covering_faces(
    points: np.ndarray, directions: np.ndarray, vertices: np.ndarray, faces: np.ndarray, reach: float = FARTHEST
) -> np.ndarray:
    """The face of a garment that points (k, 3) of a body lie under, (k,) int32, or -1: a ray along the unit vector of
    each (k, 3) meets it first, from inside, within `reach` [m]. An arm beside a shirt meets the shirt from outside, and
    is not under it."""
    return BodySurface(vertices, faces).facing(points, directions, reach, from_inside=True)[0]


def _launched(kernel: wp.Kernel, count: int, given: list, *outputs: type) -> list[np.ndarray]:
    """What a kernel writes for each of so many elements, an array for each type."""
    written = [wp.zeros(count, dtype, device="cpu") for dtype in outputs]
    wp.launch(kernel, count, given, written, device="cpu")
    return [array.numpy().copy() for array in written]


def _vectors(points: np.ndarray) -> wp.array:
    return wp.array(np.asarray(points, dtype=np.float32), dtype=wp.vec3, device="cpu")


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> wp.Mesh:
    wp.init()
    corners = wp.array(np.asarray(faces, dtype=np.int32).reshape(-1), dtype=wp.int32, device="cpu")
    return wp.Mesh(_vectors(vertices), corners)
