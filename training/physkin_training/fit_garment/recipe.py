"""How a garment of one's own is trained: from nothing or from the nearest shipped garment, on a GPU or on a CPU.

And how it learns to sway, where training began with none that does.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path

import torch

from physkin_core.model.garment_model import GarmentModel
from physkin_training.config import DetailConfig, OptimisationConfig, TrainingConfig
from physkin_training.networks.export import network_config
from physkin_training.rounding.rounded_sway import rounded_sway
from physkin_training.sway.command import SwayPlan, learn_sway
from physkin_training.sway.fading import sway_share

__all__ = [
    "LEARNING",
    "SIMULATING",
    "STEPS_A_SECOND",
    "default_recipe",
    "has_sizes_of",
    "in_a_hurry",
    "learns_sway",
    "started_from",
    "with_own_sway",
]

log = logging.getLogger(__name__)

DETAIL = DetailConfig(nodes=1024)
OTHER_BENDING = 0.3
ON_GPU = OptimisationConfig(samples=384, bodies=24, other_bending=OTHER_BENDING)
ON_CPU = OptimisationConfig(
    samples=48, bodies=6, encoder_points=512, full_encoding=1.0, validate_every=100, other_bending=OTHER_BENDING
)
"""A step has to be short there, or there are too few; all 4,096 points of the bodies take longer than all the rest."""
BODIES_ON_CPU = 64
"""Training bodies: the garment is graded to each before the first step."""
HURRIED, BODIES_IN_A_HURRY, STEPS_A_SECOND = 300.0, 128, 60.0
"""[s] A whole command that has less on a GPU takes so many: all 512 take 40 s there, and 150 steps from a shipped
garment 5 s. Nor does it time steps, which takes some seconds, but plans for so many a second, about what an H100
takes."""
GENTLE = {
    "learning_rate": 5e-4,
    "warm_up": 0.05,
    "growth": 0.0,
    "prune_from": 0.0,
    "prune_at": 0.0,
    "patience": 8,
}
"""Of a run that begins with what was learnt: all poses from the first step, rates that do not throw it away, and an end
where it no longer falls."""

MEASURED_EVERY = 250
"""Steps of such a run at most from one measurement to the next: it is at its best after some hundreds."""

SWAY_PLAN = SwayPlan(walkers=3, steps=10000, tuning_steps=6000)
"""As many bodies as `learn-sway` with a seventh of its walkers."""
SIMULATING, LEARNING, LEAST_FOR_SWAY = 300.0, 120.0, 900.0
"""[s] Kept for simulating walkers, and for learning from them (on an H100, with 320 walkers, a cape takes 115
and 110, a poncho's walkers 200); and what the whole command must have for it."""
WORTH = 0.9
"""A network must leave at most this share of the distance that simulated cloth is from cloth that does not swing, or it
is not worth its time in every frame. Shipped ones leave about 0.5 to 0.8."""


def default_recipe(name: str, mesh: Path, device: torch.device, *, seconds: float = math.inf) -> TrainingConfig:
    """What shipped garments were trained with, in portions for the device. seconds: that the whole command has."""
    if device.type == "cuda":
        recipe = TrainingConfig(name, mesh, optimisation=ON_GPU, detail=DETAIL)
        return replace(recipe, train_bodies=BODIES_IN_A_HURRY) if in_a_hurry(device, seconds) else recipe
    return TrainingConfig(name, mesh, optimisation=ON_CPU, detail=DETAIL, train_bodies=BODIES_ON_CPU)


def in_a_hurry(device: torch.device, seconds: float) -> bool:
    """Whether a command that has so many seconds in all leaves out what takes long before the first step."""
    return device.type == "cuda" and seconds < HURRIED


def has_sizes_of(recipe: TrainingConfig, model: GarmentModel) -> bool:
    """Whether networks, garment nodes and detail are as large as the model's, so that a run can begin with it."""
    detail = DetailConfig()
    if model.detail is not None:
        numbers, features = model.detail.offsets.shape
        detail = DetailConfig(numbers // 3, features, model.detail.nodes.shape[1])
    nodes = recipe.garment_nodes
    return (
        (recipe.networks, recipe.detail) == (network_config(model), detail)
        and nodes.count == len(model.node_rest)
        and nodes.initial_influences == model.influence_weights.shape[1]
    )


def started_from(recipe: TrainingConfig, start: Path) -> TrainingConfig:
    """The recipe for a run that begins with a model of the garment."""
    often = min(recipe.optimisation.validate_every, MEASURED_EVERY)
    return replace(recipe, start=start, optimisation=replace(recipe.optimisation, validate_every=often, **GENTLE))


def learns_sway(start: GarmentModel | None, model: GarmentModel, device: torch.device, *, seconds: float) -> bool:
    """Whether a run ends with learning to sway: if it begins with no sway network, on a GPU (a CPU would simulate
    walkers for half a day), in a command of so many seconds.

    start: what training begins with; model: before training; some of its garment nodes must lie where cloth sways.
    """
    enough = device.type == "cuda" and seconds >= LEAST_FOR_SWAY
    return enough and (start is None or start.sway is None) and bool(sway_share(model).any())


def with_own_sway(model: GarmentModel, device: torch.device, *, within: float) -> tuple[GarmentModel, str]:
    """The model with a sway network, and in words how good that is; or as it is, and why it has none.

    within: [s] that simulating walkers may take.
    """
    try:
        learnt = learn_sway(model, SWAY_PLAN, device, within=within, say=log.info)
        swaying = replace(model, sway=rounded_sway(learnt.network, model.rig))
    except (ValueError, RuntimeError) as error:  # of torch too: memory, matrices; the trained model must not be lost
        return model, f"The garment has no sway network: {error}."
    figures = (
        f"cloth of simulated walkers that were held out is {learnt.missed:.0f} mm from it on average, and "
        f"{learnt.without:.0f} mm from cloth that does not swing"
    )
    if learnt.missed <= WORTH * learnt.without:
        return swaying, f"Its own sway network was learnt: {figures}."
    return model, f"The garment has no sway network, as one would gain too little: {figures}."
