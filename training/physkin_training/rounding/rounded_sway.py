"""A learnt sway network with its layers rounded, over motions such as those it was learnt from.

Dimensions: `c` body code.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from physkin_core.model.sway_network import SwayNetwork
from physkin_core.rig.rig import Rig
from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.rounding.compensated_rounding import InputSquares, Rounding, compensated_rounding
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.motions import MotionPool

__all__ = ["rounded_sway"]

WALKERS, SECONDS = 48, 4.0
"""Motions, each of a body with a random code."""
FINE, HALF, OUT, DIRECTIONS = Rounding(1), Rounding(2), Rounding(8), Rounding(1)
ROUNDINGS = {"first": FINE, "drive": FINE, "gate": FINE, "read": HALF, "last": HALF, "out": OUT}
"""What drives oscillators is remembered, and rounded finely."""


def rounded_sway(sway: SwayNetwork, rig: Rig, *, seed: int = 0) -> SwayNetwork:
    """The network with its layers rounded. Raises ValueError for a rig that everyday poses are not of."""
    network = SwayModule.of(sway)
    squares = InputSquares({name: getattr(network, name) for name in ROUNDINGS})
    motions = MotionPool(rig).drawn(range(WALKERS), round(SECONDS * RATE_HZ), seed=seed)
    parts = (torch.as_tensor(part) for part in (motions.positions, motions.place, motions.turn, motions.gravity))
    drive, pose = Features(rig, sway.joints, torch.device("cpu"))(*parts, 1 / RATE_HZ)
    codes = torch.randn(WALKERS, len(sway.code_directions), generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        network(drive, pose, codes, 1 / RATE_HZ)
    rounded = {}
    for name, rounding in ROUNDINGS.items():
        weight, bias = getattr(sway, name)
        rounded[name] = (compensated_rounding(weight, squares.means()[name], rounding), bias)
    directions = compensated_rounding(sway.code_directions, np.eye(sway.code_directions.shape[1]), DIRECTIONS)
    return replace(sway, **rounded, code_directions=directions)
