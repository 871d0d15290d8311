"""The sway network: how a body moves -> what garment nodes lag and swing by. Oscillators x are complex numbers, driven
by b and sped up by s, which the network makes of a frame's drive:

    x' = s (-rate + i turn) (x - rest),    rest = b (rate + i turn) / |rate + i turn|

solved in closed form, b and s being constant from frame to frame: nothing depends on the rate of frames.

Dimensions: `j` joints looked at, `K` oscillators, `p = j + 3` pose, `f = 2 j + 15` drive.
"""

import numpy as np

from reference.networks import linear, mlp, silu

BEYOND = 1.5
"""Of joint positions scaled to [-1, 1]: what is farther out is taken as this far."""
LARGEST_RATE, LARGEST_VELOCITY, LARGEST_TURNING = 8.0, 4.0, 8.0
"""Of scaled joints [1/s], the root's velocity [m/s] and its turning [rad/s]: what the network sees is never as much."""
LONGEST_STEP = 1.0
"""[s] after which oscillators are at rest, or near."""
MOST_SPEED_UP = 1.5
"""Logarithm of how many times faster, or slower, a gate lets oscillators run at most."""


LIES_ON, HANGS = 0.5, 0.85
"""How upright the less upright thigh is where cloth that lies on it sways no longer, and where it sways in full."""
TOGETHER, APART = 0.3, 0.6
"""How far apart unit vectors along raised thighs are where cloth sways in full all the same, and where no longer."""


class SwayNetwork:
    """Of one garment, with what is kept of the last frame.

    garment: sway_joints (j,), sway_layers, sway_rates, sway_turns (K,), sway_thighs (t,), and limits dof_lower,
    dof_upper (d,).
    """

    def __init__(self, garment):
        self._joints = garment.sway_joints
        lower, upper = (limit[self._joints].astype(np.float64) for limit in (garment.dof_lower, garment.dof_upper))
        self._middle, self._half = (lower + upper) / 2, (upper - lower) / 2
        self._layers, self._thighs = garment.sway_layers, garment.sway_thighs
        self._own = -garment.sway_rates.astype(np.float64) + 1j * garment.sway_turns
        self.forget()

    def forget(self):
        """The next frame is the first one: it is at rest."""
        self._state = None

    def offsets(self, positions, row):
        """(12 m,) what is added to the node deformer's corrections, at sway 1. positions: (d,). row: a
        `FrameInput`."""
        joints = (positions[self._joints] - self._middle) / self._half
        begins = self._state is None or row.elapsed < 0
        if begins or row.elapsed > 0:
            self._move(joints, row, begins)
        self._before = joints, row.gravity
        pose = np.r_[np.clip(joints, -BEYOND, BEYOND), row.gravity]
        return mlp(self._layers[2:], np.r_[self._state.real, self._state.imag, pose, self._drive])

    def share(self, bones):
        """How much of it is left where thighs are raised, 0 to 1. bones: transforms (b, 3, 4)."""
        along = np.array([bones[k][:3, 2] for k in self._thighs]).reshape(-1, 3)
        hangs = smooth_step((along[:, 2].min(initial=1.0) - LIES_ON) / (HANGS - LIES_ON))
        if len(along) < 2:
            return hangs
        apart = np.linalg.norm(along - along[0], axis=1).max()
        return max(hangs, smooth_step((APART - apart) / (APART - TOGETHER)))

    def _move(self, joints, row, begins):
        moves = bool(row.moves) and not begins
        last, last_gravity = self._before if moves else (joints, row.gravity)
        rate = softly((joints - last) / row.elapsed, LARGEST_RATE) if moves else 0 * joints
        v, w = softly(moves * row.velocity, LARGEST_VELOCITY), softly(moves * row.turning, LARGEST_TURNING)
        mean, down = np.clip((joints + last) / 2, -BEYOND, BEYOND), (row.gravity + last_gravity) / 2
        self._drive = np.r_[mean, down, rate / 3, v, w / 2, np.cross(w, v) / 4, w * w / 8]
        real, imaginary, gate = np.split(linear(self._layers[1], silu(linear(self._layers[0], self._drive))), 3)
        rest = (real + 1j * imaginary) * -self._own.conj() / np.abs(self._own)
        if begins:
            self._state = rest
        else:
            faster = np.exp(MOST_SPEED_UP * np.tanh(gate))
            kept = np.exp(self._own * faster * min(row.elapsed, LONGEST_STEP))
            self._state = kept * self._state + (1 - kept) * rest


def softly(value, largest):
    """The value, where small; it never reaches `largest`."""
    return value / np.sqrt(1 + (value / largest) ** 2)


def smooth_step(u):
    """0 before 0, 1 after 1."""
    u = np.clip(u, 0, 1)
    return u**2 * (3 - 2 * u)
