"""How much of the skin that a garment covers at rest shows in a pose: cloth that was torn off, or has sunk in.

Which skin that is, is read off the garment maker's body in the canonical pose; other bodies share its mesh.
Dimensions: `B` samples of a batch, `n` garment vertices, `f` body faces, `k` covered faces. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment import Garment, face_areas
from physkin_core.model.surface_paths import mesh_edges, path_lengths
from physkin_training.evaluate.body_overlap import OFF_SKIN, SkinPoints, faces_a_body
from physkin_training.physics.surface_queries import covering_faces
from physkin_training.quiet_warp import wp
from physkin_training.sampling.posed_bodies import PosedBodies

__all__ = ["SkinShows"]

COVER = wp.constant(0.1)
"""Cloth covers skin from at most this far [m] along the outward normal."""
HEM = wp.constant(0.03)
"""Width [m] of the strip along the edge of what is covered that is left out, and of the cloth that is its hem."""
HOLE = 0.015
"""Covered skin has no edge about a hole of less than this radius [m], as in an armpit, whose skin faces skin."""
SKIN_WITHIN = wp.constant(0.05)
"""Skin that has other skin before it within this distance [m], as in an armpit, is out of sight."""
CLOTH_WITHIN = wp.constant(0.5)
"""The nearest cloth is looked for up to this distance [m]."""


@wp.kernel
def shows_kernel(
    body: wp.uint64,
    faces_a_body: wp.int32,
    point_face: wp.array(dtype=wp.int32),
    point_place: wp.array(dtype=wp.vec2),
    overlapped: wp.array2d(dtype=wp.bool),
    cloth: wp.uint64,
    hem_distance: wp.array(dtype=wp.float32),
    shows: wp.array2d(dtype=wp.bool),
    in_sight: wp.array2d(dtype=wp.bool),
):
    """No cloth over a point of the skin, and the nearest cloth is not a hem; nor other skin."""
    s, k = wp.tid()
    shows[s, k] = False
    in_sight[s, k] = False
    if overlapped[s, k]:
        return
    face, place = s * faces_a_body + point_face[k], point_place[k]
    skin = wp.mesh_eval_position(body, face, place[0], place[1])
    outward = wp.mesh_eval_face_normal(body, face)
    if wp.mesh_query_ray(cloth, skin, outward, COVER).result:
        return
    distance = wp.float32(wp.inf)
    near = wp.mesh_query_point_no_sign(cloth, skin, CLOTH_WITHIN)
    if near.result:
        indices, n = wp.mesh_get(cloth).indices, hem_distance.shape[0]
        a, b, c = indices[3 * near.face] % n, indices[3 * near.face + 1] % n, indices[3 * near.face + 2] % n
        distance = near.u * hem_distance[a] + near.v * hem_distance[b] + (1.0 - near.u - near.v) * hem_distance[c]
    if distance > HEM:
        shows[s, k] = True
        in_sight[s, k] = not wp.mesh_query_ray(body, skin + OFF_SKIN * outward, outward, SKIN_WITHIN).result


class SkinShows:
    """Measures one garment on the bodies of `posed`, on their device.

    points: the centres of the covered faces, each standing for its face's area on the garment maker's body.
    """

    def __init__(self, garment: Garment, body_model: BodyModel, posed: PosedBodies) -> None:
        self._posed = posed
        body, samples, n = body_model.vertices(body_model.garment_body), len(posed.offset), len(garment.vertices)
        covered = covered_faces(garment, body, body_model.faces)
        self.points = SkinPoints.centres(covered, posed.device)
        areas = face_areas(body, body_model.faces)[covered]
        self._areas = torch.as_tensor(areas, dtype=torch.float32, device=posed.offset.device)
        edges, count = mesh_edges(garment.faces)
        hem = path_lengths(garment.vertices, garment.faces, np.unique(edges[count == 1]))
        self._hem_distance = wp.array(hem, dtype=wp.float32, device=posed.device)
        faces = garment.faces + n * np.arange(samples)[:, None, None]
        points = garment.vertices + posed.offset.cpu().numpy()[:, None]
        self._cloth = wp.Mesh(
            points=wp.array(points.reshape(-1, 3), dtype=wp.vec3, device=posed.device),
            indices=wp.array(faces.reshape(-1), dtype=wp.int32, device=posed.device),
        )

    def overlapped(self) -> torch.Tensor:
        """Which points another part of the body covers on the bodies posed last, (B, k) bool: they count for nothing,
        whatever the drape."""
        return self.points.overlapped(self._posed)

    def shows(self, vertices: torch.Tensor, overlapped: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Which points no cloth of drapes (B, n, 3) covers on the bodies posed last, and which of these are in sight,
        both (B, k) bool.

        A ray along the skin's outward normal meets none, and the nearest cloth is not its hem: a raised arm lifts one.
        In sight: the ray meets no other skin soon, as it does in an armpit or between thighs.
        """
        posed, shows, in_sight = self._posed, torch.zeros_like(overlapped), torch.zeros_like(overlapped)
        wp.to_torch(self._cloth.points).copy_((vertices.detach() + posed.offset[:, None]).view(-1, 3))
        self._cloth.refit()
        inputs = [posed.mesh.id, faces_a_body(posed), self.points.face, self.points.place, wp.from_torch(overlapped)]
        inputs += [self._cloth.id, self._hem_distance]
        outputs = [wp.from_torch(shows), wp.from_torch(in_sight)]
        wp.launch(shows_kernel, shows.shape, inputs, outputs, device=posed.device)
        return shows, in_sight

    def figures(self, vertices: torch.Tensor, overlapped: torch.Tensor) -> dict[str, torch.Tensor]:
        """`skin_shows_percent` and, of that, `skin_in_sight_percent`: shares (B,) of the covered skin, less what is
        overlapped; 0 where nothing is covered."""
        covered = ((~overlapped).float() @ self._areas).clamp_min(1e-12)
        shows, in_sight = (100 * (flags.float() @ self._areas) / covered for flags in self.shows(vertices, overlapped))
        return {"skin_shows_percent": shows, "skin_in_sight_percent": in_sight}


def covered_faces(garment: Garment, body: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces (k,) int32 of the body, its vertices (V, 3) and faces (f, 3), that the garment covers at rest, `HEM` away
    from the edge of what it covers."""
    corners = body[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    covered = covering_faces(corners.mean(axis=1), normals, garment.vertices, garment.faces, COVER) >= 0
    from_covered = path_lengths(body, faces, np.unique(faces[covered]))
    bare = from_covered[faces].max(axis=1) > HOLE
    from_bare = path_lengths(body, faces, np.unique(faces[bare]))
    return np.flatnonzero(covered & (from_bare[faces].mean(axis=1) > HOLE + HEM)).astype(np.int32)
