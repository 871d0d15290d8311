"""Sway: from a root that moves through the world to the effective gravity that its garments feel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import Literal

import numpy as np

from physkin_core.sway.pendulum import PendulumSettings, ReferencePendulum

__all__ = ["Sway", "gravity_at"]

GRAVITY = 9.81
LARGEST_FELT = 3 * GRAVITY
"""[m/s2] training knows no more."""


class Sway:
    """How the cloth of one avatar swings, kept from frame to frame.

    amount: 0, cloth hangs as if nothing had moved, to 1, all of it; may be changed at any time.
    settings: of the pendulum. backend: "native" or "numpy". Raises ValueError for an amount or backend not allowed.
    """

    def __init__(
        self,
        *,
        amount: float = 1.0,
        settings: PendulumSettings | None = None,
        backend: Literal["native", "numpy"] = "native",
    ) -> None:
        self.amount = amount
        self.settings = settings or PendulumSettings()
        self._pendulum = _pendulum(backend, self.settings)
        self._deflection = np.zeros(3)

    @property
    def amount(self) -> float:
        return self._amount

    @amount.setter
    def amount(self, value: float) -> None:
        self._amount = _checked_amount(value)

    def reset(self) -> None:
        """Cloth hangs still, as at the beginning; for another avatar, or after the root was moved by hand."""
        self._pendulum.reset()

    def felt(self, time: float, root: Sequence[float] | np.ndarray) -> np.ndarray:
        """Effective gravity (3,) float64 [m/s2] in the root frame, at most three times gravity.

        time: [s], of any clock; frames may come at any rate. root: (7,) where the root is, x, y, z [m], and its unit
        quaternion x, y, z, w, world <- root; the world has Z up. A doubled message changes nothing. After more than a
        quarter of a second without one, a jump of the root or a clock that goes back, cloth comes to rest by itself.
        Raises ValueError for values that are not finite, another number of them, or a quaternion of no length.
        """
        values = [float(value) for value in root]
        if len(values) != 7 or not (math.isfinite(time) and all(map(math.isfinite, values))):
            raise ValueError(f"time {time} and root {values} must be finite, root x, y, z and a quaternion x, y, z, w")
        length = math.hypot(*values[3:])
        if abs(length - 1) > 0.01:
            raise ValueError(f"the quaternion of root must be of length 1, got {values[3:]}")
        if max(map(abs, values[:3])) > 1e9:
            raise ValueError(f"the root must be within a million kilometres, got {values[:3]}")
        self._pendulum.move(float(time), np.array(values[:3]))
        self._pendulum.deflection(self._deflection)
        x, y, z = (self._amount * value for value in self._deflection)
        felt = _turned_back([value / length for value in values[3:]], (x, y, z - GRAVITY))
        size = math.hypot(*felt)
        shrink = min(1.0, LARGEST_FELT / size) if size else 1.0
        return np.array([shrink * value for value in felt])


def gravity_at(root: Sequence[float] | np.ndarray) -> np.ndarray:
    """Unit gravity direction (3,) float32 in the frame of a root (7,), as of `Sway.felt`, that stands still."""
    x, y, z, w = np.asarray(root, dtype=np.float32)[3:]
    down = [2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1]
    return np.array(down, dtype=np.float32)


def _checked_amount(value: float) -> float:
    if not (isinstance(value, (int, float)) and 0 <= value <= 1):
        raise ValueError(f"sway must be from 0 to 1, got {value!r}")
    return float(value)


def _turned_back(quaternion: Sequence[float], vector: Sequence[float]) -> tuple[float, float, float]:
    """A vector of the world in the frame whose orientation in the world is given."""
    x, y, z, w = quaternion
    a, b, c = vector
    # R^T v = v + 2 q x (q x v) - 2 w (q x v), q the vector part
    p, q, r = y * c - z * b, z * a - x * c, x * b - y * a
    return (
        a + 2 * (y * r - z * q) - 2 * w * p,
        b + 2 * (z * p - x * r) - 2 * w * q,
        c + 2 * (x * q - y * p) - 2 * w * r,
    )


def _pendulum(backend: str, settings: PendulumSettings):
    if backend == "numpy":
        return ReferencePendulum(settings)
    if backend != "native":
        raise ValueError(f"unknown backend {backend!r}; allowed: native, numpy")
    from physkin_core._native import Pendulum

    return Pendulum(*astuple(settings))
