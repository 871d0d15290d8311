"""Where a posed body is inside itself: there cloth between the two parts has nowhere to go.

Dimensions: `B` posed bodies, `n` garment vertices. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from physkin_training.posed_bodies import PosedBodies

__all__ = ["OFF_SKIN", "Seats", "winding"]

OFF_SKIN = 0.0002
"""How far outside [m] a point of the skin is looked at to tell whether it is inside the body."""
RAY = wp.constant(wp.vec3(0.9253, 0.3412, -0.1651))
"""Any direction that no edge is likely to have."""
MOST_CROSSINGS = wp.constant(64)


class Seats:
    """The skin that each vertex of a garment lies on at the canonical pose.

    face: (n,) int32, place: (n,) barycentric wp.vec2, of bodies that share a mesh.
    """

    def __init__(self, posed: PosedBodies, rest: np.ndarray) -> None:
        """posed: bodies of which the first stands in the canonical pose. rest: (n, 3) vertices on it."""
        self._device = posed.device
        self.face = wp.zeros(len(rest), dtype=wp.int32, device=self._device)
        self.place = wp.zeros(len(rest), dtype=wp.vec2, device=self._device)
        points = wp.array(np.ascontiguousarray(rest, dtype=np.float32), dtype=wp.vec3, device=self._device)
        inputs = [points, posed.mesh.id, wp.vec3(*posed.offset[0].tolist())]
        wp.launch(seat_kernel, len(rest), inputs, [self.face, self.place], device=self._device)

    def overlapped(self, posed: PosedBodies) -> np.ndarray:
        """Whether another part of its body covers each seat of the bodies posed last. Returns (B, n) bool."""
        samples = len(posed.offset)
        covered = wp.zeros((samples, len(self.face)), dtype=wp.bool, device=self._device)
        inputs = [posed.mesh.id, self.face, self.place, len(posed.mesh.indices) // 3 // samples]
        wp.launch(overlap_kernel, covered.shape, inputs, [covered], device=self._device)
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


@wp.kernel
def seat_kernel(
    x: wp.array(dtype=wp.vec3),
    mesh: wp.uint64,
    offset: wp.vec3,
    face: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec2),
):
    """The closest point of the first body of the mesh, as face and barycentric coordinates."""
    v = wp.tid()
    hit = wp.mesh_query_point_no_sign(mesh, x[v] + offset, 1.0)
    face[v] = hit.face
    place[v] = wp.vec2(hit.u, hit.v)


@wp.kernel
def overlap_kernel(
    mesh: wp.uint64,
    seat_face: wp.array(dtype=wp.int32),
    seat_place: wp.array(dtype=wp.vec2),
    faces_a_body: wp.int32,
    covered: wp.array2d(dtype=wp.bool),
):
    s, v = wp.tid()
    face = s * faces_a_body + seat_face[v]
    seat = wp.mesh_eval_position(mesh, face, seat_place[v][0], seat_place[v][1])
    covered[s, v] = winding(mesh, seat + OFF_SKIN * wp.mesh_eval_face_normal(mesh, face)) > 0
