"""Fabrics that hosts without Python can have a garment made of: what differs between two of them, once a body.

A fabric is a weight and a code for bending (`physkin_core.model.fabric`). The code changes the modulation of the body,
and so scale and shift of some hundred units, in place of networks of a megabyte.

Dimensions: `F` other fabrics, `M` modulation of the pose modulator, `S` shifts of the sway network.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.fabric import FABRICS, split_colour, with_fabric
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.model.mlp import float32_layers, fold_modulation, modulation_over
from physkin_core.model.sway_network import shifts_of_body
from physkin_core.native_module import as_float32
from physkin_core.runtime.body_encoder import encode_body
from physkin_core.runtime.garment_on_body import put_on_body
from physkin_core.runtime.layer import Layer
from physkin_core.runtime.low_rank import low_rank_layers

__all__ = ["fabric_of", "other_fabrics"]


def fabric_of(model: SkinnedGarment) -> str:
    """Name, or numbers, of what a garment is made of: the first fabric, a ratio of 1, for what it was trained as."""
    return split_colour(model.fabric)[0] or next(iter(FABRICS))


def other_fabrics(layer: Layer, avatar: Avatar, beneath: Sequence[Layer]) -> tuple[list[str], dict[str, Any]]:
    """Names of the other fabrics (F) of a garment as it is worn, and the fields of `BoundGarment` that hold them.

    beneath: what is worn under it. None of a model that has learnt no bending, or that is there without its networks.
    """
    model = layer.model
    if not isinstance(model, GarmentModel):
        return [], {}
    trained = model.as_trained or model
    if not trained.hyper_modulator["bend"].any():
        return [], {}
    names = [name for name in FABRICS if name != fabric_of(model)]
    made = [with_fabric(trained, name) for name in names]
    seen = put_on_body(model, avatar, layer.fit, beneath).seen
    own, *others = (encode_body(each, seen, fit=layer.fit) for each in (model, *made))
    folded = [float32_layers(fold_modulation(model.pose_modulator, each)) for each in (own, *others)]
    fields: dict[str, Any] = {
        "fabric_pose_layers": low_rank_layers(folded, model.rig),
        "fabric_modulations": as_float32([modulation_over(model.pose_modulator, own, each) for each in others]),
        "fabric_weights": as_float32([_weight(each) / _weight(model) for each in made]),
    }
    if model.sway is not None:
        shifts = [np.concatenate(shifts_of_body(model.sway, each)) for each in (own, *others)]
        fields["fabric_sway_shifts"] = as_float32([each - shifts[0] for each in shifts[1:]])
    else:
        fields["fabric_sway_shifts"] = np.empty((len(names), 0), dtype=np.float32)
    return names, fields


def _weight(model: GarmentModel) -> float:
    """How heavy it is for how it stretches."""
    return model.material.density / model.material.youngs_modulus
