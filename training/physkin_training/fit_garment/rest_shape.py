"""What a mesh brings along of how it was sewn, on the repaired mesh: flat panels, by texture coordinates, creases and
threads.

Dimensions: `n` vertices, `f` faces, `t` places on the flat cloth, `c` creases, `k` lines. Metres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from trimesh.geometry import faces_to_edges
from trimesh.graph import connected_component_labels

from physkin_core.mesh.look import Look
from physkin_core.model.garment import LONGEST_THREAD, Garment, face_areas
from physkin_core.model.rest_shape import flat_areas, flat_edges, panels_of_texture, side_lengths
from physkin_core.model.surface_paths import mesh_edges
from physkin_training.fit_garment.verdicts import Checks

__all__ = ["check_rest_shape", "check_threads", "edges_along", "laid_out"]

ON_LINE = 1e-4
"""[m] Vertices this near to a line element are on it."""
AT_VERTEX = 0.003
"""[m] Repairs move the vertices that threads end at by up to this."""
SURELY_METRES = 0.05
"""Texture places that are smaller or larger than the mesh by more than this share may be in metres by accident."""
ROUNDS = 200
"""Of laying panels out."""
WEAK_TIE = 1e-9
"""To where a place was, so that panels stay where they are."""


def check_rest_shape(checks: Checks, look: Look, lying: np.ndarray, made: np.ndarray) -> Look:
    """Flat panels; the look, with these where they had to be graded.

    lying: (n, 3) the mesh as it was brought; made: (n, 3) the same before it was moved to another body, if it was.
    """
    allowed = (
        "texture coordinates in metres, as large as the mesh (0.8 to 1.25 times), are flat panels; others are a look"
    )

    def panels_at(vertices: np.ndarray, uv: np.ndarray):
        return panels_of_texture(vertices, checks.faces, face_areas(vertices, checks.faces), uv)

    def dropped(why: str) -> Look:
        """Of a mesh that was moved to another body: there they may look like panels by accident."""
        found = f"dropped, and the texture coordinates with it: {why}"
        checks.say("flat rest shape", "warning", found, allowed)
        return replace(look, uv=np.full_like(look.uv, np.nan))

    panels, found = panels_at(lying, look.uv)
    if panels is not None and made is not checks.vertices:
        repaired, refused = panels_at(made, look.uv)
        if repaired is None:
            return dropped(f"after repairs {refused}; keep it clear of the body where it was sewn")
        places, panel_faces = panels
        cut = Garment(made, checks.faces, None, places, panel_faces)
        wanted = cut.reshaped(checks.vertices).rest_edges
        uv = laid_out(places, panel_faces, wanted)[panel_faces]
        goal = side_lengths(wanted)
        changed, off = (
            100 * float((np.abs(side_lengths(x) - goal) / goal).mean()) for x in (cut.rest_edges, flat_edges(uv))
        )
        panels, refused = panels_at(checks.vertices, uv)
        if panels is None:
            return dropped(f"graded to the template, {refused}")
        found += f"; graded to the template, edges by {changed:.1f} %, to {off:.1f} % of what the mesh says"
        checks.say("flat rest shape", "repaired", _described(panels, found), allowed)
        return replace(look, uv=uv)
    brought, (panels, now) = panels, panels_at(checks.vertices, look.uv)  # what training will read
    if panels is None and brought is not None:
        found = f"dropped, it rests as it lies: after repairs {now}; keep it clear of the body where it was sewn"
        checks.say("flat rest shape", "warning", found, allowed)
        return look
    if panels is None:
        checks.say("flat rest shape", "ok", f"none, it rests as it lies: {now}", allowed)
        return look
    ratio = np.sqrt(np.abs(flat_areas(look.uv)).sum() / face_areas(lying, checks.faces).sum())
    outcome = "ok" if abs(ratio - 1) <= SURELY_METRES else "warning"
    if outcome == "warning":
        found += f"; panels {ratio:.2f} times as large as the mesh: if they are not meant in metres, scale them"
    checks.say("flat rest shape", outcome, _described(panels, found), allowed)
    return look


def _described(panels: tuple[np.ndarray, np.ndarray], found: str) -> str:
    places, panel_faces = panels
    labels = connected_component_labels(faces_to_edges(panel_faces), node_count=len(places))
    area = np.abs(flat_areas(places[panel_faces])).sum()
    return f"{labels.max() + 1} flat panels of {area:.2f} m2: {found}"


def laid_out(places: np.ndarray, panel_faces: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Places (t, 2) in the plane, near those given, at which faces come closest to rest edges `wanted` (f, 2, 2): least
    squares of sides, each face turned as fits best (Sorkine and Alexa 2007, in the plane)."""
    corners = places[panel_faces]
    target = np.stack([-wanted.sum(axis=2) / 3, *np.moveaxis(wanted, 2, 0)], axis=1)  # corners about their mean
    target[:, 1:] += target[:, :1]
    target[:, :, 1] *= np.sign(flat_areas(corners))[:, None]
    starts, ends = panel_faces.reshape(-1), np.roll(panel_faces, -1, axis=1).reshape(-1)
    t = len(places)
    pairs = (np.concatenate([starts, ends]), np.concatenate([ends, starts]))
    joined = coo_array((np.ones(len(pairs[0])), pairs), shape=(t, t)).tocsr()
    degree = np.asarray(joined.sum(axis=1)).reshape(-1)
    solver = splu((diags_array(degree + WEAK_TIE) - joined).tocsc())
    now = places
    for _ in range(ROUNDS):
        about = now[panel_faces] - now[panel_faces].mean(axis=1, keepdims=True)
        cross = target[..., 0] * about[..., 1] - target[..., 1] * about[..., 0]
        angle = np.arctan2(cross.sum(axis=1), (target * about).sum(axis=(1, 2)))
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        turned = np.stack([c * target[..., 0] - s * target[..., 1], s * target[..., 0] + c * target[..., 1]], axis=-1)
        sides = (np.roll(turned, -1, axis=1) - turned).reshape(-1, 2)
        pull = [np.bincount(ends, side, t) - np.bincount(starts, side, t) for side in sides.T]
        now = solver.solve(np.stack(pull, axis=1) + WEAK_TIE * places)
    return now


def edges_along(vertices: np.ndarray, faces: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (c, 2) of a mesh that run along line elements, whose ends are at `lines` (k, 2, 3), and which lines (k,)
    have some; each may be many edges long."""
    edges, _ = mesh_edges(faces)
    tree, along = cKDTree(vertices[edges].mean(axis=1)), np.zeros(len(edges), dtype=bool)
    on_edges = np.zeros(len(lines), dtype=bool)
    for line, (start, end) in enumerate(lines):
        length = np.linalg.norm(end - start)
        near = np.array(tree.query_ball_point((start + end) / 2, length / 2 + ON_LINE), dtype=int)
        if length > ON_LINE and len(near):
            away = vertices[edges[near]] - start
            off = np.linalg.norm(np.cross(away, (end - start) / length), axis=-1)
            on_line = (off < ON_LINE).all(axis=1)
            along[near] |= on_line
            on_edges[line] = on_line.any()
    return edges[along], on_edges


def check_threads(checks: Checks, lying: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Threads (k, 2): vertices at the ends of line elements, `lines` (l, 2, 3), where the mesh is at `lying` (n, 3)."""
    distance, threads = cKDTree(lying).query(lines)
    apart = [np.linalg.norm(np.diff(vertices[threads], axis=1)[:, 0], axis=1) for vertices in (lying, checks.vertices)]
    kept = (distance < AT_VERTEX).all(axis=1) & (np.max(apart, axis=0) <= LONGEST_THREAD)
    kept &= threads[:, 0] != threads[:, 1]
    pairs, first = np.unique(np.sort(threads, axis=1), axis=0, return_index=True)
    number = [len(lying), 1]
    kept &= np.isin(np.arange(len(lines)), first[~np.isin(pairs @ number, mesh_edges(checks.faces)[0] @ number)])
    if len(lines):
        allowed = (
            f"line elements between vertices that no edge joins, {100 * LONGEST_THREAD:g} cm apart or less, once each"
        )
        found = f"{kept.sum()} threads" + ("" if kept.all() else f", {(~kept).sum()} left out")
        checks.say("threads", "ok" if kept.all() else "warning", found, allowed)
    return threads[kept]
