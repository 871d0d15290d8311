"""How a body wears a garment at rest: where the cloth lies on its skin, and which body the networks see.

The body model is laid on the avatar. Networks see the body of its coefficients, with its own bone heads, as in
training. What the avatar's skin differs by from that body, and where its pivots lie in its flesh, moves rest shape and
garment nodes, smoothly and once: cloth follows skin, and pivots matter only as what bones turn about.

Dimensions: `n` garment vertices, `m` garment nodes, `b` bones. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from numbers import Real

import numpy as np

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.shape_fitting import lay_body
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.garment_nodes import node_positions_on_body
from physkin_core.runtime.garment_grading import GarmentGrading
from physkin_core.runtime.layer import Layer
from physkin_core.runtime.layers_beneath import swelling

__all__ = ["GarmentOnBody", "checked_fit", "put_on_body"]

NEGLIGIBLE = 2e-4
"""[m] An avatar whose skin is nowhere farther from the body seen is that body, up to rounding."""


@dataclass(frozen=True)
class GarmentOnBody:
    """A garment model on one avatar at rest.

    garment: its mesh in the rest shape worn here. node_rest, node_positions: (m, 3) as in `BoundGarment`.
    seen: the body that the networks see; seen_positions: (m, 3) garment nodes on it. differs: (n, 3) what vertices are
    moved by because the avatar's skin is elsewhere than that body's.
    """

    garment: Garment
    node_rest: np.ndarray
    node_positions: np.ndarray
    seen: Avatar
    seen_positions: np.ndarray
    differs: np.ndarray


def checked_fit(model: GarmentModel, fit: float | None) -> float:
    """The fit as a number; None is 1, made to measure, for a model with the body model's rig, and 0 for any other.

    Raises ValueError when it is not 0 to 1, or above 0 for another rig: garments are graded by the body model.
    """
    if fit is None:
        return float(_of_the_body_model(model))
    if isinstance(fit, bool) or not isinstance(fit, Real) or not 0 <= fit <= 1:
        raise ValueError(f"fit must be 0 (the template) to 1 (made to measure), got {fit!r}")
    if fit > 0 and not _of_the_body_model(model):
        raise ValueError(
            f"fit {fit:g} needs the body model's rig; garment model {model.name!r} has another one, with which "
            "only fit 0 is allowed"
        )
    return float(fit)


def _of_the_body_model(model: GarmentModel) -> bool:
    return model.rig.to_json() == load_body_model().rig.to_json()


def put_on_body(model: GarmentModel, avatar: Avatar, fit: float, beneath: Sequence[Layer] = ()) -> GarmentOnBody:
    """Put a garment on an avatar. fit: 0 for the template's rest shape, 1 for the one made to measure. beneath: what is
    worn already.

    Layers beneath swell the skin. A rest shape made to measure is made for the swollen skin, which networks need not
    know; a garment of one size stays what it is, and networks see the swollen body as training showed it: what the fit
    does not take on, they are shown.
    With another rig than the body model's the networks see the avatar as it is, and garment nodes follow bone heads.
    """
    body, garment = load_body_model(), model.garment
    if not _of_the_body_model(model):
        carried, seen = _carried_by_bones(model, avatar), avatar
        if beneath:
            seen = _swollen(avatar, swelling(avatar.vertices.astype(np.float64), avatar.faces, beneath))
        return GarmentOnBody(garment, model.node_rest, carried, seen, carried, 0 * garment.vertices)
    laid = lay_body(avatar, body)
    seen = replace(avatar_from_body(body, laid.coefficients), source=avatar.source)
    grading = _grading(_Shape.of(garment))
    known = laid.surface - laid.missing - laid.place
    if beneath:
        swollen = swelling(laid.surface, body.faces, beneath)
        seen = _swollen(seen, (1 - fit) * swollen)
        known = known + swollen
    elsewhere = laid.missing + laid.place
    is_elsewhere = np.abs(elsewhere).max() > NEGLIGIBLE
    measured = fit * grading.measured(known) if fit else np.zeros_like(garment.vertices)
    differs = grading.carried(elsewhere) if is_elsewhere else np.zeros_like(garment.vertices)
    closest = grading.closest_vertices(model.node_rest)
    carried = _carried_by_bones(model, seen)
    seen_positions = carried + fit * (model.node_rest - carried) + measured[closest]
    return GarmentOnBody(
        garment=garment.reshaped(garment.vertices + measured + differs),
        node_rest=model.node_rest + (measured + differs)[closest],
        node_positions=seen_positions + differs[closest],
        seen=seen,
        seen_positions=seen_positions,
        differs=differs,
    )


@dataclass(frozen=True)
class _Shape:
    """A garment that equals others of its shape, such as the same file's read again."""

    garment: Garment = field(compare=False)
    arrays: tuple[bytes, ...]

    @classmethod
    def of(cls, garment: Garment) -> _Shape:
        return cls(garment, tuple(a.tobytes() for a in (garment.vertices, garment.faces, garment.vertex_areas)))


@lru_cache(maxsize=8)
def _grading(shape: _Shape) -> GarmentGrading:
    """Of a garment, whatever avatar wears it. Setting it up factorises a matrix under the interpreter's lock, so that a
    node that changes bodies need not do it while clouds wait."""
    return GarmentGrading(shape.garment, load_body_model())


def _swollen(body: Avatar, displacement: np.ndarray) -> Avatar:
    return replace(body, vertices=(body.vertices + displacement).astype(np.float32))


def _carried_by_bones(model: GarmentModel, body: Avatar) -> np.ndarray:
    """Garment nodes (m, 3) [m] where a body's bones carry those of the template."""
    bones = (model.rig.heads, model.rig.tails), (body.bone_heads, body.bone_tails)
    return node_positions_on_body(model.node_rest, model.node_bone, *bones)
