"""Sway: from a root that moves through the world to effective gravity that its garments feel, and to their twist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from numbers import Real
from typing import Literal

import numpy as np

from physkin_core.sway.moment import Moment
from physkin_core.sway.pendulum import PendulumSettings, ReferencePendulum

__all__ = ["Sway", "checked_amount"]

LEAST_DIRECTED = 2.0
"""[m/s2] a model that knows directions alone does not follow an effective gravity below this."""


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
        self._twist, self._rates = 0.0, np.zeros(6)

    @property
    def amount(self) -> float:
        return self._amount

    @amount.setter
    def amount(self, value: float) -> None:
        self._amount = checked_amount(value)

    def reset(self) -> None:
        """Cloth hangs still, as at the beginning; for another avatar, or after the root was moved by hand."""
        self._pendulum.reset()
        self._twist = 0.0

    @property
    def twist(self) -> float:
        """Angle [rad] about its vertical by which cloth round both legs is ahead of the root, as of the last `felt`."""
        return self._twist

    def felt(self, time: float, root: Sequence[float] | np.ndarray) -> np.ndarray:
        """Effective gravity (3,) float64 [m/s2] in the root frame, at most three times gravity.

        time: [s], of any clock; frames may come at any rate. root: (7,) where the root is, x, y, z [m], and its unit
        quaternion x, y, z, w, world <- root; the world has Z up. A doubled message changes nothing. After more than a
        quarter of a second without one, a jump of the root or a clock that goes back, cloth comes to rest by itself.
        Raises ValueError for values that are not finite, another number of them, or a quaternion of no length.
        """
        return self._felt(time, root, self._amount)

    def _felt(self, time: float, root: Sequence[float] | np.ndarray, amount: float) -> np.ndarray:
        found = np.empty(4)
        self._pendulum.felt(time, np.ascontiguousarray(root, dtype=np.float64), amount, found)
        self._twist = float(found[3])
        return found[:3]

    def gravity(
        self,
        time: float | None,
        root: np.ndarray | None,
        given: np.ndarray | None,
        *,
        accelerated: bool,
        learnt: bool = False,
        amount: float | None = None,
    ) -> tuple[np.ndarray | None, np.ndarray | None, float]:
        """What garments are draped under at a time and place of the root: effective gravity (3,) [m/s2] where their
        models know `accelerated` roots and sway is above 0, and before it None, or else gravity's direction (3,) and
        None; and the twist [rad]. A garment that has `learnt` to sway is draped as if the root were at rest.

        given: effective gravity that was given besides, which may not be. amount: of one garment, in place of the own.
        Raises ValueError as `felt` does, and where only one of time and root is there.
        """
        if time is None or root is None or given is not None:
            raise ValueError("give time with root, and no effective gravity: it follows from them")
        amount = self._amount if amount is None else amount
        felt = self._felt(time, root, amount)
        if amount == 0 or learnt:
            return _gravity_at(root), None, 0.0
        if accelerated:
            return None, felt, self._twist
        return (felt if felt @ felt > LEAST_DIRECTED**2 else _gravity_at(root)), None, self._twist

    def moment(
        self, passed: float, elapsed: float, *, twist: float, learnt: bool, rooted: bool, amount: float | None = None
    ) -> Moment:
        """What a garment is told at the last frame of a `FrameClock`, from which passed and elapsed time are.

        twist: of `gravity`. learnt: whether it sways by a network. rooted: whether the root was told, too. amount: of
        one garment, in place of the own.
        """
        amount = self._amount if amount is None else amount
        if amount == 0:
            return Moment()
        known, *rates = self.motion() if rooted else (True,)
        return Moment(twist, passed, amount if learnt else 0.0, elapsed, float(known and passed >= 0), *rates)

    def motion(self) -> tuple[bool, tuple[float, ...], tuple[float, ...]]:
        """The root's velocity (3) [m/s] and turning (3) [rad/s], in its frame, up to the last `felt`, and before them
        whether they are known: after a gap or a jump they are not, and zero."""
        known = self._pendulum.motion(self._rates)
        *velocity, x, y, z = self._rates.tolist()
        return bool(known), tuple(velocity), (x, y, z)


def _gravity_at(root: Sequence[float] | np.ndarray) -> np.ndarray:
    """Unit gravity direction (3,) float32 in the frame of a root (7,), as of `Sway.felt`, that stands still."""
    x, y, z, w = np.asarray(root, dtype=np.float32)[3:].tolist()
    down = [2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1]
    return np.array(down, dtype=np.float32)


def checked_amount(value: float) -> float:
    """How much something sways, as a float. Raises ValueError unless it is a number from 0 to 1."""
    if not (isinstance(value, Real) and 0 <= value <= 1):
        raise ValueError(f"sway must be a number from 0 to 1, got {value!r}")
    return float(value)


def _pendulum(backend: str, settings: PendulumSettings):
    if backend == "numpy":
        return ReferencePendulum(settings)
    if backend != "native":
        raise ValueError(f"unknown backend {backend!r}; allowed: native, numpy")
    from physkin_core._native import Pendulum

    return Pendulum(*astuple(settings))
