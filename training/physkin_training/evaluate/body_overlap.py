"""Where a posed body is inside itself: there cloth between the two parts has nowhere to go.

Dimensions: `V` body vertices, `f` body faces, `B` posed bodies, `k` points of the skin, `n` garment vertices. Metres,
root frame.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_training.physics.surface_queries import BodySurface
from physkin_training.quiet_warp import wp
from physkin_training.sampling.posed_bodies import PosedBodies

__all__ = ["OFF_SKIN", "SkinPoints", "faces_a_body"]

OFF_SKIN = wp.constant(0.0002)
"""How far outside [m] the skin a ray from it begins, so that it does not meet its own face."""
RAY = wp.constant(wp.vec3(0.9253, 0.3412, -0.1651))
"""Any direction that no edge is likely to have."""
MOST_CROSSINGS = wp.constant(64)


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
def overlapped_kernel(
    mesh: wp.uint64,
    faces_a_body: wp.int32,
    point_face: wp.array(dtype=wp.int32),
    point_place: wp.array(dtype=wp.vec2),
    overlapped: wp.array2d(dtype=wp.bool),
):
    """Whether another part of its body covers a point of the skin of a sample."""
    s, k = wp.tid()
    face, place = s * faces_a_body + point_face[k], point_place[k]
    skin = wp.mesh_eval_position(mesh, face, place[0], place[1])
    overlapped[s, k] = winding(mesh, skin + OFF_SKIN * wp.mesh_eval_face_normal(mesh, face)) > 0


class SkinPoints:
    """Points of the skin, on every body that shares a mesh.

    face: (k,) int32, place: (k,) barycentric wp.vec2, on one device. Made of NumPy arrays, places (k, 2).
    """

    def __init__(self, face: np.ndarray, place: np.ndarray, device: wp.Device | str) -> None:
        self.face = wp.array(face, dtype=wp.int32, device=device)
        self.place = wp.array(np.ascontiguousarray(place, dtype=np.float32), dtype=wp.vec2, device=device)

    @classmethod
    def under(cls, vertices: np.ndarray, faces: np.ndarray, rest: np.ndarray) -> SkinPoints:
        """The seat of each vertex of a garment, on the CPU.

        vertices (V, 3), faces (f, 3): a body in the canonical pose. rest: (n, 3) the garment on it.
        """
        closest = BodySurface(vertices, faces).closest(rest)
        return cls(closest.face, closest.barycentric[:, :2], "cpu")

    @classmethod
    def centres(cls, face: np.ndarray, device: wp.Device | str) -> SkinPoints:
        """The centres of faces (k,) of a body."""
        return cls(face, np.full((len(face), 2), 1 / 3), device)

    def overlapped(self, posed: PosedBodies) -> torch.Tensor:
        """Whether another part of its body covers each point of the bodies posed last. Returns (B, k) bool."""
        samples = len(posed.offset)
        overlapped = torch.zeros(samples, len(self.face), dtype=torch.bool, device=posed.offset.device)
        inputs = [posed.mesh.id, faces_a_body(posed), self.face, self.place]
        outputs = [wp.from_torch(overlapped)]
        wp.launch(overlapped_kernel, overlapped.shape, inputs, outputs, device=posed.device)
        return overlapped


def faces_a_body(posed: PosedBodies) -> int:
    """Faces of one sample in the joint mesh."""
    return len(posed.mesh.indices) // 3 // len(posed.offset)
