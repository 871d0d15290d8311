"""Options of `physkin fit-garment`: what they may be, and how long a garment takes by default."""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path

import torch

from physkin_core.outfit.outfit_options import add_avatar_options
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.fit_garment.first_model import NOTHING
from physkin_training.fit_garment.sewn_mesh import EDGE_LENGTH

__all__ = ["ADVICE", "DEFAULT_MINUTES", "FEWEST_STEPS", "add_training_options", "checked_device", "command_parser"]

DESCRIPTION = "Check, repair and train a garment mesh or a sewing pattern of your own, and write a report."
DEFAULT_MINUTES = {"cuda": 15.0, "cpu": 480.0}
"""A GPU in minutes, a CPU overnight."""
LEAST_MINUTES = {"cuda": 1.0, "cpu": 4.0}
"""Of the default recipe: half of it or more passes before the first step and after the last one."""
FEWEST_STEPS = 100
"""Shorter runs do not even get through the warm-up."""
ADVICE = "give more, or a smaller recipe with --recipe"


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin fit-garment`."""
    parser = argparse.ArgumentParser(prog="physkin fit-garment", description=DESCRIPTION)
    parser.add_argument(
        "garment", type=Path, help="garment mesh: OBJ, PLY, STL, OFF, GLB or glTF; or a sewing pattern: JSON"
    )
    parser.add_argument(
        "--edge-length",
        type=float,
        metavar="M",
        help=f"edge length of the triangles that a pattern is cut into [m] (default {EDGE_LENGTH:g})",
    )
    add_avatar_options(parser, made_on=True)
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        required=True,
        metavar="NAME.safetensors",
        help="garment model to write; NAME.html is the report, and all else goes into the folder NAME",
    )
    parser.add_argument(
        "--check-only",
        action="store_true",
        help="stop after the checks: print the verdicts, write the repaired mesh and a picture",
    )
    add_training_options(parser)
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue from the checkpoint of a stopped run, if there is one, with its steps and recipe",
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    return parser


def add_training_options(parser: argparse.ArgumentParser) -> None:
    """Options of training a garment and of its report, also for a catalogue of garments."""
    parser.add_argument(
        "--accept-placement",
        action="store_true",
        help="train even if the place of the garment on the avatar is in doubt",
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--minutes", type=float, help="minutes for a garment and its report (default: 15 on a GPU, 480 on a CPU)"
    )
    length.add_argument(
        "--steps", type=int, help="training steps, instead of --minutes; report and sway take additional time"
    )
    parser.add_argument(
        "--from",
        metavar="NAME",
        help=f"garment model to start training from, or {NOTHING} (default: the shipped one that is most like it)",
    )
    parser.add_argument("--recipe", type=Path, metavar="TOML", help="training configuration for everything else")
    parser.add_argument(
        "--checkpoint-every", type=float, default=5.0, metavar="MINUTES", help="minutes between checkpoints (default 5)"
    )
    parser.add_argument("--bodies", type=int, default=8, help="bodies that the report measures on (default 8)")
    parser.add_argument(
        "--poses", type=int, default=64, help="poses that the report measures on each body (default 64)"
    )


def checked_device(options: argparse.Namespace) -> torch.device:
    """What to train on. Raises ValueError for options that cannot be."""
    output: Path = options.output
    if output.suffix != ".safetensors" or not re.fullmatch(r"\w[\w. -]*", output.stem):
        raise ValueError(f"cannot write {output}: the name must be a plain one that ends in .safetensors")
    if options.minutes is not None and not 0 < options.minutes < math.inf:
        raise ValueError(f"--minutes {options.minutes} must be above 0")
    if options.steps is not None and options.steps < 1:
        raise ValueError(f"--steps {options.steps} must be at least 1")
    if not options.checkpoint_every > 0:
        raise ValueError(f"--checkpoint-every {options.checkpoint_every:g} must be above 0 minutes")
    device = resolve_device(options.device)
    least = LEAST_MINUTES[device.type]
    if options.minutes is not None and options.minutes < least and not (options.recipe or options.check_only):
        raise ValueError(
            f"--minutes {options.minutes:g} is too little on a {device.type.upper()}: at least {least:g} are needed "
            f"for {FEWEST_STEPS} steps, and {DEFAULT_MINUTES[device.type]:g} for a garment to use; {ADVICE}"
        )
    return device
