"""`physkin learn-sway`: teach a garment to lag, swing and settle, from walkers that are simulated for it."""

from __future__ import annotations

import argparse
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.model.sway_network import SwayNetwork
from physkin_core.output_file import check_folder, check_other_file
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.cloth_tuning import OffsetLayer, tuned_network
from physkin_training.sway.export import exported
from physkin_training.sway.fading import sway_share
from physkin_training.sway.learning import held_out_millimetres, learnt_network, split
from physkin_training.sway.modules import Features, swaying_joints
from physkin_training.sway.walkers import simulated_walkers
from physkin_training.sway.walkers_file import load_walkers, save_walkers

__all__ = ["LearntSway", "SwayPlan", "command_parser", "learn_sway", "main"]

SHORTEST = 0.5
"""[s] of a motion."""


@dataclass(frozen=True)
class SwayPlan:
    """How much is simulated, and for how long it is learnt.

    bodies: of training; walkers on each of them at once; rounds of all of these, motions of so many seconds.
    steps of learning, and of fine-tuning.
    Raises ValueError for a number that cannot be.
    """

    bodies: int = 128
    walkers: int = 5
    rounds: int = 4
    seconds: float = 5.0
    steps: int = 28000
    tuning_steps: int = 9000
    seed: int = 0

    def __post_init__(self) -> None:
        least = {"bodies": 1, "walkers": 1, "rounds": 1, "seconds": SHORTEST, "steps": 1, "tuning_steps": 0, "seed": 0}
        for name, allowed in least.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= allowed):
                raise ValueError(f"--{name.replace('_', '-')} must be at least {allowed:g}, got {value}")
        if self.bodies * self.walkers * self.rounds == self.bodies:
            raise ValueError("one walker a body is too few: some are held out; raise --walkers or --rounds")


@dataclass(frozen=True)
class LearntSway:
    """A sway network. missed: [mm] how far cloth of walkers that were held out is from it. without: and from cloth that
    stays where all walkers' cloth is on average, and does not swing."""

    network: SwayNetwork
    missed: float
    without: float


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin learn-sway`."""
    plan = SwayPlan()
    parser = argparse.ArgumentParser(prog="physkin learn-sway", description=__doc__.split("`: ", 1)[1])
    parser.add_argument("garment", help="garment model file, or the name of a shipped one")
    parser.add_argument(
        "--bodies", type=int, default=plan.bodies, help="bodies to simulate walkers on (default %(default)s)"
    )
    parser.add_argument("--walkers", type=int, default=plan.walkers, help="walkers on each body (default %(default)s)")
    parser.add_argument("--rounds", type=int, default=plan.rounds, help="motions of each walker (default %(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=plan.seconds, help="length of each motion (default %(default)s)"
    )
    parser.add_argument("--steps", type=int, default=plan.steps, help="training steps (default %(default)s)")
    parser.add_argument(
        "--tuning-steps",
        type=int,
        default=plan.tuning_steps,
        metavar="STEPS",
        help="steps of fine-tuning by the energies of cloth (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=plan.seed, help="seed of bodies, motions and training (default 0)")
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "--walkers-file",
        type=Path,
        metavar="FILE",
        help="keep the simulated walkers in this file (.safetensors), or take them from it if it exists",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="garment model file to write")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; raises ValueError or OSError for bad input."""
    options = vars(command_parser().parse_args(argv))
    garment, output, device, file = (options.pop(name) for name in ("garment", "output", "device", "walkers_file"))
    plan = SwayPlan(**options)
    for written in filter(None, (output, file)):
        check_folder(written)
    check_other_file(output, garment, *filter(None, [file]))
    if file is not None and file.resolve() == output.resolve():
        raise ValueError(f"cannot write {output}: --walkers-file has the same name; give another")
    model = load_garment_model(garment)
    device = resolve_device(device)
    if device.type == "cpu":
        torch.set_num_threads(1)  # vectors are short: more threads would only wait for each other
    learnt = learn_sway(model, plan, device, walkers_file=file, say=print)
    save_garment_model(replace(model, sway=learnt.network), output)
    print(f"wrote {output}: {output.stat().st_size / 1e6:.2f} MB")
    return 0


def learn_sway(
    model: GarmentModel,
    plan: SwayPlan,
    device: torch.device,
    *,
    walkers_file: Path | None = None,
    within: float = math.inf,
    say: Callable[[str], None],
) -> LearntSway:
    """A sway network for a model, which may have one already. walkers_file: simulated walkers are read from there, or
    written to it. within: [s] that simulating may take. say: told how it goes.

    Raises ValueError for cloth that lies where none sways, for a rig that everyday poses are not of, and as
    `SwayPlan`, `simulated_walkers` and `load_walkers`.
    """
    share = sway_share(model)
    if not share.any():
        raise ValueError(f"{model.name} lies on chest, shoulders and arms, where cloth does not sway")
    body_model = load_body_model()
    if plan.bodies > len(body_model.train_bodies):
        raise ValueError(f"--bodies must be at most {len(body_model.train_bodies)}, got {plan.bodies}")
    joints = swaying_joints(model, share > 0)
    codes = BodyCodes.of(model, body_model, device)
    described = _described(model, plan)
    if walkers_file is not None and walkers_file.exists():
        walkers = load_walkers(described, walkers_file, device)
        say(f"walkers of {walkers_file}: {len(walkers.body)}")
    else:
        walkers = simulated_walkers(
            *(model, body_model, codes, share, device),
            bodies=plan.bodies,
            each=plan.walkers,
            rounds=plan.rounds,
            seconds=plan.seconds,
            seed=plan.seed,
            within=within,
            say=say,
        )
        if walkers_file is not None:
            save_walkers(walkers, described, walkers_file)
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
    return LearntSway(exported(network, last.folded(), joints, codes), missed, without)


def _described(model: GarmentModel, plan: SwayPlan) -> dict[str, object]:
    """What simulated walkers depend on, as plain data."""
    networks = hashlib.sha256(b"".join(np.ascontiguousarray(array) for layer in model.node_deformer for array in layer))
    simulated = ("bodies", "walkers", "rounds", "seconds", "seed")
    return {"garment": model.name, "networks": networks.hexdigest()} | {name: getattr(plan, name) for name in simulated}
