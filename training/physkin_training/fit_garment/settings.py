"""How a garment of one's own is fitted: settings, their options on the command line, and what they may be."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import torch

from physkin_core.outfit.outfit_options import add_avatar_options
from physkin_training.devices import DEFAULT_DEVICE
from physkin_training.fit_garment.first_model import NOTHING
from physkin_training.fit_garment.sewn_mesh import EDGE_LENGTH
from physkin_training.fit_garment.training_time import ADVICE, FEWEST_STEPS
from physkin_training.train.run import CHECKPOINT_EVERY

__all__ = ["FitSettings", "add_fit_options"]

DEFAULT_MINUTES = {"cuda": 15.0, "cpu": 480.0}
"""A GPU in minutes, a CPU overnight."""
LEAST_MINUTES = {"cuda": 1.0, "cpu": 4.0}
"""Of the default recipe: half of it or more passes before the first step and after the last one."""


@dataclass(frozen=True)
class FitSettings:
    """How a garment is checked, trained and reported on.

    Attributes:
        avatar: file of the avatar that the garment was made on; None: the body of the shipped garments.
        rig, bones: rig file of an avatar without a skeleton, bones file of one with.
        edge_length: [m] of the triangles that a sewing pattern is cut into; None: `EDGE_LENGTH`. Not for a mesh.
        objects: of a mesh file those to take, see `chosen_objects`; empty: all, which must then be one garment.
        accept_placement: whether a garment is trained though its place on the avatar is in doubt.
        check_only: whether all ends after the checks.
        minutes: for everything; None: the device's default, or as long as `steps` take.
        steps: of training.
        start: garment model to start training from, or "nothing"; None: the shipped one that is most like it.
        recipe: training configuration for everything else.
        resume: whether to go on from the checkpoint of a stopped run, where there is one.
        device: see `resolve_device`.
        checkpoint_every: [s].
        bodies, poses: that the report measures on, poses for each body.

    Raises:
        ValueError: for minutes or steps that cannot be.
    """

    avatar: str | None = None
    rig: str | None = None
    bones: str | None = None
    edge_length: float | None = None
    objects: Sequence[str] = ()
    accept_placement: bool = False
    check_only: bool = False
    minutes: float | None = None
    steps: int | None = None
    start: str | None = None
    recipe: Path | None = None
    resume: bool = False
    device: str = DEFAULT_DEVICE
    checkpoint_every: float = CHECKPOINT_EVERY
    bodies: int = 8
    poses: int = 64

    def __post_init__(self) -> None:
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise ValueError(f"--minutes {self.minutes:g} must be above 0 and finite")
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"--steps {self.steps} must be at least 1")

    @classmethod
    def of(cls, options: argparse.Namespace) -> FitSettings:
        """As options of a command say. Raises ValueError."""
        given = vars(options)
        return cls(**{entry.name: given[entry.name] for entry in fields(cls) if given.get(entry.name) is not None})

    def time_on(self, device: torch.device) -> float:
        """Minutes that all may take, infinite where steps are given. Raises ValueError where they are too few."""
        if self.steps:
            return math.inf
        least, default = LEAST_MINUTES[device.type], DEFAULT_MINUTES[device.type]
        if self.minutes is None or self.minutes >= least or self.recipe or self.check_only:
            return self.minutes or default
        raise ValueError(
            f"--minutes {self.minutes:g} is too little on a {device.type.upper()}: at least {least:g} are needed for "
            f"{FEWEST_STEPS} steps, and {default:g} for a garment to use; {ADVICE}"
        )


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Options of fitting a garment that `FitSettings.of` reads, for one garment and for a catalogue of them."""
    add_avatar_options(parser, made_on=True)
    parser.add_argument(
        "--edge-length",
        type=float,
        metavar="M",
        help=f"edge length of the triangles that a pattern is cut into [m] (default {EDGE_LENGTH:g})",
    )
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
        dest="start",
        metavar="NAME",
        help=f"garment model to start training from, or {NOTHING} (default: the shipped one that is most like it)",
    )
    parser.add_argument("--recipe", type=Path, metavar="TOML", help="training configuration for everything else")
