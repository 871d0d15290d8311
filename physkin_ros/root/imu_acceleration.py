"""What garments feel by an IMU at the root: its acceleration, smoothed."""

from __future__ import annotations

import math

import numpy as np

from physkin_core.runtime.frame_input import LARGEST_EFFECTIVE_GRAVITY, STANDARD_GRAVITY
from physkin_ros.root.gravity import SAME_CLOCK, EffectiveGravity, gravity_from_imu
from physkin_ros.root.quaternions import OrientationError, inverse, quaternion_of, rotated, unit_quaternion, vector_of

__all__ = ["ImuAcceleration"]

DELAY = 0.1
"""[s] Time constant of the low pass, by which slow changes come late."""
LARGEST_GAP = 500_000_000
"""[ns] After a longer pause the root is taken to have come to rest."""
LARGEST_FORCE = 1000.0
"""[m/s2] beyond what any IMU on a body measures."""
LARGEST_EFFECTIVE = 0.9999 * LARGEST_EFFECTIVE_GRAVITY
UP = (0.0, 0.0, 1.0)


class ImuAcceleration:
    """An IMU measures specific force: acceleration less gravity, which is effective gravity the other way round.

    The acceleration goes through a first-order low pass, in the world where the IMU knows its orientation, so that
    gravity turns with the body at once; else, gravity with it, in the IMU's own frame. Stamps count, not rates.
    """

    def __init__(self) -> None:
        self._last_ns = 0
        self._in_world = True
        self._smooth = np.zeros(3)

    def effective_gravity(self, message, stamp_ns: int) -> EffectiveGravity | None:
        """Of a `sensor_msgs/Imu`. None for one without acceleration or stamp, or that comes twice or late.

        Raises OrientationError for values that are not finite or cannot be.
        """
        force = vector_of(message.linear_acceleration)
        if message.linear_acceleration_covariance[0] == -1.0 or not any(force) or not stamp_ns:
            return None
        if not math.hypot(*force) <= LARGEST_FORCE:
            allowed = f"finite, at most {LARGEST_FORCE:g} m/s2"
            raise OrientationError(f"the IMU's linear acceleration is {list(force)}; it must be {allowed}")
        down, turn = gravity_from_imu(message), None
        if message.orientation_covariance[0] != -1.0:
            turn = unit_quaternion(quaternion_of(message.orientation))
            measured = np.array(rotated(turn, force)) - STANDARD_GRAVITY * np.array(UP)
            at_rest = np.zeros(3)
        else:
            measured = np.array(force)
            at_rest = -STANDARD_GRAVITY * down
        passed, in_world = stamp_ns - self._last_ns, turn is not None
        if 0 >= passed >= -SAME_CLOCK:
            return None
        if not 0 < passed <= LARGEST_GAP or in_world != self._in_world:
            self._smooth = at_rest
        else:
            share = -math.expm1(-1e-9 * passed / DELAY)
            self._smooth = self._smooth + share * (measured - self._smooth)
        self._last_ns, self._in_world = stamp_ns, in_world
        if in_world:
            gravity = down - np.array(rotated(inverse(turn), self._smooth)) / STANDARD_GRAVITY
        else:
            gravity = -self._smooth / STANDARD_GRAVITY
        gravity = gravity * min(1.0, LARGEST_EFFECTIVE / max(np.linalg.norm(gravity), 1e-9))
        return EffectiveGravity(STANDARD_GRAVITY * gravity, STANDARD_GRAVITY * down)
