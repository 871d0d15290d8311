"""`physkin learn-sway`: teach a garment to lag, swing and settle, from walkers that are simulated for it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.model.sway_network import SwayNetwork
from physkin_core.output_file import check_folder, check_other_file
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.cloth_tuning import OffsetLayer, tuned_network
from physkin_training.sway.fading import sway_share
from physkin_training.sway.learning import held_out_millimetres, learnt_network, split
from physkin_training.sway.modules import Features, swaying_joints
from physkin_training.sway.walkers import simulated_walkers

__all__ = ["LearntSway", "SwayPlan", "command_parser", "learn_sway", "main"]

PLAN = {
    "bodies": (1, "bodies to simulate walkers on"),
    "walkers": (2, "walkers on each body"),
    "seconds": (0.5, "length of each motion"),
    "steps": (1, "training steps"),
    "tuning_steps": (0, "steps of fine-tuning by the energies of cloth"),
    "seed": (0, "seed of bodies, motions and training"),
}
"""Smallest value allowed of each number of a `SwayPlan`, and what its option says. Of two walkers one is held out."""


@dataclass(frozen=True)
class SwayPlan:
    """How much is simulated, and for how long it is learnt.

    bodies: how many of the training bodies; walkers: on each of them, with motions of so many seconds. steps,
    tuning_steps: of learning, and of fine-tuning after it. Raises ValueError for a number below those of `PLAN`.
    """

    bodies: int = 128
    walkers: int = 20
    seconds: float = 5.0
    steps: int = 28000
    tuning_steps: int = 9000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, (least, _) in PLAN.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise ValueError(f"--{name.replace('_', '-')} must be at least {least:g}, got {value}")


@dataclass(frozen=True)
class LearntSway:
    """A sway network. missed: how far [mm] it is from the cloth of walkers that were held out. without: how far from it
    cloth would be that does not swing, but stays at the average of all walkers."""

    network: SwayNetwork
    missed: float
    without: float


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin learn-sway`."""
    parser = argparse.ArgumentParser(prog="physkin learn-sway", description=__doc__.split("`: ", 1)[1])
    parser.add_argument("garment", help="garment model file, or the name of a shipped one")
    for entry in fields(SwayPlan):
        option, (_, says) = f"--{entry.name.replace('_', '-')}", PLAN[entry.name]
        says = f"{says} (default %(default)s)"
        parser.add_argument(option, type=type(entry.default), default=entry.default, metavar="NUMBER", help=says)
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument("-o", "--output", type=Path, required=True, help="garment model file to write")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; raises ValueError or OSError for bad input."""
    options = vars(command_parser().parse_args(argv))
    garment, output, device = (options.pop(name) for name in ("garment", "output", "device"))
    plan = SwayPlan(**options)
    check_folder(output)
    check_other_file(output, garment)
    model = load_garment_model(garment)
    device = resolve_device(device)
    if device.type == "cpu":
        torch.set_num_threads(1)  # vectors are short: more threads would only wait for each other
    learnt = learn_sway(model, plan, device, say=print)
    save_garment_model(replace(model, sway=learnt.network), output)
    print(f"wrote {output}: {output.stat().st_size / 1e6:.2f} MB")
    return 0


def learn_sway(
    model: GarmentModel,
    plan: SwayPlan,
    device: torch.device,
    *,
    within: float = math.inf,
    say: Callable[[str], None],
) -> LearntSway:
    """A sway network for a model, which may have one already. within: [s] that simulating may take. say: called with
    sentences on how it goes.

    Raises ValueError for cloth that lies where none sways, for another rig than that of everyday poses, and as
    `SwayPlan` and `simulated_walkers` do.
    """
    share = sway_share(model)
    if not share.any():
        raise ValueError(f"{model.name} lies on chest, shoulders and arms, where cloth does not sway")
    body_model = load_body_model()
    if plan.bodies > len(body_model.train_bodies):
        raise ValueError(f"--bodies must be at most {len(body_model.train_bodies)}, got {plan.bodies}")
    joints = swaying_joints(model, share > 0)
    codes = BodyCodes.of(model, body_model, device)
    walkers = simulated_walkers(
        *(model, body_model, codes, share, device),
        bodies=plan.bodies,
        each=plan.walkers,
        seconds=plan.seconds,
        seed=plan.seed,
        within=within,
        say=say,
    )
    features, generator = Features(model.rig, joints, device), torch.Generator().manual_seed(plan.seed)
    learnt, held_out = split(walkers, generator)
    network = learnt_network(walkers, features, learnt, generator, joints=len(joints), steps=plan.steps)
    mean = torch.zeros(walkers.coefficients.shape[2], device=device)
    without = held_out_millimetres(walkers, features, held_out, lambda hidden: mean, network)
    missed = held_out_millimetres(walkers, features, held_out, network.out, network)
    say(f"learnt: {missed:.1f} mm from what walkers that were held out did; cloth that does not swing {without:.1f} mm")
    if plan.tuning_steps:
        last = tuned_network(
            *(model, body_model, walkers, features, network, learnt, generator), steps=plan.tuning_steps
        )
        missed = held_out_millimetres(walkers, features, held_out, last.coefficients, network)
        say(f"fine-tuned: {missed:.1f} mm from what walkers that were held out did")
    else:
        last = OffsetLayer(network.out, walkers)
    return LearntSway(network.exported(last.folded(), joints, codes), missed, without)
