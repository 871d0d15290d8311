"""What messages have said of an avatar's root, and which of it goes with a joint state.

The garments' `FrameInput` is told how the root moves, as far as that is known and fresh, or else where down is.
"""

from __future__ import annotations

import numpy as np

from physkin_core import FrameInput
from physkin_core.sway.frame_input import STANDARD_GRAVITY, RootSample, unit_direction
from physkin_ros.root.gravity import EffectiveGravity, FreshByStamp, LatestByStamp

__all__ = ["RootState"]


class RootState:
    """Of one avatar. Stamps and times of coming are in ns, these monotonic.

    down: direction of gravity (3,), of any length but zero, in the root frame until another one comes. frame_input: of
    its garments.
    """

    def __init__(self, down: np.ndarray, frame_input: FrameInput) -> None:
        self.frame_input = frame_input
        self._directions = LatestByStamp(_as_networks_know(down))
        self._motions: FreshByStamp[RootSample | EffectiveGravity] = FreshByStamp()

    def set_direction(self, down: np.ndarray) -> None:
        """Another direction of gravity (3,), of any length but zero, as of now."""
        self._directions.add(_as_networks_know(down), 0)

    def add_direction(self, down: np.ndarray, stamp_ns: int) -> None:
        """Take a unit direction (3,) that has come."""
        self._directions.add(down, stamp_ns)

    def add_motion(self, motion: RootSample | EffectiveGravity, stamp_ns: int, now_ns: int) -> None:
        """Take how the root moves, that has come."""
        self._motions.add(motion, stamp_ns, now_ns)

    def direction(self, stamp_ns: int) -> np.ndarray:
        """Gravity's unit direction (3,) that goes with a joint state, however the root is accelerated."""
        return self._directions.at(stamp_ns)

    def moves(self, now_ns: int) -> bool:
        """Whether it is known, and fresh, how the root moves."""
        return self._motions.at(0, now_ns) is not None

    def effective_gravity(self, garment: int, now_ns: int) -> np.ndarray | None:
        """The latest (3,) [m/s2] that a garment feels of a root of which nothing but its acceleration is known; else
        None."""
        known = self._motions.at(0, now_ns)
        if not isinstance(known, EffectiveGravity):
            return None
        felt = FrameInput(1)
        felt.sway, felt.wind = self.frame_input.sway[garment : garment + 1], self.frame_input.wind
        _tell(felt, known)
        felt.begin_frame()
        return STANDARD_GRAVITY * felt.rows[0, :3]

    def take(self, stamp_ns: int, now_ns: int) -> bool:
        """Tell the garments what goes with a joint state. Whether it was known how the root moves."""
        known = self._motions.at(stamp_ns, now_ns)
        if known is None:
            self.frame_input.set_gravity(self.direction(stamp_ns))
        else:
            _tell(self.frame_input, known)
        return known is not None

    def begin_frame(self, sec: int, nanosec: int) -> None:
        """Begin the frame of a joint state with this stamp; 0 for none: it then stands by itself."""
        self.frame_input.begin_frame(sec + 1e-9 * nanosec if sec or nanosec else None)


def _tell(frame_input: FrameInput, motion: RootSample | EffectiveGravity) -> None:
    if isinstance(motion, EffectiveGravity):
        frame_input.set_effective_gravity(motion.vector, motion.at_rest)
    else:
        frame_input.set_root_sample(motion)


def _as_networks_know(down: np.ndarray) -> np.ndarray:
    return unit_direction(down).astype(np.float32)
