"""A force on cloth that goes through itself. Self-contact keeps cloth on the side of other cloth where it belongs. In a
fold, as in an armpit or behind a knee, that side is not known, and the curve in which its sides meet is made shorter
instead.

Dimensions: `B` samples, `n` garment vertices, `e` edges.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from physkin_core.model.garment import Garment
from physkin_training.contact.contours import faces_of_edges, goes_through_face, way_out
from physkin_training.energies.energy import view
from physkin_training.quiet_warp import wp

__all__ = ["Untangling"]

wp.set_module_options({"enable_backward": False})

EVERY = 5
"""One sample in so many is looked at, and counts for all of them, as looking takes as long as all energies. A body has
8 or 16 samples, the last ones skinned for engines; so this is odd."""
PRESSURE = 1000.0
"""[N/m2] on the vertices of an edge that goes through cloth: what skin does to cloth 0.13 mm deep in it, and 500 times
the cloth's weight."""


@wp.struct
class Sheet:
    """The cloth of every sample: edges (e,), third corners (e,) of their faces, or -1, and areas (n,) [m2]."""

    vertices: wp.int32
    edges: wp.array(dtype=wp.vec2i)
    opposite: wp.array(dtype=wp.vec2i)
    area: wp.array(dtype=wp.float32)


@wp.kernel
def untangling_kernel(
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
        if apart and goes_through_face(mesh_id, p, q, face):
            opposite = sheet.opposite[e]
            for k in range(2):
                opposite[k] = wp.where(opposite[k] < 0, -1, first + opposite[k])
            force = pressure[s] * sheet.area[a - first] * way_out(mesh_id, p, q, face, opposite)
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
        order = cKDTree(garment.vertices[garment.edges].mean(axis=1)).indices  # threads look in the same places
        self._sheet = Sheet()
        self._sheet.vertices = n
        self._sheet.edges = wp.array(garment.edges[order], dtype=wp.vec2i, device=self._device)
        self._sheet.opposite = wp.array(opposite[order], dtype=wp.vec2i, device=self._device)
        self._sheet.area = wp.array(garment.vertex_areas, dtype=wp.float32, device=self._device)

    def __call__(self, vertices: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """A mean over samples whose gradient is the force's, from drapes (B, n, 3) with weights (B,). Its value means
        nothing, as this force has no energy."""
        looked_at = vertices[::EVERY]
        self._points.copy_(looked_at.detach() + self._offset[:, None])
        self._mesh.refit()
        self._gradient.zero_()
        pressure = PRESSURE * EVERY * self.share * weight[::EVERY]
        given = [self._mesh.id, self._sheet, wp.from_torch(pressure), view(self._gradient)]
        wp.launch(untangling_kernel, (len(looked_at), len(self._sheet.edges)), given, device=self._device)
        return (self._gradient * looked_at).sum() / len(vertices)
