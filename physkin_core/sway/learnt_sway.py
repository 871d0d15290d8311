"""NumPy reference of a frame of the sway network, in float64; the native one is native/src/evaluator/learnt_sway.cpp.

Oscillators are complex numbers x, driven by b and sped up by s, which the network makes of a frame's drive u:

    x' = s (-rate + i turn) (x - rest),    rest = b (rate + i turn) / |rate + i turn|

solved in closed form, b and s being constant from frame to frame: whatever the rate of frames, nothing else depends on
time. They forget by themselves; where the root is lost, cloth goes over to rest. The first frame begins there.

Dimensions: `d` joint positions, `j` of them looked at, `f = 2 j + 15`, `K` oscillators, `m` garment nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.model.mlp import Layer, silu
from physkin_core.sway.moment import Moment

__all__ = ["LONGEST_STEP", "MOST_SPEED_UP", "LearntSway", "drive_features", "pose_features", "softly"]

BEYOND = 1.5
"""Of joint positions, scaled to [-1, 1] by their limits: what is farther out is taken as this far."""
LARGEST_RATE, LARGEST_VELOCITY, LARGEST_TURNING = 8.0, 4.0, 8.0
"""Of scaled joints [1/s], the root's velocity [m/s] and its turning [rad/s]: what the network sees is never as much."""
LONGEST_STEP = 1.0
"""[s] After that all oscillators are at rest, or near."""
MOST_SPEED_UP = 1.5
"""Logarithm of how many times faster, or slower, a gate lets oscillators run at most."""


def softly(value: np.ndarray, largest: float) -> np.ndarray:
    """The value, where small; it never reaches `largest`."""
    return value / np.sqrt(1 + (value / largest) ** 2)


def pose_features(joints: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """(..., j + 3) of scaled joint positions (..., j) and gravity's direction (..., 3) in the root frame."""
    return np.concatenate([np.clip(joints, -BEYOND, BEYOND), gravity], axis=-1)


def drive_features(
    joints: np.ndarray, gravity: np.ndarray, rate: np.ndarray, velocity: np.ndarray, turning: np.ndarray
) -> np.ndarray:
    """(..., f) of scaled joint positions (..., j) and gravity's direction (..., 3), both the mean of this frame and the
    one before, the joints' rate [1/s], and velocity (..., 3) [m/s] and turning (..., 3) [rad/s] of the root, in its
    frame."""
    rate, v, w = softly(rate, LARGEST_RATE), softly(velocity, LARGEST_VELOCITY), softly(turning, LARGEST_TURNING)
    rates = (rate / 3, v, w / 2, np.cross(w, v) / 4, w * w / 8)
    return np.concatenate([pose_features(joints, gravity), *rates], axis=-1)


class LearntSway:
    """What is kept of the last frame, of one garment with a sway network.

    joints: (j,) indices; lower, upper: (d,) limits [rad] of all; layers, rates, turns: as of `BoundGarment`.
    """

    def __init__(
        self,
        joints: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        layers: Sequence[Layer],
        rates: np.ndarray,
        turns: np.ndarray,
    ) -> None:
        self._joints = joints
        low, high = lower[joints].astype(np.float64), upper[joints].astype(np.float64)
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        self._layers = tuple(layers)
        self._turn = -rates.astype(np.float64) + 1j * turns
        self.forget()

    def forget(self) -> None:
        """The next frame is the first one."""
        self._state: np.ndarray | None = None

    def offsets(self, positions: np.ndarray, gravity: np.ndarray, moment: Moment) -> np.ndarray:
        """What is added to the node deformer's corrections (12 m), at `moment.sway` 1.

        positions: (d,) [rad]. gravity: (3,) direction in the root frame.
        """
        joints = (positions[self._joints] - self._middle) / self._half
        begins = self._state is None or moment.elapsed < 0
        if begins or moment.elapsed > 0:
            self._move(joints, gravity, moment, begins=begins)
        self._before = joints, gravity
        read = np.concatenate([self._state.real, self._state.imag, pose_features(joints, gravity), self._drive])
        *hidden, (weight, bias) = self._layers[2:]
        for layer in hidden:
            read = silu(_linear(layer, read))
        return weight @ read + bias

    def _move(self, joints: np.ndarray, gravity: np.ndarray, moment: Moment, *, begins: bool) -> None:
        if begins or not moment.moves:
            rate, mean, down = np.zeros_like(joints), joints, gravity
            velocity = turning = np.zeros(3)
        else:
            last, last_down = self._before
            rate, mean, down = (joints - last) / moment.elapsed, (joints + last) / 2, (gravity + last_down) / 2
            velocity, turning = np.array(moment.velocity), np.array(moment.turning)
        self._drive = drive_features(mean, down, rate, velocity, turning)
        real, imaginary, gate = np.split(_linear(self._layers[1], silu(_linear(self._layers[0], self._drive))), 3)
        rest = (real + 1j * imaginary) * -self._turn.conj() / np.abs(self._turn)
        if begins:
            self._state = rest
            return
        faster = np.exp(MOST_SPEED_UP * np.tanh(gate))
        kept = np.exp(self._turn * faster * min(moment.elapsed, LONGEST_STEP))
        self._state = kept * self._state + (1 - kept) * rest


def _linear(layer: Layer, x: np.ndarray) -> np.ndarray:
    weight, bias = layer
    return weight @ x + bias
