"""The pendulum that stands for swinging cloth without a sway network.

Its deflection y [m/s2, world frame] is the acceleration that cloth seems to feel besides gravity. Sideways and along
gravity, and as the twist [rad] of cloth about the root's vertical, each as an oscillator of its own,

    y'' = -w^2 (y - y_eq) - D y',    y_eq = -gain (a + c v),

v and a the velocity and acceleration of the root, c the drag of still air. Of a twist v is how fast the root turns, and
the gain 1 / w^2: a torsion pendulum. Of a deflection that is hardly there less is felt, as cloth rubs at itself. The
root moves on a straight line from one pose to the next, and turns steadily, so that its acceleration is a jump of v at
each; between them the equation is solved in closed form, whatever time has passed.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.81
LARGEST_GAP = 0.25
"""[s] Poses farther apart say nothing of how the root moved between them."""
LARGEST_CHANGE, LARGEST_CHANGE_OF_TURNING = 8.0, 20.0
"""[m/s, rad/s] A change of velocity, or of turning, from pose to pose beyond this is a jump, not a motion."""
LARGEST_TWIST, LARGEST_DEFLECTION = 0.8, 2 * GRAVITY
"""[rad, m/s2] What the twist, and the deflection that is felt, never reach."""
LEAST_DEFLECTION = 0.25
"""[m/s2] Of a deflection of this size half is felt, of smaller ones the less."""
LARGEST_FELT = 2.999 * GRAVITY
"""[m/s2] Training knows no more."""


@dataclass(frozen=True)
class Settings:
    """frequency [Hz], damping D [1/s] and gain sideways; lift_frequency [Hz] and lift_gain along gravity, where it is
    damped without overshoot; twist_damping D [1/s], at the frequency of swinging; air_drag c [1/s]."""

    frequency: float = 1.5
    damping: float = 4.0
    gain: float = 3.5
    lift_frequency: float = 5.0
    lift_gain: float = 1.0
    twist_damping: float = 7.0
    air_drag: float = 2.0


class Pendulum:
    """State of one avatar's cloth."""

    def __init__(self, settings=Settings()):
        sideways, along = 2 * math.pi * settings.frequency, 2 * math.pi * settings.lift_frequency
        self._frequency = np.array([sideways, sideways, along, sideways])
        self._damping = np.array([settings.damping, settings.damping, 2 * along, settings.twist_damping])
        self._gain = np.array([settings.gain, settings.gain, settings.lift_gain, 1 / sideways**2])
        self._drag = settings.air_drag
        self._deflection, self._rate = np.zeros(4), np.zeros(4)
        self._time, self._velocity = None, None

    def felt(self, time, root, amount):
        """Move the root (7,), position and quaternion x, y, z, w, to where it is at `time` [s]; a time that comes twice
        changes nothing. Returns effective gravity (3,) [m/s2] in its frame, and the twist [rad], of cloth that sways by
        `amount`."""
        self._move(time, np.asarray(root[:3], dtype=np.float64), Rotation.from_quat(root[3:]))
        *deflection, twist = self._deflection
        square = np.square(deflection).sum()
        share = square / (square + LEAST_DEFLECTION**2) / math.sqrt(1 + square / LARGEST_DEFLECTION**2)
        felt = self._turn.inv().apply(amount * share * np.array(deflection) - [0, 0, GRAVITY])
        felt *= min(1.0, LARGEST_FELT / max(np.linalg.norm(felt), 1e-9))
        return felt, amount * twist / math.sqrt(1 + (twist / LARGEST_TWIST) ** 2)

    def motion(self):
        """The root's velocity (3,) and turning (3,) up to the last pose, in its frame; None after a gap or jump."""
        return None if self._velocity is None else (self._turn.inv().apply(self._velocity[:3]), self._turning)

    def _move(self, time, position, turn):
        passed = math.inf if self._time is None else time - self._time
        if passed == 0:
            return
        velocity, change = None, np.zeros(4)
        if 0 < passed <= LARGEST_GAP:
            self._turning = (self._turn.inv() * turn).as_rotvec() / passed
            upright = max(0.0, turn.as_matrix()[2, 2])  # cloth of who rolls on the floor does not hang about it
            velocity = np.append((position - self._position) / passed, self._turning[2] * upright)
            change = velocity - self._velocity if self._velocity is not None else change
            if np.linalg.norm(change[:3]) > LARGEST_CHANGE or abs(change[3]) > LARGEST_CHANGE_OF_TURNING:
                velocity, change = None, np.zeros(4)
        self._rate -= self._gain * self._frequency**2 * change
        if 0 < passed < math.inf:
            moved = np.zeros(4) if velocity is None else velocity
            self._swing(passed, -self._gain * self._drag * moved)
        self._time, self._position, self._turn, self._velocity = time, position, turn, velocity

    def _swing(self, passed, equilibrium):
        """Solve the equation: with w' the square root of w^2 - (D / 2)^2, which is imaginary where cloth creeps, by
        cos(w' t) and sin(w' t) / w', both times the decay exp(-D t / 2)."""
        half = self._damping / 2
        own = np.sqrt((self._frequency**2 - half**2).astype(complex))
        turning, back = np.exp((1j * own - half) * passed), np.exp((-1j * own - half) * passed)
        cosine = ((turning + back) / 2).real
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.where(np.abs(own) * passed < 1e-6, passed * np.exp(-half * passed), (turning - back) / (2j * own))
        away, rate, sine = self._deflection - equilibrium, self._rate, sine.real
        self._deflection = (cosine + half * sine) * away + sine * rate + equilibrium
        self._rate = -(self._frequency**2) * sine * away + (cosine - half * sine) * rate
