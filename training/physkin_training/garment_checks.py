"""Is a mesh fit to be trained as a garment? Every check says so in plain words, and repairs what is safe to repair.

Dimensions: `n` vertices, `f` faces. Metres, root frame, the body in its canonical pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from physkin_core.avatar import Avatar
from physkin_core.garment import Garment, GarmentError
from physkin_training import mesh_repair
from physkin_training.garment_fitting import CLEARANCE, carried, clear_of
from physkin_training.garment_placement import UNITS, WORN, best_scale, find_placement
from physkin_training.surface_queries import BodySurface, layers_near, piercing_edges

__all__ = ["CheckedGarment", "Verdict", "check_garment", "check_mesh", "verdict_table", "write_garment"]

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
WELD = 5e-5
"""Vertices closer than this [m] to each other are one."""
SMALLEST_FACE = 1e-8
"""[m2], a hundredth of a square millimetre."""
MOST_DROPPED = 0.005
"""Share of faces that may go for the sake of edges shared by three."""
SMALL_PIECE = 0.02
"""Pieces of less than this share of the area are buttons and scraps, and dropped."""
EDGE_RANGE = (0.006, 0.025)
"""[m] mean edge; the shipped garments have 0.015."""
MOST_VERTICES = 20000
SMALL_LOOP = 0.1
"""[m] an opening with less boundary than this is a hole."""
LAYER_REACH = 0.006
"""[m] nearest other layer of cloth; how many percent of the faces may have one."""
LAYERED, DOUBLED = 0.02, 0.3
FACING = 0.2
"""How clearly faces must look away from the body on average: -1 to 1."""
DEEPEST_REPAIRED, MOST_INSIDE = 0.08, 0.5
"""Overlap that is pushed out: depth [m], share of vertices."""
SAME_BODY = 0.01
"""Bodies whose bones are no farther apart than this [m] are taken for one."""

Outcome = Literal["ok", "repaired", "warning", "refused"]


@dataclass(frozen=True)
class Verdict:
    """One check: its name, outcome, what was found and what is allowed, in plain words."""

    check: str
    outcome: Outcome
    found: str
    allowed: str


@dataclass(frozen=True)
class CheckedGarment:
    """A garment mesh after the checks, vertices (n, 3) [m] on the training template's body, and all verdicts."""

    vertices: np.ndarray
    faces: np.ndarray
    verdicts: tuple[Verdict, ...]

    @property
    def refused(self) -> bool:
        """Whether some check found what cannot be repaired."""
        return any(verdict.outcome == "refused" for verdict in self.verdicts)


class _Checks:
    """The mesh as repaired so far, and the verdicts."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self.verdicts: list[Verdict] = []

    def say(self, check: str, outcome: Outcome, found: str, allowed: str) -> None:
        self.verdicts.append(Verdict(check, outcome, found, allowed))

    def result(self) -> CheckedGarment:
        return CheckedGarment(self.vertices, self.faces, tuple(self.verdicts))


def check_garment(path: str | Path, avatar: Avatar, template: Avatar) -> CheckedGarment:
    """Check the garment mesh of a file and repair it.

    avatar: the body it was made on, in the canonical pose. template: the training template's garment body; a garment
    made on another body is carried over to it. Raises GarmentError when the file holds no mesh at all.
    """
    vertices, faces, quads = _read(Path(path))
    return check_mesh(vertices, faces, avatar, template, polygons=quads)


def check_mesh(
    vertices: np.ndarray, faces: np.ndarray, avatar: Avatar, template: Avatar, *, polygons: int = 0
) -> CheckedGarment:
    """Check vertices (n, 3), in any unit and axes, and faces (f, 3); see `check_garment`.

    polygons: how many faces of more than three corners the triangles came from. Checks stop at the first refusal after
    which the others would mean nothing.
    """
    checks = _Checks(np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64))
    steps: list[Callable[[], None]] = [lambda: _check_triangles(checks, polygons)]
    surface = BodySurface(avatar.vertices, avatar.faces)
    steps += [
        lambda: _check_placement(checks, surface),
        lambda: _check_duplicates(checks),
        lambda: _check_manifold(checks),
        lambda: _check_pieces(checks),
        lambda: _check_winding(checks, surface),
        lambda: _check_openings(checks),
        lambda: _check_scale(checks, surface),
        lambda: _check_edges(checks),
        lambda: _check_layers(checks),
        lambda: _check_overlap(checks, avatar, surface),
        lambda: _check_body(checks, avatar, template),
        lambda: _check_self_intersection(checks),
    ]
    for step in steps:
        step()
        if checks.verdicts[-1].outcome == "refused":
            break
    return checks.result()


def verdict_table(verdicts: tuple[Verdict, ...]) -> str:
    """The verdicts as a Markdown table."""
    lines = ["| check | verdict | found | allowed |", "|---|---|---|---|"]
    return "\n".join(lines + [f"| {v.check} | {v.outcome} | {v.found} | {v.allowed} |" for v in verdicts])


def write_garment(path: Path, checked: CheckedGarment) -> None:
    """Write the repaired mesh as OBJ: metres, root frame of the template, outward winding."""
    lines = ["# root frame: X forward, Y left, Z up, metres, origin at the head of the root bone"]
    lines += [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in checked.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (checked.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    import trimesh

    if path.suffix.lower() not in MESH_SUFFIXES:
        allowed = ", ".join(MESH_SUFFIXES)
        raise GarmentError(f"garment {path} has the unknown extension {path.suffix!r}; allowed: {allowed}")
    if not path.is_file():
        raise GarmentError(f"garment {path}: no such file")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    except Exception as error:
        raise GarmentError(f"cannot read garment mesh {path}: {error}") from error
    if len(faces) == 0:
        raise GarmentError(f"garment {path} holds no faces")
    polygons = 0
    if path.suffix.lower() == ".obj":
        with open(path, errors="replace") as file:
            polygons = sum(line.startswith("f ") and len(line.split("#")[0].split()) > 4 for line in file)
    return vertices, faces, polygons


def _check_triangles(checks: _Checks, polygons: int) -> None:
    allowed = "triangles; faces of more corners are cut into triangles"
    n, faces = len(checks.vertices), checks.faces
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0 or faces.min() < 0 or faces.max() >= n:
        return checks.say("triangles", "refused", f"no faces, or faces of vertices that are not there ({n})", allowed)
    if not np.isfinite(checks.vertices[np.unique(faces)]).all():
        count = int((~np.isfinite(checks.vertices).all(axis=1)).sum())
        return checks.say("triangles", "refused", f"{count} vertices have no finite position", "finite positions")
    checks.vertices, checks.faces = mesh_repair.compacted(checks.vertices, faces)
    found = f"{len(faces)} triangles, {len(checks.vertices)} vertices"
    if polygons:
        return checks.say("triangles", "repaired", f"{found}, from {polygons} faces of more corners", allowed)
    return checks.say("triangles", "ok", found, allowed)


def _check_placement(checks: _Checks, surface: BodySurface) -> None:
    try:
        placed = find_placement(checks.vertices, surface)
    except ValueError as error:
        return checks.say("units", "refused", str(error), ", ".join(UNITS))
    checks.vertices = placed.applied(checks.vertices)
    extent = " x ".join(f"{value:.2f}" for value in np.ptp(checks.vertices, axis=0))
    changed = "ok" if placed.unit == "metres" else "repaired"
    checks.say("units", changed, f"{placed.unit}; {extent} m", ", ".join(UNITS))
    changed = "ok" if np.array_equal(placed.turn, np.eye(3)) else "repaired"
    checks.say("orientation", changed, placed.axes, "Z or Y up, facing along an axis; turned to Z up, X forward")
    allowed = "where it is worn on the body, the body's root at the origin or its feet on the floor"
    found = f"mean distance to the body {1000 * placed.cost:.0f} mm"
    if placed.cost > WORN:
        return checks.say("position", "refused", f"{found}: it does not lie on the body anywhere", allowed)
    if placed.shift.any():
        shift = ", ".join(f"{value:.3f}" for value in placed.shift)
        if placed.searched:
            found += "; the closest fit, see whether front and height are right"
        return checks.say(
            "position", "warning" if placed.searched else "repaired", f"moved by ({shift}) m; {found}", allowed
        )
    return checks.say("position", "ok", found, allowed)


def _check_duplicates(checks: _Checks) -> None:
    allowed = f"no two vertices within {1000 * WELD:g} mm, no face below {1e6 * SMALLEST_FACE:g} mm2 or twice"
    checks.vertices, checks.faces, welded = mesh_repair.weld(checks.vertices, checks.faces, WELD)
    checks.faces, dropped = mesh_repair.drop_empty_faces(checks.vertices, checks.faces, SMALLEST_FACE)
    if len(checks.faces) == 0:
        return checks.say("duplicates", "refused", "no face has an area", allowed)
    checks.vertices, checks.faces = mesh_repair.compacted(checks.vertices, checks.faces)
    outcome = "repaired" if welded or dropped else "ok"
    return checks.say(
        "duplicates", outcome, f"{welded} duplicate vertices, {dropped} degenerate or repeated faces", allowed
    )


def _check_manifold(checks: _Checks) -> None:
    allowed = f"two faces an edge, one fan a vertex; up to {100 * MOST_DROPPED:g} % of the faces may go for it"
    total = len(checks.faces)
    checks.faces, dropped = mesh_repair.drop_crowded_faces(checks.vertices, checks.faces)
    checks.vertices, checks.faces, split = mesh_repair.split_pinched_vertices(checks.vertices, checks.faces)
    found = f"{dropped} faces at edges of three or more faces, {split} vertices that pinch"
    if dropped > MOST_DROPPED * total:
        return checks.say("manifold", "refused", found, allowed)
    return checks.say("manifold", "repaired" if dropped or split else "ok", found, allowed)


def _check_pieces(checks: _Checks) -> None:
    allowed = f"one piece; those below {100 * SMALL_PIECE:g} % of the area are dropped"
    label = mesh_repair.face_components(checks.faces)
    share = np.bincount(label, weights=_areas(checks)) / _areas(checks).sum()
    small = share < SMALL_PIECE
    checks.vertices, checks.faces = mesh_repair.compacted(checks.vertices, checks.faces[~small[label]])
    found = f"{len(share)} connected pieces" if len(share) > 1 else "one piece"
    if small.any():
        found += f", {int(small.sum())} scraps dropped"
    if (~small).sum() > 1:
        return checks.say("pieces", "warning", f"{found}; separate pieces do not hold each other", allowed)
    return checks.say("pieces", "repaired" if small.any() else "ok", found, allowed)


def _check_winding(checks: _Checks, surface: BodySurface) -> None:
    allowed = "all faces wound alike, their outside away from the body"
    checks.faces, turned, possible = mesh_repair.wind_consistently(checks.faces)
    if not possible:
        return checks.say("winding", "refused", "the cloth has only one side (a Moebius strip)", allowed)
    outward = surface.closest(checks.vertices[checks.faces].mean(axis=1)).outward
    normals = _normals(checks)
    label = mesh_repair.face_components(checks.faces)
    area = _areas(checks)
    facing = np.bincount(label, weights=(normals * outward).sum(axis=1) * area) / np.bincount(label, weights=area)
    inside_out = facing < 0
    checks.faces = np.where(inside_out[label][:, None], checks.faces[:, ::-1], checks.faces)
    found = f"{turned} faces turned" + (", inside out" if inside_out.any() else "")
    if np.abs(facing).min() < FACING:
        found += f"; it faces the body about as much as away from it ({facing.min():.2f})"
        return checks.say("winding", "warning", found, allowed)
    return checks.say("winding", "repaired" if turned or inside_out.any() else "ok", found, allowed)


def _check_openings(checks: _Checks) -> None:
    allowed = f"at least one opening; boundaries shorter than {100 * SMALL_LOOP:g} cm are holes"
    loops = mesh_repair.boundary_loops(checks.faces)
    around = [float(np.ptp(checks.vertices[loop], axis=0).max()) * np.pi for loop in loops]
    holes = sum(length < SMALL_LOOP for length in around)
    if len(loops) == holes:
        found = "it is closed" if not loops else f"{holes} holes only"
        return checks.say("openings", "refused", f"{found}: no opening to get into it", allowed)
    found = f"{len(loops) - holes} openings" + (f", {holes} holes" if holes else "")
    return checks.say("openings", "warning" if holes else "ok", found, allowed)


def _check_scale(checks: _Checks, surface: BodySurface) -> None:
    allowed = "made for this body; not changed, since loose or tight may be meant"
    scale, least, now = best_scale(checks.vertices, surface)
    if now > 0.03 and least < 0.6 * now and scale != 1:
        found = f"at {scale:g} times its size it would lie closer: {1000 * least:.0f} instead of {1000 * now:.0f} mm"
        return checks.say("scale", "warning", found, allowed)
    return checks.say("scale", "ok", f"mean distance to the body {1000 * now:.0f} mm", allowed)


def _check_edges(checks: _Checks) -> None:
    low, high = EDGE_RANGE
    allowed = (
        f"mean edge {1000 * low:g} to {1000 * high:g} mm, up to {MOST_VERTICES} vertices; coarser ones are refined"
    )
    before = _edge_mean(checks)
    while _edge_mean(checks) > high:
        checks.vertices, checks.faces = mesh_repair.refined(checks.vertices, checks.faces)
    mean, count = _edge_mean(checks), len(checks.vertices)
    if mean != before:
        found = f"mean edge {1000 * before:.1f} mm, refined to {1000 * mean:.1f} mm, {count} vertices"
        return checks.say("edge length", "repaired", found, allowed)
    found = f"mean edge {1000 * mean:.1f} mm, {count} vertices"
    if mean < low or count > MOST_VERTICES:
        return checks.say("edge length", "warning", f"{found}: finer than training needs, and slower", allowed)
    return checks.say("edge length", "ok", found, allowed)


def _check_layers(checks: _Checks) -> None:
    allowed = f"one layer: up to {100 * LAYERED:g} % of the faces within {1000 * LAYER_REACH:g} mm of another layer"
    share = float(layers_near(checks.vertices, checks.faces, LAYER_REACH).mean())
    found = f"{100 * share:.1f} % of the faces have another layer near"
    if share > DOUBLED:
        return checks.say("one layer", "refused", f"{found}: export the outer surface only, without thickness", allowed)
    return checks.say("one layer", "warning" if share > LAYERED else "ok", found, allowed)


def _check_self_intersection(checks: _Checks) -> None:
    allowed = "none; cloth in contact with itself is not trained, so that they stay"
    count = int(piercing_edges(checks.vertices, checks.faces, _edges(checks)).sum())
    return checks.say("self-intersection", "warning" if count else "ok", f"{count} edges go through a face", allowed)


def _check_overlap(checks: _Checks, avatar: Avatar, surface: BodySurface) -> None:
    allowed = (
        f"{1000 * CLEARANCE:g} mm clear of the body; up to {100 * MOST_INSIDE:g} % of the vertices, "
        f"{1000 * DEEPEST_REPAIRED:g} mm deep, are pushed out"
    )
    distance = surface.closest(checks.vertices).distance
    inside, depth = float((distance < 0).mean()), max(0.0, -float(distance.min()))
    found = f"{int((distance < 0).sum())} vertices in the body ({100 * inside:.1f} %), {1000 * depth:.1f} mm at most"
    if inside > MOST_INSIDE or depth > DEEPEST_REPAIRED:
        return checks.say("overlap", "refused", found, allowed)
    close = int((distance < CLEARANCE).sum())
    if close == 0:
        return checks.say("overlap", "ok", f"none; closest {1000 * distance.min():.1f} mm", allowed)
    found += f", {close} closer than allowed; pushed out"
    return _push_out(checks, "overlap", avatar, surface, found, allowed)


def _push_out(checks: _Checks, name: str, avatar: Avatar, surface: BodySurface, found: str, allowed: str) -> None:
    before = _garment(checks)
    checks.vertices = clear_of(before, avatar, surface)
    after = _moved(before, checks.vertices)
    strain = 100 * float((np.abs(after.edge_lengths - before.edge_lengths) / before.edge_lengths).mean())
    closest = float(surface.closest(checks.vertices).distance.min())
    found += f": edges changed by {strain:.1f} %, now {1000 * closest:.1f} mm clear"
    if closest < CLEARANCE - 5e-4:
        return checks.say(name, "refused", found, allowed)
    return checks.say(name, "warning" if strain > 5 else "repaired", found, allowed)


def _check_body(checks: _Checks, avatar: Avatar, template: Avatar) -> None:
    allowed = "made on the training template's body; carried over from another one"
    apart = float(np.linalg.norm(avatar.bone_heads - template.bone_heads, axis=1).max())
    if avatar.vertices.shape == template.vertices.shape and apart <= SAME_BODY:
        return checks.say("body", "ok", "the template's own", allowed)
    checks.vertices = carried(checks.vertices, avatar, template)
    surface = BodySurface(template.vertices, template.faces)
    found = f"another body, joints up to {100 * apart:.0f} cm from the template's; carried over bone by bone"
    if surface.closest(checks.vertices).distance.min() < CLEARANCE:
        _push_out(checks, "body", template, surface, f"{found} and pushed out of it", allowed)
    else:
        checks.say("body", "repaired", found, allowed)
    if checks.verdicts[-1].outcome == "repaired":
        checks.verdicts[-1] = replace(checks.verdicts[-1], outcome="warning")


def _garment(checks: _Checks) -> Garment:
    return Garment(checks.vertices, checks.faces)


def _moved(garment: Garment, vertices: np.ndarray) -> Garment:
    """The same faces over other vertices (n, 3)."""
    return Garment(vertices, garment.faces)


def _edges(checks: _Checks) -> np.ndarray:
    return np.unique(np.sort(checks.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def _edge_mean(checks: _Checks) -> float:
    ends = checks.vertices[_edges(checks)]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def _cross(checks: _Checks) -> np.ndarray:
    corners = checks.vertices[checks.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _areas(checks: _Checks) -> np.ndarray:
    return np.linalg.norm(_cross(checks), axis=1) / 2


def _normals(checks: _Checks) -> np.ndarray:
    return _cross(checks) / (2 * _areas(checks)[:, None])
