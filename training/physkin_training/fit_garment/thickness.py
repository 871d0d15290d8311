"""Cloth that was modelled with a thickness: its outer sheet is the garment."""

from __future__ import annotations

import numpy as np

from physkin_training.fit_garment.mesh_repair import compacted
from physkin_training.fit_garment.verdicts import Checks
from physkin_training.physics.surface_queries import BodySurface, layers_near

__all__ = ["check_layers"]

LAYER_REACH = 0.006
"""[m] nearest other layer of cloth."""
LAYERED, DOUBLED = 0.02, 0.3
"""Share of the faces that may have one, and from which on the cloth has a thickness."""


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
        checks.vertices, checks.faces = compacted(vertices, faces[~inner & ~beside])
        found = f"a thickness: {len(faces) - len(checks.faces)} of {len(faces)} faces inside and at rims left out, "
        share = layers_near(checks.vertices, checks.faces, LAYER_REACH).any(axis=1).mean()
    found += f"{100 * share:.1f} % of the faces have another layer near"
    outcome = "warning" if share > LAYERED else "repaired" if thick else "ok"
    return checks.say("one layer", outcome, found, allowed)
