"""What the garments of one avatar are given in a frame besides joint positions.

For each garment a row of numbers: how gravity and wind pull at it, how much time has passed since the frame before, and
how fast the root moves. native/src/sway/frame_input.cpp works them out for everybody: `Outfit` and `Draper`, the ROS
node, replay and hosts in C.

Dimensions: `g` garments. Metres, seconds, radians, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real

import numpy as np

from physkin_core.native_module import native

__all__ = [
    "AIR_DRAG",
    "LARGEST_EFFECTIVE_GRAVITY",
    "LARGEST_WIND",
    "STANDARD_GRAVITY",
    "UPRIGHT_GRAVITY",
    "FrameInput",
    "RootSample",
    "RootTracker",
    "checked_sway",
    "checked_wind",
    "unit_direction",
]

STANDARD_GRAVITY: float = native.constants["standard_gravity"]
"""[m/s2] what a gravity direction stands for."""
LARGEST_EFFECTIVE_GRAVITY: float = native.constants["largest_effective_gravity"]
"""In units of gravity; training knows no more."""
AIR_DRAG: float = native.constants["air_drag"]
"""[1/s] deceleration of cloth over its speed through still air."""
LARGEST_WIND: float = native.constants["largest_wind"]
"""[m/s]"""
UPRIGHT_GRAVITY = np.array([0.0, 0.0, -1.0])
"""Gravity direction in the root frame of an upright body."""

RootTracker = native.RootTracker
"""How a root moves, pose by pose: `move(time, root)` gives a `RootSample`, for whoever learns of the root at other
times than of joints, as the ROS node does. `time` and `root` as of `FrameInput.set_root`."""
RootSample = native.RootSample
"""What is known of a root at one pose of it, for `FrameInput.set_root_sample`."""


class FrameInput:
    """What a frame of one avatar's garments needs besides joint positions: gravity, time, root and wind.

    In each frame, first call `set_gravity`, `set_effective_gravity`, `set_root` or `set_root_sample` to say where down
    is. Then call `begin_frame`, which adds the wind. `fill` does both.

    Args:
        garments: how many, 1 or more.

    Attributes:
        rows: (g, 13) float32, overwritten in every frame. Columns 0 to 2: effective gravity, in units of gravity.
            3: time step [s] for the speed limit, negative if cloth does not go on from the frame before. 4: share of
            the sway network's motion that is used, 0 to 1. 5: time step [s] for the sway network, negative in a first
            frame. 6: 1 if velocities of joints and root are used, otherwise 0. 7 to 9: velocity [m/s] of the root. 10
            to 12: its turning [rad/s].

    Raises:
        ValueError: for less than one garment.

    Examples:
        >>> frame_input = physkin.FrameInput(1)
        >>> frame_input.fill(time=0.0, root=np.array([0, 0, 0.9, 0, 0, 0, 1]))
        >>> frame_input.rows.shape
        (1, 13)
    """

    def __init__(self, garments: int) -> None:
        if garments < 1:
            raise ValueError(f"garments is {garments}; there must be 1 or more")
        self.native = native.FrameInput(garments)
        self.rows: np.ndarray = self.native.rows

    @property
    def sway(self) -> tuple[float, ...]:
        """How much each garment sways if frames have times. At 1, the default, cloth moves at a limited speed, and
        swings if the garment has a sway network. At 0 every frame is draped by itself.

        Raises:
            ValueError: if a value is not from 0 to 1, or if there are not as many values as garments.
        """
        return tuple(self.native.sway(garment) for garment in range(len(self.rows)))

    @sway.setter
    def sway(self, amounts: Sequence[float]) -> None:
        if len(amounts) != len(self.rows):
            raise ValueError(f"sway has {len(amounts)} numbers; expected one for each of {len(self.rows)} garments")
        for garment, amount in enumerate([checked_sway(amount) for amount in amounts]):
            self.native.set_sway(garment, amount)

    @property
    def wind(self) -> tuple[float, float, float]:
        """Velocity [m/s] (3) of the air in the world, Z up: the world of the root's pose or, if only the direction of
        gravity is known, a level frame that faces the same way as the root. It moves all garments, however much they
        sway. A change of wind takes effect gradually, at 30 m/s2.

        Raises:
            ValueError: when set to anything but three finite numbers, at most 13 m/s long.
        """
        return self.native.wind()

    @wind.setter
    def wind(self, velocity: Sequence[float]) -> None:
        self.native.set_wind(velocity)

    def reset(self) -> None:
        """Start again in the next frame from cloth that hangs still, as in the first frame: for another motion, or
        after the root was moved by hand."""
        self.native.reset()

    def set_gravity(self, gravity: np.ndarray) -> None:
        """Say where down is, for a root at rest.

        Args:
            gravity: (3,) unit direction in the root frame.

        Raises:
            ValueError: for anything else.
        """
        self.native.hang(gravity)

    def set_effective_gravity(self, effective_gravity: np.ndarray, at_rest: np.ndarray | None = None) -> None:
        """Say what pulls at the cloth, if only the acceleration of the root is known.

        Args:
            effective_gravity: (3,) [m/s2] gravity minus the acceleration of the root, in its frame: zero in free fall,
                at most three times gravity.
            at_rest: (3,) [m/s2] gravity alone. Each garment then gets the share of the acceleration that its
                `sway` says, and the wind is added. None: the cloth gets effective gravity as it is, without wind.

        Raises:
            ValueError: for values that are not allowed.
        """
        self.native.accelerate(effective_gravity, at_rest)

    def set_root(self, time: float, root: np.ndarray) -> None:
        """Say where the root is, for a root that moves through the world.

        A time that comes twice changes nothing. If more than a quarter of a second has passed, if the root has jumped
        or if the clock has gone back, the root counts as unmoved for this frame.

        Args:
            time: [s], of any clock; frames may come at any rate.
            root: (7,) x, y, z [m] and unit quaternion x, y, z, w from root to world; the world has Z up.

        Raises:
            ValueError: for values that are not finite, another number of them, or a quaternion of no length.
        """
        self.native.move(time, root)

    def set_root_sample(self, root: native.RootSample) -> None:
        """Say how the root moves, as a `RootTracker` knows it.

        Args:
            root: what `RootTracker.move` gave.
        """
        self.native.follow(root)

    def begin_frame(self, time: float | None = None) -> None:
        """Begin a frame, and end the one before.

        Args:
            time: [s], of any clock. If it is that of the frame before (joint states may come in parts), the time passed
                stays as it was. None: the frame stands by itself.

        Raises:
            ValueError: for a time that is not finite.
        """
        self.native.begin_frame(time)

    def fill(
        self,
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
        time: float | None = None,
        root: np.ndarray | None = None,
    ) -> None:
        """Say where down is and begin the frame, in one call.

        Args:
            gravity: (3,) direction in the root frame, of any length but zero; used without
                `effective_gravity` and `root`.
            effective_gravity: (3,) [m/s2], as for `set_effective_gravity`.
            time, root: as for `set_root`. `time` alone only begins the frame at that time.

        Raises:
            ValueError: as the methods above do, and for `root` without `time` or with `effective_gravity`.
        """
        self.native.fill(gravity, effective_gravity, time, root)


def unit_direction(gravity: np.ndarray) -> np.ndarray:
    """Unit direction (3,) float64 of a gravity of any length. Raises ValueError unless it is finite and has one."""
    return np.array(native.unit_direction(gravity))


def checked_sway(amount: float) -> float:
    """How much something sways, as a float. Raises ValueError unless it is a number from 0 to 1."""
    if not (isinstance(amount, Real) and 0 <= amount <= 1):
        raise ValueError(f"sway must be a number from 0 to 1, got {amount!r}")
    return float(amount)


def checked_wind(velocity: Sequence[float]) -> tuple[float, float, float]:
    """A velocity (3,) [m/s] of the air, as floats. Raises ValueError, as `FrameInput.wind` does, for what is none."""
    frame_input = FrameInput(1)
    frame_input.wind = velocity
    return frame_input.wind
