"""Which garment vertices are inside the body by its nearest *vertex*, as GAPS counts them (Chen et al. 2024).

Coarser than the signed distance to the exact closest point: it depends on the body's triangulation. To compare only.
Dimensions: `B` samples, `n` garment vertices, `V` body vertices. Metres, root frame.
"""

from __future__ import annotations

import torch
import warp as wp

from physkin_training.physics.area_normals import area_normals
from physkin_training.sampling.posed_bodies import PosedBodies

__all__ = ["inside_by_vertex"]


@wp.kernel
def inside_by_vertex_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body: wp.uint64,
    body_offset: wp.array(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    reach: wp.float32,
    inside: wp.array2d(dtype=wp.bool),
):
    """The nearest body vertex is no farther than the nearest corner of the closest face: all faces that touch a box of
    that size are searched, which is exact."""
    s, v = wp.tid()
    point = x[s, v] + body_offset[s]
    inside[s, v] = False
    hit = wp.mesh_query_point_no_sign(body, point, reach)
    if hit.result:
        mesh = wp.mesh_get(body)
        nearest = mesh.indices[3 * hit.face]
        least = wp.length(point - mesh.points[nearest])
        box = wp.vec3(least, least, least)
        query = wp.mesh_query_aabb(body, point - box, point + box)
        face = wp.int32(0)
        while wp.mesh_query_aabb_next(query, face):
            for k in range(3):
                corner = mesh.indices[3 * face + k]
                gap = wp.length(point - mesh.points[corner])
                if gap < least:
                    least = gap
                    nearest = corner
        outward = normals[s, nearest - s * normals.shape[1]]
        inside[s, v] = wp.dot(point - mesh.points[nearest], outward) < 0.0


def inside_by_vertex(vertices: torch.Tensor, posed: PosedBodies, *, reach: float) -> torch.Tensor:
    """Which of garment vertices (B, n, 3) are behind the nearest vertex of the bodies posed last, by its area-weighted
    normal.

    reach: vertices farther than that from the body [m] count as outside. Returns (B, n) bool.
    """
    samples, n, _ = vertices.shape
    points = wp.to_torch(posed.mesh.points).view(samples, -1, 3)
    normals = area_normals(points, posed.bodies.faces)
    inside = torch.zeros(samples, n, dtype=torch.bool, device=vertices.device)
    wp.launch(
        inside_by_vertex_kernel,
        dim=(samples, n),
        inputs=[
            wp.from_torch(vertices.detach().contiguous(), dtype=wp.vec3),
            posed.mesh.id,
            wp.from_torch(posed.offset, dtype=wp.vec3),
            wp.from_torch(normals, dtype=wp.vec3),
            reach,
        ],
        outputs=[wp.from_torch(inside)],
        device=posed.device,
    )
    return inside
