"""What one sees that should not be seen on a dressed avatar at rest: openings that stand off, and holes.

Dimensions: `n` garment vertices, `V` body vertices, `f` body faces, `N` rays. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.body_parts import free_bones
from physkin_core.model.surface_paths import openings
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import signed_distance
from physkin_core.runtime.layer import Layer

__all__ = ["hole_percent", "stands_off_mm"]

MOSTLY = 90
"""Percentile of an opening's distances that counts: a waistband may stand off at the back alone."""
VIEWS = np.radians(np.arange(0, 360, 45))
"""Azimuths from which the figure is looked at."""
TILTS = np.radians((-20, 0, 20))
"""Elevations: under hems, straight, into collars."""
PIXEL = 0.008
"""[m] between lines of sight."""


def stands_off_mm(layer: Layer, cloth: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> float:
    """How much farther [mm] than on the body that it was made on the uppermost opening of a garment, collar or
    waistband, is from the skin. cloth: (n, 3) at rest, on a body (V, 3), (f, 3)."""
    garment, maker = layer.model.garment, load_body_model()
    loops = openings(garment.vertices, garment.faces)
    if not loops or layer.model.rig.bone_names != maker.rig.bone_names:
        return 0.0
    made_on = maker.vertices(maker.garment_body)
    usual = signed_distance(garment.vertices[loops[0]], made_on, maker.faces)
    here = signed_distance(cloth[loops[0]], body_vertices, body_faces)
    return 1000 * max(float(np.percentile(here, MOSTLY) - np.percentile(usual, MOSTLY)), 0.0)


def hole_percent(outfit: Outfit) -> float:
    """Of what is seen of a dressed figure at rest, without head, hands and feet, the share [%] that is the inside of
    its body: where skin is missing and no cloth is before it."""
    from point_cloud_utils import ray_mesh_intersection

    body, rest = outfit.body_to_draw, outfit.rig.rest
    surfaces = [(outfit.posed_body(rest), body.faces)]
    surfaces += [(cloth[:, :3], layer.faces) for cloth, layer in zip(outfit.drape(rest), outfit.layers)]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in surfaces]).astype(np.float64)
    faces = np.concatenate([faces + start for (_, faces), start in zip(surfaces, starts)]).astype(np.int64)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    skin = np.zeros(len(faces), dtype=bool)
    skin[: len(outfit.avatar.faces)] = ~_free_faces(outfit)
    inside = seen = 0
    for origins, way in _lines_of_sight(vertices):
        hit, _, _ = ray_mesh_intersection(vertices, faces, origins, np.tile(way, (len(origins), 1)))
        hit = hit[hit >= 0]
        seen += len(hit)
        inside += int((skin[hit] & (normals[hit] @ way > 0)).sum())
    return 100 * inside / max(seen, 1)


def _lines_of_sight(vertices: np.ndarray):
    """Origins (N, 3) and direction (3,) of parallel rays onto vertices (V, 3), of each view."""
    centre, reach = (vertices.min(axis=0) + vertices.max(axis=0)) / 2, np.ptp(vertices, axis=0).max()
    steps = np.arange(-reach / 2, reach / 2, PIXEL)
    for tilt in TILTS:
        for turn in VIEWS:
            away = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
            right = np.array([-np.sin(turn), np.cos(turn), 0.0])
            x, y = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps))
            yield centre + 2 * reach * away + x * right + y * np.cross(away, right), -away


def _free_faces(outfit: Outfit) -> np.ndarray:
    """(f,) bool, the body's faces on head, hands and feet."""
    avatar = outfit.avatar
    strongest = avatar.influence_weights.argmax(axis=1)[:, None]
    bones = np.take_along_axis(avatar.influence_bones, strongest, axis=1)[:, 0]
    return free_bones(outfit.rig)[bones][avatar.faces].any(axis=1)
