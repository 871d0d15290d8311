"""What the drape node counts of an avatar, and the figures of a period that `/diagnostics` and `~/statistics` give.

Dimensions: `d` degrees of freedom. Times [ns] unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import physkin_core._native as _native

from physkin_core import Rig
from physkin_core.file_reading import sentence

__all__ = ["AvatarStatistics", "Health", "PoseRange", "diagnostic_status"]

MOST_TIMES = 100_000  # kept between two reports, should nobody report
NOTICEABLE = 0.02  # [rad] beyond a limit
LEAST_SEPARATION = 1e-3  # [rad] smaller changes are not counted

COUNTED = {
    "received": "joint states received",
    "published": "clouds published",
    "rejected": "joint states rejected",
    "not_ready": "joint states before a garment was ready",
    "implausible": "joint states that look like degrees",
    "not_finite": "joint states with positions that are not finite",
    "without_positions": "joint states without positions",
    "gravity_rejected": "gravity messages rejected",
    "wind_rejected": "wind messages rejected",
    "swaps_failed": "swaps failed",
    "lost": "joint states lost on the way",
    "limbs_separated": "joint states with limbs separated",
}
"""What is counted: names, as in `physkin_msgs/GarmentStatistics` -> names in the diagnostics. Joint states that look
like degrees are draped all the same, and so are those of which a position is not finite; those that are not ready came
while the node was inactive or still loaded."""
TROUBLES = COUNTED.keys() - {"received", "published", "limbs_separated", "without_positions"}


class PoseRange:
    """How far joints have gone since the last report, against the limits that garments are trained within.

    positions: (d,) float32 [rad], read at each `add`.
    """

    def __init__(self, rig: Rig, positions: np.ndarray) -> None:
        self._rig = rig
        self._least = np.empty(len(rig.dofs), dtype=np.float32)
        self._most = np.empty(len(rig.dofs), dtype=np.float32)
        self._clear()
        self._range = _native.PoseRange(positions, self._least, self._most)

    def add(self) -> None:
        """Take the positions as they are now."""
        self._range.widen()

    def beyond(self) -> list[str]:
        """Joints beyond their limits since the last call, the farthest first, each with its position and limits."""
        rig = self._rig
        over = np.maximum(rig.lower - self._least, self._most - rig.upper)
        worst = [joint for joint in np.argsort(-over).tolist() if over[joint] > NOTICEABLE]
        found = []
        for joint in worst:
            below = rig.lower[joint] - self._least[joint] >= over[joint]
            reached = self._least[joint] if below else self._most[joint]
            limits = f"{rig.lower[joint]:.2f} to {rig.upper[joint]:.2f}"
            found.append(f"{rig.joint_names[joint]} {reached:.2f} rad (trained {limits})")
        self._clear()
        return found

    def _clear(self) -> None:
        self._least.fill(np.inf)
        self._most.fill(-np.inf)


class AvatarStatistics:
    """Counts of one avatar since it was configured.

    counts: by the names of `COUNTED`. reasons: of the last one of each that had a reason; what strangers send may be
    quoted in them, so they are made sentences. last_rejection: the last of those of rejected messages.
    """

    def __init__(self) -> None:
        self.counts = dict.fromkeys(COUNTED, 0)
        self.reasons: dict[str, str] = {}
        self.last_rejection = ""
        self._last_stamp_ns: int | None = None
        self._largest_separation: float | None = None
        self._evaluation_ns: list[int] = []
        self._reported = dict(self.counts)
        self._reported_ns: int | None = None

    def count(self, what: str, reason: str = "", *, number: int = 1) -> None:
        """Count something, and keep why."""
        self.counts[what] += number
        if reason:
            self.reasons[what] = sentence(reason)
            if what.endswith("rejected"):
                self.last_rejection = self.reasons[what]

    def draped(self, stamp_ns: int, evaluation_ns: int, separation: float | None = None) -> None:
        """Count a joint state that was draped. separation: how far its positions were moved apart [rad], if at all."""
        self.counts["published"] += 1
        self._last_stamp_ns = stamp_ns
        self._evaluation_ns.append(evaluation_ns)
        if len(self._evaluation_ns) > MOST_TIMES:
            self._evaluation_ns.clear()
        if separation is not None:
            self.counts["limbs_separated"] += separation > LEAST_SEPARATION
            self._largest_separation = max(separation, self._largest_separation or 0.0)

    def health(self, now_ns: int, beyond: Sequence[str] = (), strangers: str = "", offered: str = "") -> Health:
        """The figures since the last call. now_ns: monotonic. The others: see `Health`."""
        period = 1.0 if self._reported_ns is None else max(1e-3, (now_ns - self._reported_ns) / 1e9)
        new = {what: count - self._reported[what] for what, count in self.counts.items()}
        self._reported, self._reported_ns = dict(self.counts), now_ns
        times, self._evaluation_ns = self._evaluation_ns, []
        p50, p99 = (np.percentile(times, (50, 99)) / 1e3).tolist() if times else (None, None)
        return Health(
            counts=self._reported,
            new=new,
            period=period,
            reasons=dict(self.reasons),
            last_rejection=self.last_rejection,
            evaluation_p50=p50,
            evaluation_p99=p99,
            last_stamp_ns=self._last_stamp_ns,
            largest_separation=self._largest_separation,
            beyond=beyond,
            strangers=strangers,
            offered=offered,
        )


@dataclass(frozen=True)
class Health:
    """The figures of an avatar over a period [s]; those that are not there are None.

    counts, new: by the names of `COUNTED`, in all and in the period. evaluation_p50, evaluation_p99: [us] of a frame.
    last_stamp_ns: of the last joint state that was draped. largest_separation: [rad]. beyond: joints outside the
    trained range. strangers: who publishes something else than joint states on their topic, which DDS does not deliver.
    offered: quality of service that topics are published with.
    """

    counts: Mapping[str, int]
    new: Mapping[str, int]
    period: float
    reasons: Mapping[str, str]
    last_rejection: str
    evaluation_p50: float | None
    evaluation_p99: float | None
    last_stamp_ns: int | None
    largest_separation: float | None
    beyond: Sequence[str]
    strangers: str
    offered: str

    @property
    def received_rate(self) -> float:
        """Of joint states [Hz]."""
        return self.new["received"] / self.period

    @property
    def published_rate(self) -> float:
        """Of clouds [Hz]."""
        return self.new["published"] / self.period

    def summary(self) -> tuple[bool, str]:
        """Whether all is well, and a sentence; troubles of the period, none of which hides another."""
        troubles = [
            f"{count} {COUNTED[what]}" + (f": {self.reasons[what]}" if what in self.reasons else "")
            for what, count in self.new.items()
            if count and what in TROUBLES
        ]
        if 0 < self.counts["received"] == self.counts["without_positions"]:
            troubles.append("none of the joint states has positions")
        if troubles:
            return False, "; ".join(troubles)
        if self.evaluation_p50 is not None:
            if self.beyond:
                return False, f"draping, but the pose is outside the trained range: {self.beyond[0]}"
            return True, "draping"
        if self.strangers:
            return False, f"no joint states, but other messages on their topic: {self.strangers}"
        return True, "no joint states in the last second" if self.counts["received"] else "waiting for joint states"

    def values(self, now_ns: int) -> dict[str, str]:
        """Named values as text. now_ns: time on the stamps' clock."""
        age = None if self.last_stamp_ns is None else (now_ns - self.last_stamp_ns) / 1e9
        return {COUNTED[what]: str(count) for what, count in self.counts.items()} | {
            "joint states [Hz]": _number(self.received_rate, 1),
            "clouds [Hz]": _number(self.published_rate, 1),
            "last rejection": self.last_rejection or "none",
            "last error": self.reasons.get("swaps_failed", "none"),
            "quality of service offered": self.offered or "none",
            "publishers of another type": self.strangers or "none",
            "evaluation p50 [us]": _number(self.evaluation_p50, 1),
            "evaluation p99 [us]": _number(self.evaluation_p99, 1),
            "last stamp age [s]": _number(age, 3),
            "largest separation [rad]": _number(self.largest_separation, 3),
            "outside the trained range": "; ".join(self.beyond[:3]) or "none",
        }

    def fill(self, message) -> None:
        """Set the numbers of a `physkin_msgs/GarmentStatistics`, NaN for those that are not there."""
        for name in message.get_fields_and_field_types():
            if name in self.counts:
                setattr(message, name, self.counts[name])
            elif name not in ("avatar", "garment", "model_name"):
                value = getattr(self, name)
                setattr(message, name, np.nan if value is None else value)


def diagnostic_status(name: str, hardware_id: str, well: bool, message: str, values: dict[str, str]):
    """A `diagnostic_msgs/DiagnosticStatus`, OK when `well`, else WARN. Names come from files and strangers: they are
    shortened and escaped."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=DiagnosticStatus.OK if well else DiagnosticStatus.WARN,
        name=sentence(name),
        hardware_id=sentence(hardware_id),
        message=message,
        values=[KeyValue(key=key, value=sentence(value)) for key, value in values.items()],
    )


def _number(value: float | None, decimals: int) -> str:
    return "none" if value is None else f"{value:.{decimals}f}"
