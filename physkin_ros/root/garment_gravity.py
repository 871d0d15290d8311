"""What the garments of an avatar are told beside the pose: gravity, and how they and the root move.

Dimensions: `g` garments. Gravity is in units of gravity, in the root frame; stamps and times of coming are in ns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.runtime.draper import STANDARD_GRAVITY
from physkin_core.sway.moment import Moment
from physkin_core.sway.pace import UNTOLD, FrameClock
from physkin_ros.root.gravity import EffectiveGravity, Felt, GravityByStamp

__all__ = ["GarmentGravity"]

WEIGHTLESS = 1e-3  # of gravity: effective gravity that is smaller has no direction
STILL = np.array([UNTOLD, 0.0, UNTOLD, 0.0])
"""Passed time, sway, elapsed time and whether rates count, of cloth that does not swing."""


class GarmentGravity:
    """Rows of numbers that drapers read, changed in place.

    gravity: (g, 14) float32, the unit direction that each garment feels, and the moment behind it, as of
    `physkin_core.sway.moment`. felt: (g, 14) the same, as large as the root feels it. load: (g, 1) how large that is.
    down: unit direction (3,) until another one is told. sways: how much the cloth of each garment swings, 0 to 1.
    """

    def __init__(self, down: np.ndarray, sways: Sequence[float]) -> None:
        self.gravity = np.tile(Moment().after(down), (len(sways), 1))
        self.felt = self.gravity.copy()
        self.load = np.ones((len(sways), 1), dtype=np.float32)
        self._down: np.ndarray | None = None  # what gravity and felt show, if it came as a direction
        self._by_stamp, self._effective = GravityByStamp(down), EffectiveGravity()
        self._clock = FrameClock()
        self._network, self._known = 1.0, 1.0  # whether sway networks count, and the root's rates
        self.set_sway(sways)

    def set_direction(self, down: np.ndarray) -> None:
        """Another unit direction (3,), as of now."""
        self.gravity[:, :3] = down
        self._by_stamp.add(down, 0)

    def set_sway(self, sways: Sequence[float]) -> None:
        """Let the cloth of each garment swing as much from now on."""
        self._sways = np.array(sways)

    def add_direction(self, down: np.ndarray, stamp_ns: int) -> None:
        """Take a unit direction (3,) that has come."""
        self._by_stamp.add(down, stamp_ns)

    def add_felt(self, felt: Felt, stamp_ns: int, now_ns: int) -> None:
        """Take what garments feel, that has come."""
        self._effective.add(felt, stamp_ns, now_ns)

    def direction(self, stamp_ns: int) -> np.ndarray:
        """Gravity's unit direction (3,) that goes with a joint state, however the root is accelerated."""
        return self._by_stamp.at(stamp_ns)

    def effective_gravity(self, garment: int, now_ns: int, *, learnt: bool) -> np.ndarray | None:
        """The latest (3,) [m/s2] of a garment; None when none is fresh, or it has `learnt` to sway and is moved by the
        root's rates instead."""
        felt = self._effective.at(0, now_ns)
        if felt is None or (learnt and felt.root is not None):
            return None
        return STANDARD_GRAVITY * np.broadcast_to(felt.rows, (len(self.felt), 4))[garment, :3]

    def take_felt(self, stamp_ns: int, now_ns: int, learnt: np.ndarray) -> bool:
        """Let garments feel what goes with a joint state, if that is fresh, and whether it is. learnt: (g,) bool, those
        with a sway network: where the root's rates are known, they are told these under gravity as it is."""
        felt = self._effective.at(stamp_ns, now_ns)
        if felt is None:
            return False
        self.load[:] = load = np.linalg.norm(felt.rows[..., :3], axis=-1, keepdims=True)
        # where it is weightless, the last direction stays
        np.divide(felt.rows[..., :3], load, out=self.gravity[:, :3], where=load > WEIGHTLESS)
        self.gravity[:, 3] = felt.rows[..., 3]
        self._network = self._known = 0.0
        if felt.root is not None:
            self._network, self._known = 1.0, float(felt.root[7])
            self.gravity[:, 8:] = felt.root[8:]
            self.gravity[learnt], self.load[learnt] = felt.root, 1.0
        self._down = None
        self.weigh()
        return True

    def take_by_stamp(self, stamp_ns: int) -> None:
        """Let garments feel gravity alone, in the direction that goes with a joint state."""
        down = self.direction(stamp_ns)
        if down is not self._down:
            self.take_direction(down)
            self._down = down

    def take_direction(self, down: np.ndarray | None) -> None:
        """Let garments feel gravity alone, in this unit direction (3,), or as it was: the root is taken to be at rest,
        and sway networks move cloth by the joints alone."""
        if down is not None:
            self.gravity[:, :3] = down
        self.load[:], self.gravity[:, 3], self.gravity[:, 8:] = 1.0, 0.0, 0.0
        self._network = self._known = 1.0
        self._down = None
        self.weigh()

    def weigh(self) -> None:
        """Let `felt` be `gravity` with its load."""
        np.multiply(self.gravity[:, :3], self.load, out=self.felt[:, :3])
        self.felt[:, 3:] = self.gravity[:, 3:]

    def begin_frame(self, sec: int, nanosec: int) -> None:
        """Tell how much time has passed since the frame before, by the stamp of this one; 0 for none."""
        moment = STILL
        if sec or nanosec:
            passed = self._clock.passed(sec + 1e-9 * nanosec)
            told = (passed, self._network, self._clock.elapsed, self._known if passed >= 0 else 0.0)
            moment = np.where(self._sways[:, None] > 0, told, STILL)
            moment[:, 1] *= self._sways
        self.gravity[:, 4:8] = self.felt[:, 4:8] = moment
