"""Checks of a garment mesh against the body it was made on and the one it is trained on, and their repairs.

Each takes the `Checks` so far, repairs its mesh and adds a verdict. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment
from physkin_training.fit_garment import mesh_repair
from physkin_training.fit_garment.fitting import CLEARANCE, carried, clear_of
from physkin_training.fit_garment.placement import UNITS, WORN, best_scale, find_placement
from physkin_training.fit_garment.verdicts import Checks
from physkin_training.physics.surface_queries import BodySurface

__all__ = [
    "check_body",
    "check_overlap",
    "check_placement",
    "check_scale",
    "check_winding",
]

FACING = 0.2
"""How clearly faces must look away from the body on average: -1 to 1."""
DEEPEST_REPAIRED, MOST_INSIDE = 0.08, 0.5
"""Overlap that is pushed out: depth [m], share of vertices."""
SAME_BODY = 0.01
"""Bodies whose joints and skin are no farther apart than this [m] are taken for one."""


def check_placement(checks: Checks, surface: BodySurface) -> None:
    """Unit, axes and place on the body."""
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


def check_body(checks: Checks, avatar: Avatar, template: Avatar) -> None:
    """Made on another body than the training template."""
    allowed = "made on the training template's body; carried over from another one"
    apart = float(np.linalg.norm(avatar.bone_heads - template.bone_heads, axis=1).max())
    surface = BodySurface(template.vertices, template.faces)
    if apart <= SAME_BODY and np.abs(surface.closest(avatar.vertices).distance).max() <= SAME_BODY:
        return checks.say("body", "ok", "the template's own", allowed)
    checks.vertices = carried(checks.vertices, avatar, template)
    found = f"another body, joints up to {100 * apart:.0f} cm from the template's; carried over bone by bone"
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
    strain = 100 * float((np.abs(after.edge_lengths - before.edge_lengths) / before.edge_lengths).mean())
    closest = float(surface.closest(checks.vertices).distance.min())
    found += f": edges changed by {strain:.1f} %, now {1000 * closest:.1f} mm clear"
    if closest < CLEARANCE - 5e-4:
        return checks.say(name, "refused", found, allowed)
    return checks.say(name, "warning" if strain > 5 else "repaired", found, allowed)
