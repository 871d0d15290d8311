"""Where a posed body is inside itself: there cloth between the two parts has nowhere to go. On the CPU.

Dimensions: `V` body vertices, `f` body faces, `B` posed bodies, `n` garment vertices. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from physkin_training.physics.surface_queries import BodySurface
from physkin_training.sampling.posed_bodies import PosedBodies

__all__ = ["Seats"]

OFF_SKIN = 0.0002
"""How far outside [m] a point of the skin is looked at to tell whether it is inside the body."""
RAY = wp.constant(wp.vec3(0.9253, 0.3412, -0.1651))
"""Any direction that no edge is likely to have."""
MOST_CROSSINGS = wp.constant(64)


class Seats:
    """The skin that each vertex of a garment lies on at the canonical pose.

    face: (n,) int32, place: (n,) barycentric wp.vec2; they hold on every body that shares the mesh.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, rest: np.ndarray) -> None:
        """vertices (V, 3), faces (f, 3): a body in the canonical pose. rest: (n, 3) the garment on it."""
        closest = BodySurface(vertices, faces).closest(rest)
        self.face = wp.array(closest.face, dtype=wp.int32, device="cpu")
        self.place = wp.array(np.ascontiguousarray(closest.barycentric[:, :2]), dtype=wp.vec2, device="cpu")

    def covered(self, posed: PosedBodies) -> np.ndarray:
        """Whether another part of its body covers each seat of the bodies posed last. Returns (B, n) bool."""
        samples = len(posed.offset)
        covered = wp.zeros((samples, len(self.face)), dtype=wp.bool, device="cpu")
        inputs = [posed.mesh.id, self.face, self.place, len(posed.mesh.indices) // 3 // samples]
        wp.launch(covered_kernel, covered.shape, inputs, [covered], device="cpu")
        return covered.numpy()


@wp.func
def winding(mesh: wp.uint64, point: wp.vec3):
    """How many parts of the body a point is inside of: crossings outwards less crossings inwards along a ray."""
    crossings = wp.int32(0)
    start = point
    for _ in range(MOST_CROSSINGS):
        hit = wp.mesh_query_ray(mesh, start, RAY, 2.9)
        if not hit.result:
            break
        crossings += wp.where(wp.dot(hit.normal, RAY) > 0.0, 1, -1)
        start += (hit.t + 1.0e-6) * RAY
    return crossings


@wp.func
def is_covered(mesh: wp.uint64, face: wp.int32, place: wp.vec2):
    """Whether a place of the skin is inside the body."""
    seat = wp.mesh_eval_position(mesh, face, place[0], place[1])
    return winding(mesh, seat + OFF_SKIN * wp.mesh_eval_face_normal(mesh, face)) > 0


@wp.kernel
def covered_kernel(
    mesh: wp.uint64,
    seat_face: wp.array(dtype=wp.int32),
    seat_place: wp.array(dtype=wp.vec2),
    faces_a_body: wp.int32,
    covered: wp.array2d(dtype=wp.bool),
):
    s, v = wp.tid()
    covered[s, v] = is_covered(mesh, s * faces_a_body + seat_face[v], seat_place[v])
