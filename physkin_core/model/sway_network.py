"""Sway network: how a body moves -> how garment nodes lag, swing and settle; learnt from simulated cloth.

Features of the frame drive damped oscillators, which remember; what is read from them, from the pose and from the drive
is added to the node deformer's corrections. A body comes in as a code, a few directions of its modulation.

Dimensions: `j` joints, `c` body code, `M` modulation of the pose modulator, `h` and `r` hidden widths, `K` oscillators,
`m` garment nodes; `f = 2 j + 15` drive, `p = j + 3` pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from physkin_core.model.mlp import Layer, float32_layers
from physkin_core.model.model_arrays import Array, Linear, described
from physkin_core.native_module import as_float32

__all__ = ["LARGEST_CODE", "SwayNetwork", "drive_size", "fold_body", "pose_size", "shifts_of_body"]

LARGEST_CODE = 4.0
"""Bodies farther out than this, in standard deviations of those of training, are taken as this far."""


def drive_size(joints: int) -> int:
    """Numbers f of the drive: joints and gravity, rates, velocity, turning, their cross product, turning squared."""
    return 2 * joints + 15


def pose_size(joints: int) -> int:
    """Numbers p of the pose: joints and gravity."""
    return joints + 3


@dataclass(frozen=True)
class SwayNetwork:
    """Network weights (out, in) and biases (out,), float32; checked by the `GarmentModel` that they are part of.

    joints: (j,) int32, the rig's degrees of freedom that it looks at. first: (h, f), followed by SiLU; first_code:
    (h, c), of the body. drive: (2 K, h), real parts and then imaginary ones; gate: (K, h), how much faster oscillators
    run. rates (K,) [1/s], above 0, by which they decay; turns (K,) [rad/s] by which they oscillate.
    read: (r, 2 K + p + f) over states, pose and drive, and last: both followed by SiLU; read_code: (r, c).
    out: (12 m, last), linear. code_mean: (M,); code_directions: (c, M).
    """

    joints: np.ndarray = described("joints", Array("j", below="d"))
    code_mean: np.ndarray = described("code.mean", Array("pose_modulation"))
    code_directions: np.ndarray = described("code.directions", Array("code pose_modulation"))
    first: Layer = described("first", Linear("h", "drive"))
    first_code: np.ndarray = described("first.code", Array("h code"))
    rates: np.ndarray = described("rates", Array("states"))
    turns: np.ndarray = described("turns", Array("states"))
    drive: Layer = described("drive", Linear("2states", "h"))
    gate: Layer = described("gate", Linear("states", "h"))
    read: Layer = described("read", Linear("r", "2states+pose+drive"))
    read_code: np.ndarray = described("read.code", Array("r code"))
    last: Layer = described("last", Linear("l", "r"))
    out: Layer = described("out", Linear("12m", "l"))

    @cached_property
    def drive_and_gate(self) -> Layer:
        """Both, which read the same, as one layer: the same arrays for all bodies."""
        (drive, drive_bias), (gate, gate_bias) = self.drive, self.gate
        return as_float32(np.concatenate([drive, gate])), as_float32(np.concatenate([drive_bias, gate_bias]))

    def body_code(self, modulation: np.ndarray) -> np.ndarray:
        """(c,) float64 of the modulation (M,) that the hyper modulator gives for a body."""
        code = self.code_directions.astype(np.float64) @ (modulation - self.code_mean.astype(np.float64))
        return np.clip(code, -LARGEST_CODE, LARGEST_CODE)


def shifts_of_body(network: SwayNetwork, modulation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the body of a modulation (M,) adds to `first` (h,) and `read` (r,), before SiLU."""
    code = network.body_code(modulation)
    return network.first_code @ code, network.read_code @ code


def fold_body(network: SwayNetwork, modulation: np.ndarray) -> dict[str, object]:
    """The fields of `BoundGarment` that a sway network fills, for the body of a modulation (M,).

    Its code becomes part of biases.
    """
    of_first, of_read = shifts_of_body(network, modulation)
    layers = (
        (network.first[0], network.first[1] + of_first),
        network.drive_and_gate,
        (network.read[0], network.read[1] + of_read),
        network.last,
        network.out,
    )
    return {
        "sway_joints": np.ascontiguousarray(network.joints, dtype=np.int32),
        "sway_layers": float32_layers(layers),
        "sway_rates": as_float32(network.rates),
        "sway_turns": as_float32(network.turns),
    }
