"""Checks of a garment mesh by itself: what is wrong with it, repaired where that changes no shape.

Each takes the `Checks` so far, repairs its mesh and adds a verdict. Metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import mesh_edges, openings
from physkin_training.contact.surface_queries import BodySurface, layers_near, piercing_edges
from physkin_training.contact.wearing import TO_THE_HEM
from physkin_training.fit_garment import mesh_repair
from physkin_training.fit_garment.boundary_seams import SEAM, find_runs, sewn_along
from physkin_training.fit_garment.verdicts import Checks

__all__ = [
    "check_duplicates",
    "check_edges",
    "check_layers",
    "check_manifold",
    "check_openings",
    "check_pieces",
    "check_seams",
    "check_self_intersection",
    "check_triangles",
    "openings_and_holes",
]

WELD = 5e-5
"""Vertices closer than this [m] to each other are one."""
SMALLEST_FACE = 1e-8
"""[m2], a hundredth of a square millimetre."""
MOST_DROPPED = 0.005
"""Share of faces that may go for the sake of edges shared by three."""
SMALL_PIECE = 0.02
"""Pieces of less than this share of the area are buttons and scraps, and dropped."""
APART = 0.01
"""[m] Pieces that run along each other, farther apart than is joined, are in doubt up to this gap."""
SKIN, BULK = 0.0015, 0.01
"""Half of a body is as near to the skin [m]. Volume by area and by longest extent of one that is closed, or open at the
neck alone, at least: 0.02 is usual, and a padded coat has 0.008."""
EDGE_RANGE = (0.006, 0.025)
"""[m] mean edge; the shipped garments have 0.015."""
MOST_VERTICES = 20000
SMALL_LOOP = 0.1
"""[m] an opening with less boundary than this is a hole."""
ONE_WAY = 0.8
"""Length of the mean normal around a loop: from 0 (around a limb) to 1; a wide neckline has 0.7."""
FLAT = 0.98
"""Length of the mean normal of a piece that is flat."""
MOST_MISSING = 0.03
"""Share of the area that holes may have."""
LAYER_REACH = 0.006
"""[m] nearest other layer of cloth."""
LAYERED, DOUBLED = 0.02, 0.3
"""Share of the faces that may have one, and from which on the cloth has a thickness."""


def check_triangles(checks: Checks, polygons: int) -> None:
    """Indices and positions that can be used at all."""
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


def check_duplicates(checks: Checks) -> None:
    """Vertices at one place, faces without area or twice."""
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


def check_manifold(checks: Checks) -> None:
    """Edges of more than two faces, vertices where sheets touch."""
    allowed = f"two faces an edge, one fan a vertex; up to {100 * MOST_DROPPED:g} % of the faces may go for it"
    total = len(checks.faces)
    checks.faces, dropped = mesh_repair.drop_crowded_faces(checks.vertices, checks.faces)
    checks.vertices, checks.faces, split = mesh_repair.split_pinched_vertices(checks.vertices, checks.faces)
    found = f"{dropped} faces at edges of three or more faces, {split} vertices that pinch"
    if dropped > MOST_DROPPED * total:
        return checks.say("manifold", "refused", found, allowed)
    return checks.say("manifold", "repaired" if dropped or split else "ok", found, allowed)


def check_seams(checks: Checks) -> None:
    """Panels that are not quite joined."""
    allowed = f"boundaries that run along each other are one; up to {1000 * SEAM:g} mm apart they are joined"
    runs = find_runs(checks.vertices, checks.faces, SEAM)
    if len(runs.gap):
        checks.vertices, checks.faces = sewn_along(checks.vertices, checks.faces, runs)
        checks.vertices, checks.faces = mesh_repair.compacted(checks.vertices, checks.faces)
    far = find_runs(checks.vertices, checks.faces, APART)
    if far.apart.any():
        place = ", ".join(f"{value:.2f}" for value in checks.vertices[far.vertex[far.apart][0]])
        found = f"separate pieces run along each other, {1000 * far.gap[far.apart].min():.1f} mm apart, at ({place}) m"
        return checks.say("seams", "refused", f"{found}: join their vertices", allowed)
    found, outcome = "no boundaries run along each other", "ok"
    if len(runs.gap):
        found = f"{100 * runs.length:.0f} cm of boundaries joined that were up to {1000 * runs.gap.max():.2f} mm apart"
        outcome = "repaired"
    if runs.open_front:
        found, outcome = f"{found}; an open front, kept; join its vertices to close it", "warning"
    return checks.say("seams", outcome, found, allowed)


def check_pieces(checks: Checks, surface: BodySurface, named: Callable[[np.ndarray], str] | None) -> None:
    """Separate pieces and scraps; a body, or several garments. named: the file's objects at points (p, 3), in words;
    None where the user has chosen them."""
    allowed = f"one piece; those below {100 * SMALL_PIECE:g} % of the area are dropped"
    label = mesh_repair.face_components(checks.faces)
    areas = checks.mesh.area_faces
    share = np.bincount(label, weights=areas) / areas.sum()
    small = share < SMALL_PIECE
    found = f"{len(share)} connected pieces" if len(share) > 1 else "one piece"
    if (~small).sum() > 1 and named:
        pieces = [
            mesh_repair.compacted(checks.vertices, checks.faces[label == each]) for each in np.flatnonzero(~small)
        ]
        kinds = [_kind(*piece, surface) for piece in pieces]
        if 0 < kinds.count("a body") < len(kinds) or kinds.count("a garment") > 1:
            holds = " and ".join(f"{kind} ({named(v[f].mean(axis=1))})" for kind, (v, f) in zip(kinds, pieces))
            return checks.say("pieces", "refused", f"the file holds {holds}; choose with --object NAME", "one garment")
    checks.vertices, checks.faces = mesh_repair.compacted(checks.vertices, checks.faces[~small[label]])
    if small.any():
        found += f", {int(small.sum())} scraps dropped"
    if (~small).sum() > 1:
        return checks.say("pieces", "warning", f"{found}; separate pieces do not hold each other", allowed)
    return checks.say("pieces", "repaired" if small.any() else "ok", found, allowed)


def _kind(vertices: np.ndarray, faces: np.ndarray, surface: BodySurface) -> str:
    """What a piece is: a body, a garment by itself, or a part of one."""
    faces, _, _ = mesh_repair.wind_consistently(faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    on_skin = np.median(np.abs(surface.closest(vertices).distance)) < SKIN
    into, holes = openings_and_holes(vertices, faces)
    closed = len(into) < 2 and sum(_area_inside(mesh, loop) for loop in (*into, *holes)) < MOST_MISSING * mesh.area
    if on_skin or (closed and abs(mesh.volume) > BULK * mesh.area * np.ptp(vertices, axis=0).max()):
        return "a body"
    return "a garment" if len(into) > 1 else "a part"


def check_openings(checks: Checks) -> None:
    """Openings and holes."""
    allowed = (
        f"at least one opening; boundaries shorter than {100 * SMALL_LOOP:g} cm, or whose cloth faces one way all "
        f"around, are holes: up to {100 * MOST_MISSING:g} % of the area"
    )
    into, holes = openings_and_holes(checks.vertices, checks.faces)
    if not into:
        found = f"{len(holes)} holes only" if holes else "it is closed"
        if (flat := _flat_pieces(checks.mesh)) > 1:
            found = f"{flat} flat pieces that are not sewn together (give a sewing pattern as GarmentCode's JSON)"
        return checks.say("openings", "refused", f"{found}: no opening to get into it", allowed)
    found, rim = f"{len(into)} openings", max(into, key=lambda loop: checks.vertices[loop, 2].max())
    x, _, height = (checks.vertices[rim] - checks.vertices.mean(axis=0)).T
    if np.ptp(height) > TO_THE_HEM:
        edges = np.abs(height - (height.min() + height.max()) / 2) < np.ptp(height) / 4
        found += f", open {'in front' if x[edges].mean() > 0 else 'behind'}"
    if not holes:
        return checks.say("openings", "ok", found, allowed)
    missing = sum(_area_inside(checks.mesh, hole) for hole in holes)
    missing /= missing + checks.mesh.area
    found += f", {len(holes)} holes, {100 * missing:.1f} % of the area"
    if missing > MOST_MISSING:
        return checks.say("openings", "refused", f"{found}: faces are missing, export all of them", allowed)
    return checks.say("openings", "warning", found, allowed)


def openings_and_holes(vertices: np.ndarray, faces: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Vertices (r,) of boundary loops of a mesh wound alike: of those that a body part goes through, and of holes."""
    normals = vertex_normals(vertices, faces)

    def is_hole(loop: np.ndarray) -> bool:
        around = float(np.ptp(vertices[loop], axis=0).max()) * np.pi
        return around < SMALL_LOOP or float(np.linalg.norm(normals[loop].mean(axis=0))) > ONE_WAY

    loops = openings(vertices, faces)
    return [loop for loop in loops if not is_hole(loop)], [loop for loop in loops if is_hole(loop)]


def _flat_pieces(mesh: trimesh.Trimesh) -> int:
    """How many connected pieces there are if the cloth of each faces one way, else 0."""
    label, areas = mesh_repair.face_components(mesh.faces), mesh.area_faces
    normals = [np.bincount(label, weights=areas * axis) for axis in mesh.face_normals.T]
    one_way = np.linalg.norm(normals, axis=0) / np.bincount(label, weights=areas)
    return len(one_way) if one_way.min() > FLAT else 0


def _area_inside(mesh: trimesh.Trimesh, loop: np.ndarray) -> float:
    """Area [m2] of the triangles between the edges of a boundary loop, vertices (r,), and its middle."""
    edges, count = mesh_edges(mesh.faces)
    rim = mesh.vertices[edges[(count == 1) & np.isin(edges[:, 0], loop)]] - mesh.vertices[loop].mean(axis=0)
    return float(np.linalg.norm(np.cross(rim[:, 0], rim[:, 1]), axis=1).sum() / 2)


def check_edges(checks: Checks) -> None:
    """Edges too long or too short to train."""
    low, high = EDGE_RANGE
    allowed = f"mean edge {1000 * low:g} to {1000 * high:g} mm, up to {MOST_VERTICES} vertices; coarser: refined"
    before = mean = checks.mesh.edges_unique_length.mean()
    while mean > high:
        checks.vertices, checks.faces = trimesh.remesh.subdivide(checks.vertices, checks.faces)
        mean = checks.mesh.edges_unique_length.mean()
    count = len(checks.vertices)
    if mean != before:
        found = f"mean edge {1000 * before:.1f} mm, refined to {1000 * mean:.1f} mm, {count} vertices"
        return checks.say("edge length", "repaired", found, allowed)
    found = f"mean edge {1000 * mean:.1f} mm, {count} vertices"
    if mean < low or count > MOST_VERTICES:
        return checks.say("edge length", "warning", f"{found}: finer than training needs, and slower", allowed)
    return checks.say("edge length", "ok", found, allowed)


def check_layers(checks: Checks, surface: BodySurface) -> None:
    """Leave out the inner sheet of cloth with a thickness, and the rims between the two."""
    allowed = (
        f"one layer: up to {100 * LAYERED:g} % of the faces within {1000 * LAYER_REACH:g} mm of another layer; of "
        "cloth with a thickness the outer sheet"
    )
    vertices, faces, found = checks.vertices, checks.faces, ""
    near = layers_near(vertices, faces, LAYER_REACH)
    share = near.any(axis=1).mean()
    thick = share > DOUBLED
    if thick:
        outside = surface.closest(vertices[faces].mean(axis=1)).outward
        away = (checks.mesh.face_normals * outside).sum(axis=1) > 0
        inner = np.where(away, near[:, 0], near[:, 1])
        beside = np.isin(faces, faces[inner]).any(axis=1) & ~near.any(axis=1)
        checks.vertices, checks.faces = mesh_repair.compacted(vertices, faces[~inner & ~beside])
        found = f"a thickness: {len(faces) - len(checks.faces)} of {len(faces)} faces inside and at rims left out, "
        share = layers_near(checks.vertices, checks.faces, LAYER_REACH).any(axis=1).mean()
    found += f"{100 * share:.1f} % of the faces have another layer near"
    outcome = "warning" if share > LAYERED else "repaired" if thick else "ok"
    return checks.say("one layer", outcome, found, allowed)


def check_self_intersection(checks: Checks) -> None:
    """Cloth that goes through itself."""
    allowed = "none; cloth in contact with itself is not trained, so that they stay"
    count = int(piercing_edges(checks.vertices, checks.faces, checks.mesh.edges_unique).sum())
    return checks.say("self-intersection", "warning" if count else "ok", f"{count} edges go through a face", allowed)
