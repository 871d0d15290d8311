"""The flat rest shape of cloth: where its faces lie on the panels that it was cut from.

A garment rests as its mesh lies, or as its panels lie in the plane. Either way a face's rest edges are a matrix whose
columns are the edges to its second and third corner, in the plane of the face of the mesh, the first axis along the
first edge there; flat cloth is laid on that as it fits best.
Dimensions: `n` vertices, `f` faces, `t` places on the flat cloth. Metres.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "flat_areas",
    "flat_edges",
    "graded",
    "panel_fault",
    "panels_of_texture",
    "rest_areas",
    "rest_edges",
    "side_lengths",
    "turned_edges",
]

SMALLEST_AREA = 1e-12
"""[m2] of a face."""
MOST_STRETCHED = 3.0
"""A face's area in the mesh and on the flat cloth differ by this factor at most: a gather's."""
IN_METRES = 0.8, 1.25
"""Median length of edges on the flat cloth, in times that in the mesh, where texture coordinates are in metres."""
FINEST = 7
"""Digits [m] in which texture coordinates of one vertex are told apart."""
ALIKE, SHARE_ALIKE = 2.0, 0.95
"""So many faces of such a texture differ in area by this factor at most."""


def rest_edges(corners: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Edges (f, 2, 2) [m] of faces with corners (f, 3, 2) or (f, 3, 3) and areas (f,), the first along the first
    axis."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    edges = np.zeros((len(corners), 2, 2))
    edges[:, 0, 0], edges[:, 0, 1], edges[:, 1, 1] = length, (first * second).sum(axis=1) / length, 2 * areas / length
    return edges


def rest_areas(edges: np.ndarray) -> np.ndarray:
    """Areas (f,) [m2] of rest edges (f, 2, 2)."""
    return (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2


def flat_edges(corners: np.ndarray) -> np.ndarray:
    """Rest edges (f, 2, 2) [m] of flat cloth with corners (f, 3, 2)."""
    return rest_edges(corners, np.abs(flat_areas(corners)))


def turned_edges(flat: np.ndarray, lying: np.ndarray) -> np.ndarray:
    """Rest edges (f, 2, 2) [m] of flat cloth, each face turned as it fits best on that of the mesh, whose rest edges as
    it lies are `lying` (f, 2, 2): by the rotation in what deforms one into the other."""
    deformation = lying @ np.linalg.inv(flat)
    angle = np.arctan2(deformation[:, 1, 0] - deformation[:, 0, 1], deformation[:, 0, 0] + deformation[:, 1, 1])
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1) @ flat


def side_lengths(edges: np.ndarray) -> np.ndarray:
    """Lengths (f, 3) [m] of a face's sides, side k from corner k to the next, of rest edges (f, 2, 2)."""
    first, second = edges[:, :, 0], edges[:, :, 1]
    return np.stack([np.linalg.norm(side, axis=1) for side in (first, second - first, second)], axis=1)


def graded(edges: np.ndarray, made: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Rest edges (f, 2, 2) of the same cloth, stretched as its faces were from `made` to `shape`, both rest edges of a
    mesh as it lies: shape made^-1 edges. What was not stretched is the same bit for bit."""
    along = shape[:, 0, 0] / made[:, 0, 0]
    across = shape[:, 1, 1] / made[:, 1, 1]
    sheared = (shape[:, 0, 1] - along * made[:, 0, 1]) / made[:, 1, 1]
    first, second = edges[:, 0], edges[:, 1]
    return np.stack([along[:, None] * first + sheared[:, None] * second, across[:, None] * second], axis=1)


def flat_areas(corners: np.ndarray) -> np.ndarray:
    """Areas (f,) [m2] of faces with corners (f, 3, 2), negative where these run clockwise."""
    (a, b), (c, d) = np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1)
    return (a * d - b * c) / 2


def panel_fault(places: np.ndarray, panel_faces: np.ndarray, areas: np.ndarray) -> str | None:
    """Why these are no places (t, 2) and faces (f, 3) of flat cloth for a mesh whose faces have areas (f,) [m2], with
    what is allowed; None if they are."""
    if places.ndim != 2 or places.shape[1] != 2 or panel_faces.shape != (len(areas), 3):
        return f"panel places {places.shape} and faces {panel_faces.shape} must be (t, 2) and {(len(areas), 3)}"
    bad = np.flatnonzero(~np.isfinite(places).all(axis=1))
    if len(bad):
        return f"{len(bad)} panel places are not finite, the first is {bad[0]}: {places[bad[0]].tolist()}"
    if panel_faces.dtype.kind not in "iu":
        return f"panel faces are of type {panel_faces.dtype}, expected an integer index of each corner's place"
    if panel_faces.min() < 0 or panel_faces.max() >= len(places):
        return f"panel faces hold {panel_faces.min()} to {panel_faces.max()}, allowed 0 to {len(places) - 1}"
    flat = flat_areas(places[panel_faces])
    flat = flat * (np.sign(flat.sum()) or 1.0)
    if flat.min() < SMALLEST_AREA:
        face = int(flat.argmin())
        what = "turned over" if flat[face] < -SMALLEST_AREA else "degenerate"
        return (
            f"face {face} is {what} on the flat cloth: its area is {flat[face]:.2e} m2 there, allowed: "
            f"{SMALLEST_AREA:g} m2 or more, all panels seen from the same side"
        )
    ratio = flat / areas
    worst = int(np.abs(np.log(ratio)).argmax())
    if not 1 / MOST_STRETCHED <= ratio[worst] <= MOST_STRETCHED:
        return (
            f"face {worst} has {1e6 * flat[worst]:.4g} mm2 on the flat cloth and {1e6 * areas[worst]:.4g} mm2 in the "
            f"mesh, allowed: a factor of {MOST_STRETCHED:g}"
        )
    return None


def panels_of_texture(
    vertices: np.ndarray, faces: np.ndarray, areas: np.ndarray, uv: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray] | None, str]:
    """Panel places (t, 2) and faces (f, 3) of a mesh whose texture coordinates `uv` (f, 3, 2) are flat cloth in metres,
    else None; and what was found, in words. A vertex has a place for each panel that it is on.

    They are where the median edge is as long as in the mesh (0.8 to 1.25 times), 95 % of the faces are as large (up to
    a factor of 2, all up to 3) and none is turned over.
    """
    if not np.isfinite(uv).all():
        lacking = int((~np.isfinite(uv).all(axis=(1, 2))).sum())
        return None, "no texture coordinates" if lacking == len(uv) else f"{lacking} faces have no texture coordinates"
    corners = np.column_stack([faces.reshape(-1), uv.reshape(-1, 2).round(FINEST)])
    unique, place = np.unique(corners, axis=0, return_inverse=True)
    places, panel_faces = np.ascontiguousarray(unique[:, 1:]), place.reshape(faces.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        sides = [np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (uv, vertices[faces])]
        times = float(np.median(sides[0] / sides[1]))
        fault = panel_fault(places, panel_faces, areas)
    median_edge = f"the median edge is {times:.3g} times as long as in the mesh"
    if not IN_METRES[0] <= times <= IN_METRES[1]:
        return None, f"texture coordinates are not in metres: {median_edge}"
    if fault:
        return None, f"texture coordinates are no flat cloth: {fault}"
    ratio = np.abs(flat_areas(uv)) / areas
    alike = float((np.maximum(ratio, 1 / ratio) <= ALIKE).mean())
    if alike < SHARE_ALIKE:
        return None, (
            f"texture coordinates are not flat cloth: {100 * alike:.0f} % of the faces have the area that they have in "
            f"the mesh, up to a factor of {ALIKE:g}"
        )
    return (places, panel_faces), f"texture coordinates in metres, {median_edge}"
