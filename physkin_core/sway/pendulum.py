"""NumPy reference of the pendulum that stands for swinging cloth; the native one is native/src/sway/pendulum.cpp.

Its deflection y [m/s2, world frame] is the acceleration that cloth seems to feel besides gravity. Sideways and along
gravity, and as the twist [rad] of cloth about the root's vertical, each as an oscillator of its own,

    y'' = -w^2 (y - y_eq) - D y',    y_eq = -gain (a + c v),

v and a the velocity and acceleration of the root, c the drag of still air: under steady acceleration or at constant
speed y ends at y_eq. Of a twist v is how fast the root turns, and the gain 1 / w^2: a torsion pendulum. Of a deflection
that is hardly there less is felt, as cloth rubs at itself. The root moves on a straight line from one pose to the next,
and turns steadily, so that its acceleration is a jump of v at each; between them the equation is solved in closed form,
whatever time has passed: nothing depends on a rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

__all__ = ["LARGEST_GAP", "PendulumSettings", "ReferencePendulum"]

LARGEST_GAP = 0.25
"""Poses farther apart [s] than this say nothing of how the root moved between them."""
LARGEST_CHANGE = 8.0
"""[m/s] a change of velocity from pose to pose beyond this is a jump of the root, not a motion."""
LARGEST_CHANGE_OF_TURNING = 20.0
"""[rad/s] the same of turning."""
LARGEST_TWIST = 0.8
"""[rad] what the twist never reaches."""
GRAVITY = 9.81
LARGEST_DEFLECTION = 2 * GRAVITY
"""[m/s2] what the deflection that is felt never reaches."""
LEAST_DEFLECTION = 0.25
"""[m/s2] of a deflection of this size half is felt, of smaller ones the less."""
LARGEST_FELT = 2.999 * GRAVITY
"""[m/s2] training knows no more."""
FARTHEST = 1e9
"""[m] that the root may be from the world's origin."""


@dataclass(frozen=True)
class PendulumSettings:
    """frequency [Hz], damping D [1/s] and gain of cloth that swings sideways; lift_frequency [Hz] and lift_gain along
    gravity, where it is damped without overshoot; twist_damping D [1/s] of cloth that twists, at the frequency of
    swinging; air_drag c [1/s], that of the simulation. Fitted to simulated skirts and dresses by least squares; the
    gain is above 1 as drapes lean less under effective gravity than simulated cloth.

    Raises ValueError for a value that is not finite or out of range, naming it.
    """

    frequency: float = 1.5
    damping: float = 4.0
    gain: float = 3.5
    lift_frequency: float = 5.0
    lift_gain: float = 1.0
    twist_damping: float = 7.0
    air_drag: float = 2.0

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            least = 0.05 if name.endswith("frequency") else 0.0
            if not (math.isfinite(value) and least <= value <= 100):
                raise ValueError(f"pendulum {name} is {value}, allowed: {least:g} to 100")


class ReferencePendulum:
    """State of one avatar's cloth."""

    def __init__(self, settings: PendulumSettings) -> None:
        self._settings = settings
        sideways, along = 2 * math.pi * settings.frequency, 2 * math.pi * settings.lift_frequency
        self._frequency = np.array([sideways, sideways, along, sideways])
        self._damping = np.array([settings.damping, settings.damping, 2 * along, settings.twist_damping])
        self._gain = np.array([settings.gain, settings.gain, settings.lift_gain, 1 / sideways**2])
        self.reset()

    def reset(self) -> None:
        """Cloth hangs still, and nothing is known of the root."""
        self._deflection, self._rate = np.zeros(4), np.zeros(4)
        self._time: float | None = None
        self._position, self._turn, self._velocity = np.zeros(3), np.zeros(4), None
        self._turning = np.zeros(3)

    def felt(self, time: float, root: np.ndarray, amount: float, out: np.ndarray) -> None:
        """Move the root, then write effective gravity [m/s2] in its frame, and the twist [rad], to `out` (4,); see
        `Sway.felt`."""
        if len(root) != 7 or not (math.isfinite(time) and np.isfinite(root).all()):
            raise ValueError(f"time {time} and root {root} must be finite, root x, y, z and a quaternion x, y, z, w")
        length = np.linalg.norm(root[3:])
        if abs(length - 1) > 0.01:
            raise ValueError(f"the quaternion of root must be of length 1, got {root[3:]}")
        if np.abs(root[:3]).max() > FARTHEST:
            raise ValueError(f"the root must be within {FARTHEST:g} m, got {root[:3]}")
        turn = root[3:] / length
        self.move(time, root[:3], turn)
        felt = amount * self._felt_deflection() - [0, 0, GRAVITY]
        felt = _carried_back(turn, felt)
        out[:3] = felt * min(1.0, LARGEST_FELT / max(np.linalg.norm(felt), 1e-9))
        twist = self._deflection[3]
        out[3] = amount * twist / math.sqrt(1 + (twist / LARGEST_TWIST) ** 2)

    def motion(self, out: np.ndarray) -> bool:
        """Write the root's velocity (3) [m/s] and turning (3) [rad/s] from the pose before the last one to that, in its
        frame, to `out` (6,). Whether they are known; after a gap or a jump they are not, and zero."""
        out[:] = 0.0
        if self._velocity is not None:
            out[:3], out[3:] = _carried_back(self._turn, self._velocity[:3]), self._turning
        return self._velocity is not None

    def _felt_deflection(self) -> np.ndarray:
        deflection = self._deflection[:3]
        square = deflection @ deflection
        share = square / (square + LEAST_DEFLECTION**2)
        return deflection * share / math.sqrt(1 + square / LARGEST_DEFLECTION**2)

    def move(self, time: float, position: np.ndarray, turn: np.ndarray) -> None:
        """The root is at `position` (3,) [m] in the world at `time` [s], turned by the unit quaternion `turn` (4,).

        A time that came before changes nothing, or, where it lies back, begins anew from there. After a gap or a jump
        cloth swings on by itself: it returns to rest without being thrown.
        """
        position = np.asarray(position, dtype=np.float64)
        passed = math.inf if self._time is None else time - self._time
        if passed == 0:
            return
        last, self._time = self._time, time
        velocity = None
        if last is not None and 0 < passed <= LARGEST_GAP:
            self._turning = _rotation(self._turn, turn) / passed
            velocity = np.append((position - self._position) / passed, self._turning[2] * _upright(turn))
            if self._velocity is not None:
                change = velocity - self._velocity
                if np.linalg.norm(change[:3]) > LARGEST_CHANGE or abs(change[3]) > LARGEST_CHANGE_OF_TURNING:
                    velocity = None
        self._position, self._turn = position.copy(), turn.copy()
        if velocity is None:
            equilibrium = np.zeros(4)
        else:
            if self._velocity is not None:
                self._rate -= self._gain * self._frequency**2 * change
            equilibrium = -self._gain * self._settings.air_drag * velocity
        self._velocity = velocity
        if last is not None and passed > 0:
            self._swing(passed, equilibrium)

    def _swing(self, passed: float, equilibrium: np.ndarray) -> None:
        half = self._damping / 2
        square = self._frequency**2 - half**2
        root = np.sqrt(np.abs(square))
        under = square > 0
        # cos, sin / w, or their hyperbolic twins, times the decay; the decay is inside, as cosh alone overflows
        decay = np.exp(-half * passed)
        slow, fast = np.exp(-(half - root) * passed), np.exp(-(half + root) * passed)
        safe = np.maximum(root, 1e-9)
        cosine = np.where(under, decay * np.cos(root * passed), (slow + fast) / 2)
        sine = np.where(under, decay * np.sin(root * passed) / safe, (slow - fast) / (2 * safe))
        sine = np.where(root * passed < 1e-6, decay * passed, sine)
        away, rate = self._deflection - equilibrium, self._rate
        self._deflection = (cosine + half * sine) * away + sine * rate + equilibrium
        self._rate = -(self._frequency**2) * sine * away + (cosine - half * sine) * rate


def _rotation(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] in the root's frame, by which it has turned between two unit quaternions (4,)."""
    x, y, z, w = after
    a, b, c, d = before
    axis = np.array(  # of the rotation inverse(before) after
        [d * x - w * a - b * z + c * y, d * y - w * b - c * x + a * z, d * z - w * c - a * y + b * x]
    )
    cosine = d * w + a * x + b * y + c * z
    length = np.linalg.norm(axis)
    return axis * (math.copysign(2.0, cosine) * math.atan2(length, abs(cosine)) / max(length, 1e-12))


def _upright(turn: np.ndarray) -> float:
    """How far the vertical of a root is that of the world, 0 to 1: cloth of who rolls on the floor does not hang about
    it."""
    return max(0.0, 1 - 2 * (turn[0] * turn[0] + turn[1] * turn[1]))


def _carried_back(turn: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector (3,) of the world in the frame of a root turned by a unit quaternion (4,)."""
    axis, w = turn[:3], turn[3]
    across = np.cross(axis, vector)
    return vector + 2 * np.cross(axis, across) - 2 * w * across
