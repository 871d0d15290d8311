"""What can be worn before training: a model from the nearest shipped garment, a picture, and how far to trust it."""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import BodyModel
from physkin_core.check.garment_check import check_garment
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, shipped_models
from physkin_core.outfit.draper import Draper
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.fit_garment.verdicts import Verdict
from physkin_training.transfer.likeness import NEAR, Likeness
from physkin_training.transfer.model_transfer import transferred_model

__all__ = ["NOTHING", "chosen_start", "first_look", "first_model", "folds_verdict"]

CHECK, NOTHING = "nearest garment", "nothing"
CLOSE, ROUGH = 6.0, 12.0
"""Mean edge strains [%] in everyday poses up to which it hangs nearly right, and roughly; shipped garments have 1 to
4."""
BODIES = 2
"""Held-out bodies that it is looked at on."""


def chosen_start(garment: Garment, name: str | None) -> tuple[Likeness | None, Verdict]:
    """The garment that training begins with, None for nothing, and what is said of it.

    name: of a garment model, or its file; `NOTHING`; or None for the nearest shipped one, if that is near. Raises as
    `load_garment_model` does.
    """
    if name == NOTHING:
        return None, Verdict(CHECK, "ok", "not looked for: training begins with nothing, as you asked", NEAR)
    models = map(load_garment_model, [name] if name else shipped_models())
    likeness = Likeness.nearest(garment, models)
    if likeness.near or name:
        return likeness, Verdict(CHECK, "ok", f"{likeness}; training starts from its networks", NEAR)
    found = f"far from all; the nearest is {likeness}: training begins with nothing"
    return None, Verdict(CHECK, "warning", found, NEAR)


def first_model(garment: Garment, likeness: Likeness | None, *, name: str) -> GarmentModel:
    """The model of a garment before training: the nearest garment's, its mesh laid in that one's folds; or where there
    is none, one of garment nodes that follow their bones."""
    if likeness is None:
        return plain_model(garment, name=name)
    return transferred_model(likeness.model, garment, name=name)


def folds_verdict(garment: Garment, model: GarmentModel) -> Verdict:
    """How far a garment's vertices were moved for its first model, and how that changed its edges."""
    moved = np.linalg.norm(model.garment.vertices - garment.vertices, axis=1)
    edges = np.abs(model.garment.edge_lengths / garment.edge_lengths - 1)
    found = (
        f"laid in the folds of {model.training['transferred_from']}: vertices moved by {1e3 * moved.mean():.0f} mm on "
        f"average, rest edges changed by {100 * edges.mean():.1f} %"
    )
    return Verdict("folds", "repaired", found, "those of the garment that training begins with")


def first_look(model: GarmentModel, avatar: Avatar, body_model: BodyModel) -> tuple[str, Draper]:
    """How far to trust it, in words, by how it is worn on the avatar and on some held-out bodies; and on the avatar."""
    draper = Draper(model, avatar)
    others = [avatar_from_body(body_model, body) for body in body_model.held_out_bodies[:BODIES]]
    drapers = [draper, *(Draper(model, body) for body in others)]
    worn = [check_garment(each.layer, each.avatar).everyday for each in drapers]
    strain, inside = (np.mean([getattr(each, of) for each in worn]) for of in ("edge_strain_percent", "inside_percent"))
    if strain <= CLOSE:
        trust = "near to a trained garment: judge cut and fit by it"
    elif strain <= ROUGH:
        trust = "a sketch: judge length and place by it, not folds"
    else:
        trust = "a stand-in: only where it lies is right"
    return (
        f"{trust}. In everyday poses on {len(worn)} bodies edges strain by {strain:.1f} % (trained garments 1 to 4 %), "
        f"{inside:.1f} % of the cloth is inside the body"
    ), draper
