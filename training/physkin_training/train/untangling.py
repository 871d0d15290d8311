"""A force on cloth that goes through itself. Self-contact keeps cloth on the side of other cloth where it belongs; in a
fold, as in an armpit or behind a knee, nobody knows which side that is, and the curve in which its sides meet is made
shorter instead.

Dimensions: `B` samples, `n` garment vertices, `e` edges.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.model.garment import Garment
from physkin_training.contact.contours import faces_of_edges, shorter_curve
from physkin_training.contact.surface_queries import goes_through
from physkin_training.energies.energy import view
from physkin_training.quiet_warp import wp

__all__ = ["Untangling"]

wp.set_module_options({"enable_backward": False})

EVERY = 4
"""One sample in so many is looked at, and counts for all of them: looking takes longer than all energies."""
PRESSURE = 1000.0
"""[N/m2] on the vertices of an edge that goes through cloth: what skin does to cloth 0.15 mm deep in it."""


@wp.struct
class Sheet:
    """The cloth of every sample: edges (e,), third corners (e,) of their faces, or -1, and areas (n,) [m2]."""

    vertices: wp.int32
    edges: wp.array(dtype=wp.vec2i)
    opposite: wp.array(dtype=wp.vec2i)
    area: wp.array(dtype=wp.float32)


@wp.kernel
def untangle_kernel(
    mesh_id: wp.uint64, sheet: Sheet, pressure: wp.array(dtype=wp.float32), gradient: wp.array2d(dtype=wp.vec3)
):
    """One edge of one sample."""
    s, e = wp.tid()
    if pressure[s] == 0.0:
        return
    mesh = wp.mesh_get(mesh_id)
    first = s * sheet.vertices
    a, b = first + sheet.edges[e][0], first + sheet.edges[e][1]
    p, q = mesh.points[a], mesh.points[b]
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q), wp.max(p, q))
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        corners = wp.vec3i(mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2])
        apart = True
        for k in range(3):
            apart = apart and corners[k] != a and corners[k] != b
        if apart and goes_through(p, q, mesh.points[corners[0]], mesh.points[corners[1]], mesh.points[corners[2]]):
            edge, normal = wp.normalize(q - p), wp.mesh_eval_face_normal(mesh_id, face)
            towards = wp.vec3(0.0, 0.0, 0.0)
            for k in range(2):
                if sheet.opposite[e][k] >= 0:
                    towards += shorter_curve(p, edge, normal, mesh.points[first + sheet.opposite[e][k]])
            force = pressure[s] * sheet.area[a - first] * wp.normalize(towards)
            wp.atomic_add(gradient, s, a - first, -0.5 * force)
            wp.atomic_add(gradient, s, b - first, -0.5 * force)
            for k in range(3):
                wp.atomic_add(gradient, s, corners[k] - first, force / 3.0)


class Untangling:
    """Of drapes of a garment. offset: (B, 3) [m] that puts them apart in the mesh that they share, as of `PosedBodies`.
    `share` of the pressure, 0 to 1, may be changed in place."""

    def __init__(self, garment: Garment, offset: torch.Tensor) -> None:
        device, self._offset = offset.device, offset[::EVERY]
        self.share = torch.zeros((), device=device)
        looked_at, n = len(self._offset), len(garment.vertices)
        self._points = torch.tensor(garment.vertices, device=device, dtype=torch.float32) + self._offset[:, None]
        self._gradient = torch.zeros(looked_at, n, 3, device=device)
        self._device = wp.device_from_torch(device)
        faces = garment.faces + n * np.arange(looked_at)[:, None, None]
        self._mesh = wp.Mesh(
            view(self._points.view(-1, 3)), wp.array(faces.reshape(-1), dtype=wp.int32, device=self._device)
        )
        _, opposite = faces_of_edges(garment.faces, garment.face_edges, len(garment.edges))
        self._sheet = Sheet()
        self._sheet.vertices = n
        self._sheet.edges = wp.array(garment.edges, dtype=wp.vec2i, device=self._device)
        self._sheet.opposite = wp.array(opposite, dtype=wp.vec2i, device=self._device)
        self._sheet.area = wp.array(garment.vertex_areas, dtype=wp.float32, device=self._device)

    def __call__(self, vertices: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """What to descend [J] for the force's sake, a mean of samples as `PhysicsLosses` gives it, from drapes
        (B, n, 3) whose gradients are weighted by (B,). The number itself says nothing."""
        looked_at = vertices[::EVERY]
        self._points.copy_(looked_at.detach() + self._offset[:, None])
        self._mesh.refit()
        self._gradient.zero_()
        pressure = PRESSURE * EVERY * self.share * weight[::EVERY]
        given = [self._mesh.id, self._sheet, wp.from_torch(pressure), view(self._gradient)]
        wp.launch(untangle_kernel, (len(looked_at), len(self._sheet.edges)), given, device=self._device)
        return (self._gradient * looked_at).sum() / len(vertices)
