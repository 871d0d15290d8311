"""Checks of a garment mesh against the body it was made on and the one it is trained on, and their repairs.

Each takes the `Checks` so far, repairs its mesh and adds a verdict. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.contact.wearing import holding_rim
from physkin_training.fit_garment import mesh_repair
from physkin_training.fit_garment.fitting import CLEARANCE, clear_of, onto_body
from physkin_training.fit_garment.mesh_checks import openings_and_holes
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.placement import (
    MOST_BURIED,
    MOST_COST,
    UNITS,
    Placement,
    best_scale,
    buried,
    find_lying,
    find_placement,
    turned_over,
)
from physkin_training.fit_garment.verdicts import Checks, Verdict

__all__ = [
    "check_body",
    "check_lying",
    "check_overlap",
    "check_placement",
    "check_pose",
    "check_scale",
    "check_upright",
    "check_winding",
]

FACING = 0.2
"""How clearly faces must look away from the body on average: -1 to 1."""
DEEPEST_REPAIRED, MOST_INSIDE = 0.08, 0.5
"""Overlap that is pushed out: depth [m], share of vertices."""
TOP, HUNG_WITHIN = 0.05, 0.06
"""[m] A garment that lies far from the body, as a cape and a poncho do, has at least its top as close as this."""
UPSIDE_DOWN = 0.65
"""Two distances are multiplied: of the cloth from the body, and of its uppermost opening. A garment is upside down if
their product, once it is turned over, is less than this share of what it was. The share is 2.7 to 30 for the shipped
garments (0.9 for a pencil skirt that is 18 % too large), and 0.02 to 0.5 for garments that lie upside down."""
SAME_PLACE, SAME_SHAPE = 1e-3, 0.5
"""[m] by which a garment may move between two poses that are taken for one; % by which edges may change, unrelaxed."""
RELAXING = 30
"""Newton steps after a change of pose: most edges are as sewn by then, and the last few steps take longest."""
SAME_BODY = 0.01
"""Bodies whose joints and skin are no farther apart than this [m] are taken for one."""


def check_placement(checks: Checks, surface: BodySurface) -> None:
    """Unit, axes and place on the body in the canonical pose."""
    try:
        placed = find_placement(checks.vertices, surface)
    except ValueError as error:
        return checks.say("units", "refused", str(error), ", ".join(UNITS))
    _place(checks, placed, UNITS["metres"], np.eye(3))
    allowed = "where it is worn on the body, the body's root at the origin or its feet on the floor"
    found = f"mean distance to the body {1000 * placed.cost:.0f} mm"
    if placed.cost > MOST_COST and _top_away(checks.vertices, surface) > HUNG_WITHIN:
        return checks.say("position", "refused", f"{found}: it does not lie on the body anywhere", allowed)
    if placed.shift.any():
        shift = ", ".join(f"{value:.3f}" for value in placed.shift)
        if placed.searched:
            found += "; the closest fit, see whether front and height are right"
        return checks.say(
            "position", "warning" if placed.searched else "repaired", f"moved by ({shift}) m; {found}", allowed
        )
    return checks.say("position", "ok", found, allowed)


def _top_away(vertices: np.ndarray, surface: BodySurface) -> float:
    """Mean distance [m] to the body of a garment's uppermost vertices."""
    height = vertices[:, 2]
    return float(np.abs(surface.closest(vertices[height >= height.max() - TOP]).distance).mean())


def check_lying(checks: Checks, own: OwnPose, own_surface: BodySurface, surface: BodySurface) -> bool:
    """Unit, axes and place on an avatar in its own pose, as the garment lies; else as `check_placement`, in doubt.

    surface: of the avatar in the canonical pose. Returns whether it lies in the own pose.
    """
    try:
        lying = find_lying(checks.vertices, own, own_surface)
    except ValueError as error:
        checks.say("units", "refused", str(error), ", ".join(UNITS))
        return True
    allowed = (
        f"as it lies on the avatar, which shares its origin, less than {100 * MOST_BURIED:g} % of it deep in the body"
    )
    if lying:
        _place(checks, lying[0], own.scale, own.turn)
        found = f"as it lies; mean distance to the body {1000 * lying[0].cost:.0f} mm"
        if len(lying) == 1:
            checks.say("position", "ok", found, allowed)
        else:
            others = " or ".join(f"{other.axes}, {other.unit}" for other in lying[1:])
            checks.say("position", "unsure", f"{found}; it would lie as well read as {others}", allowed)
        return True
    as_given = buried(own.scale * checks.vertices @ own.turn.T + own.shift, own_surface)
    check_placement(checks, surface)
    position = checks.verdicts[-1]
    if position.outcome == "warning" or (
        position.outcome != "refused" and buried(checks.vertices, surface) > MOST_BURIED
    ):
        found = f"not on the avatar as it lies ({100 * as_given:.0f} % of it deep in the body); {position.found}"
        checks.verdicts[-1] = Verdict("position", "unsure", found, allowed)
    return False


def _place(checks: Checks, placed: Placement, scale: float, turn: np.ndarray) -> None:
    """Take vertices to the root frame; verdicts on unit and axes, repaired where they are not `scale` and `turn`."""
    checks.vertices, checks.lines = placed.applied(checks.vertices), placed.applied(checks.lines)
    extent = " x ".join(f"{value:.2f}" for value in np.ptp(checks.vertices, axis=0))
    changed = "ok" if np.isclose(placed.scale, scale) else "repaired"
    checks.say("units", changed, f"{placed.unit}; {extent} m", ", ".join(UNITS))
    changed = "ok" if np.allclose(placed.turn, turn, atol=1e-3) else "repaired"
    checks.say("orientation", changed, placed.axes, "Z or Y up, facing along an axis; turned to Z up, X forward")


def check_upright(checks: Checks, surface: BodySurface) -> None:
    """Head up, held by the uppermost opening."""
    allowed = f"distances of cloth and uppermost opening head down, multiplied, {UPSIDE_DOWN:g} times or more as large"
    loops, _ = openings_and_holes(checks.vertices, checks.faces)

    def held_by(vertices: np.ndarray) -> float:
        rim = vertices[holding_rim(vertices, loops)]
        return float(np.abs(surface.closest(rim).distance).mean())

    upright, over, cost = turned_over(checks.vertices, surface)
    away, away_over = held_by(upright), held_by(over)
    found = f"uppermost opening {1000 * away:.0f} mm from the body, head down {1000 * away_over:.0f} mm"
    found += f"; head down its distance would be {cost:.2f} times"
    if cost * away_over < UPSIDE_DOWN * away:
        return checks.say("upright", "refused", f"{found}: it is upside down", allowed)
    return checks.say("upright", "ok", found, allowed)


def check_winding(checks: Checks, surface: BodySurface) -> None:
    """Faces wound alike and facing out."""
    allowed = "all faces wound alike, their outside away from the body"
    checks.faces, turned, possible = mesh_repair.wind_consistently(checks.faces)
    if not possible:
        return checks.say("winding", "refused", "the cloth has only one side (a Moebius strip)", allowed)
    outward = surface.closest(checks.vertices[checks.faces].mean(axis=1)).outward
    mesh, label = checks.mesh, mesh_repair.face_components(checks.faces)
    towards = (mesh.face_normals * outward).sum(axis=1) * mesh.area_faces
    facing = np.bincount(label, weights=towards) / np.bincount(label, weights=mesh.area_faces)
    inside_out = facing < 0
    checks.faces = np.where(inside_out[label][:, None], checks.faces[:, ::-1], checks.faces)
    found = f"{turned} faces turned" + (", inside out" if inside_out.any() else "")
    if np.abs(facing).min() < FACING:
        found += f"; it faces the body about as much as away from it ({facing.min():.2f})"
        return checks.say("winding", "warning", found, allowed)
    return checks.say("winding", "repaired" if turned or inside_out.any() else "ok", found, allowed)


def check_scale(checks: Checks, surface: BodySurface) -> None:
    """A size that suits the body much better."""
    allowed = "made for this body; not changed, since loose or tight may be meant"
    scale, least, now = best_scale(checks.vertices, surface)
    if now > 0.03 and least < 0.6 * now and scale != 1:
        found = f"at {scale:g} times its size it would lie closer: {1000 * least:.0f} instead of {1000 * now:.0f} mm"
        return checks.say("scale", "warning", found, allowed)
    return checks.say("scale", "ok", f"mean distance to the body {1000 * now:.0f} mm", allowed)


def check_overlap(checks: Checks, avatar: Avatar, surface: BodySurface) -> None:
    """Cloth in the body the garment was made on."""
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


def check_pose(checks: Checks, avatar: Avatar, surface: BodySurface, own: OwnPose | None) -> None:
    """Out of the avatar's own pose into the canonical one. own: None for a garment that is in that one."""
    allowed = "the avatar's own pose, or the canonical A-pose; moved into that with the avatar's skeleton"
    if own is None:
        return checks.say("pose", "ok", "the canonical pose", allowed)
    lying = Garment(checks.vertices, checks.faces)
    checks.vertices = own.canonical(checks.vertices, checks.faces)
    far = float(np.linalg.norm(checks.vertices - lying.vertices, axis=1).max())
    if far < SAME_PLACE:
        return checks.say("pose", "ok", "the canonical pose", allowed)
    found = f"moved out of the avatar's own pose, by up to {100 * far:.1f} cm"
    strain = _edge_change(lying, lying.reshaped(checks.vertices))
    if strain > SAME_SHAPE:
        checks.vertices = clear_of(lying, avatar, surface, start=checks.vertices, iterations=RELAXING)
        strain = _edge_change(lying, lying.reshaped(checks.vertices))
        found += ", and relaxed"
    found += f": edges changed by {strain:.1f} %"
    return checks.say("pose", "warning" if strain > 5 else "repaired", found, allowed)


def check_body(checks: Checks, avatar: Avatar, template: Avatar) -> None:
    """Made on another body than the training template."""
    allowed = "made on the training template's body; moved over from another one"
    apart = float(np.linalg.norm(avatar.bone_heads - template.bone_heads, axis=1).max())
    surface = BodySurface(template.vertices, template.faces)
    if apart <= SAME_BODY and np.abs(surface.closest(avatar.vertices).distance).max() <= SAME_BODY:
        return checks.say("body", "ok", "the template's own", allowed)
    checks.vertices = onto_body(checks.vertices, avatar, template)
    found = f"another body, joints up to {100 * apart:.0f} cm from the template's; moved over bone by bone"
    if surface.closest(checks.vertices).distance.min() < CLEARANCE:
        _push_out(checks, "body", template, surface, f"{found} and pushed out of it", allowed)
    else:
        checks.say("body", "repaired", found, allowed)
    if checks.verdicts[-1].outcome == "repaired":
        checks.verdicts[-1] = replace(checks.verdicts[-1], outcome="warning")


def _push_out(checks: Checks, name: str, avatar: Avatar, surface: BodySurface, found: str, allowed: str) -> None:
    before = Garment(checks.vertices, checks.faces)
    checks.vertices = clear_of(before, avatar, surface)
    after = Garment(checks.vertices, checks.faces)
    strain = _edge_change(before, after)
    closest = float(surface.closest(checks.vertices).distance.min())
    found += f": edges changed by {strain:.1f} %, now {1000 * closest:.1f} mm clear"
    if closest < CLEARANCE - 5e-4:
        return checks.say(name, "refused", found, allowed)
    return checks.say(name, "warning" if strain > 5 else "repaired", found, allowed)


def _edge_change(before: Garment, after: Garment) -> float:
    """Mean change of edge lengths [%]."""
    return 100 * float((np.abs(after.edge_lengths - before.edge_lengths) / before.edge_lengths).mean())
