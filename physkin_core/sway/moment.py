"""What a frame is told besides joint positions: gravity, and the moment, of cloth that remembers the frame before.

It is a row of numbers: gravity alone (3), with twist and passed time (5), or with all that `Moment` has (14), in its
order. What is not told is as in `Moment()`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physkin_core.sway.pace import UNTOLD

__all__ = ["GRAVITY_SIZES", "Moment", "split_moment"]

GRAVITY_SIZES = (3, 5, 14)
"""How many numbers gravity may have, with what is told of the moment behind it."""
FASTEST = 1e6
"""[m/s, rad/s] A root is told to be no faster; all beyond some metres a second is alike to cloth."""


class Moment(NamedTuple):
    """twist: [rad] of cloth that hangs round both legs, about the root's vertical (`BoundGarment.node_twist`).
    passed: time [s] since the last frame, by which cloth keeps its pace; negative where that frame does not count.
    sway: how much of a sway network's offsets counts, to 1; at 0 it forgets what was before. elapsed: time [s] since
    the last frame for the sway network: 0 where a stamp comes again, negative for a first frame. moves: whether rates
    of joints and root count, 0 or 1; they do not after a gap or a jump. velocity (3) [m/s] and turning (3) [rad/s] of
    the root since the last frame, in its frame of now.
    """

    twist: float = 0.0
    passed: float = UNTOLD
    sway: float = 0.0
    elapsed: float = UNTOLD
    moves: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turning: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def after(self, gravity: np.ndarray) -> np.ndarray:
        """Gravity (3,), then the moment: (14,) float32."""
        *scalars, velocity, turning = self
        rates = (*velocity, *turning)
        if not (-FASTEST <= min(rates) and max(rates) <= FASTEST):
            rates = [min(max(rate, -FASTEST), FASTEST) for rate in rates]
        told = np.empty(GRAVITY_SIZES[-1], dtype=np.float32)
        told[:3] = gravity
        told[3:] = (*scalars, *rates)
        return told


def split_moment(told: np.ndarray) -> tuple[np.ndarray, Moment | None]:
    """Gravity (3,), and the moment where there is one, of a row of one of `GRAVITY_SIZES`."""
    gravity, numbers = told[:3], [float(number) for number in told[3:]]
    if not numbers:
        return gravity, None
    return gravity, Moment(*numbers[:5], *(tuple(numbers[k : k + 3]) for k in (5, 8) if numbers[k:]))
