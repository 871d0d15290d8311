"""What the drape node counts, and how it tells: `/diagnostics` for people and monitors, `~/statistics` in numbers.

Dimensions: `d` degrees of freedom. Times [ns] unless a name says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import physkin_core._native as _native

from physkin_core import Rig
from physkin_core.file_reading import sentence

__all__ = ["AvatarStatistics", "GarmentStatistics", "Health", "HealthReporter", "PoseRange", "diagnostic_status"]

MOST_TIMES = 100_000  # kept between two reports, should nobody report
NOTICEABLE = 0.02  # [rad] beyond a limit
LEAST_SEPARATION = 1e-3  # [rad] smaller changes are not counted


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


@dataclass
class AvatarStatistics:
    """Counts of one avatar since it was configured. Reasons may quote what strangers send; they are made sentences.

    gravity_rejected: messages of a direction that is none, or of an effective gravity that cannot be; wind_rejected:
    of a wind that cannot be. They count as rejections to warn about, but not as joint states. not_ready: joint states
    while there was nothing to drape yet, or the node was inactive. implausible: joint states that look like degrees,
    draped all the same; last_implausible says which joint. last_error: of a swap. last_stamp_ns: of the last joint
    state that was draped, None before the first. strangers: who publishes something else than joint states on their
    topic, which DDS does not deliver. offered: quality of service that topics are published with. missing: as
    `MissingMessages` counts joint states.
    """

    received: int = 0
    rejected: int = 0
    gravity_rejected: int = 0
    wind_rejected: int = 0
    not_ready: int = 0
    implausible: int = 0
    swaps_failed: int = 0
    deadline_missed: int = 0
    last_implausible: str = ""
    last_rejection: str = ""
    last_error: str = ""
    strangers: str = ""
    offered: str = ""
    missing: int = 0
    last_stamp_ns: int | None = None
    limbs_separated: int = 0
    largest_separation: float | None = None

    def separate(self, change: float) -> None:
        """Count a joint state of which a position was changed by so much [rad], if any was."""
        self.limbs_separated += change > LEAST_SEPARATION
        self.largest_separation = max(change, self.largest_separation or 0.0)

    def reject(self, reason: str) -> None:
        """Count a joint state that was not draped, and keep why."""
        self.rejected += 1
        self.last_rejection = sentence(reason)

    def reject_gravity(self, reason: str) -> None:
        """Count an orientation message that was not used, and keep why."""
        self.gravity_rejected += 1
        self.last_rejection = sentence(reason)

    def reject_wind(self, reason: str) -> None:
        """Count a message of wind that was not used, and keep why."""
        self.wind_rejected += 1
        self.last_rejection = sentence(reason)

    def fail_swap(self, reason: str) -> None:
        """Count a swap that failed, and keep why."""
        self.swaps_failed += 1
        self.last_error = sentence(reason)

    def doubt(self, reason: str) -> None:
        """Count a joint state that looks like degrees, and keep which joint."""
        self.implausible += 1
        self.last_implausible = sentence(reason)


@dataclass
class GarmentStatistics:
    """Clouds of one garment since it was configured, and what those of the last period took."""

    published: int = 0
    evaluation_ns: list[int] = field(default_factory=list)

    def draped(self, evaluation_ns: int) -> None:
        """Count a cloud and how long the evaluation took."""
        self.published += 1
        self.evaluation_ns.append(evaluation_ns)
        if len(self.evaluation_ns) > MOST_TIMES:
            self.evaluation_ns.clear()


@dataclass
class Health:
    """One garment on one avatar over a period: what both ways of telling are made from.

    beyond: joints outside the trained range. period: [s]. evaluation_us: median and 99th percentile, None without
    frames. new: by name of a count of `AvatarStatistics`, what came in the period.
    """

    counts: AvatarStatistics
    published: int
    period: float
    received_rate: float
    published_rate: float
    evaluation_us: tuple[float, float] | None
    new: dict[str, int]
    beyond: Sequence[str]

    def summary(self) -> tuple[bool, str]:
        """Whether all is well, and a sentence; troubles of the period, none of which hides another."""
        counts, new = self.counts, self.new
        rejected = new["rejected"] + new["gravity_rejected"] + new["wind_rejected"]
        troubles = (
            (rejected, f"{rejected} messages rejected: {counts.last_rejection}"),
            (new["swaps_failed"], f"swap failed, the old one stays on: {counts.last_error}"),
            (new["implausible"], f"{new['implausible']} joint states look like degrees: {counts.last_implausible}"),
            (new["not_ready"], f"{new['not_ready']} joint states came before the garment was ready"),
            (new["missing"], f"{new['missing']} joint states are missing, by the gaps in their stamps"),
            (new["deadline_missed"], f"{new['deadline_missed']} joint states missed the deadline"),
        )
        if any(count for count, _ in troubles):
            return False, "; ".join(text for count, text in troubles if count)
        if self.evaluation_us is not None:
            if self.beyond:
                return False, f"draping, but the pose is outside the trained range: {self.beyond[0]}"
            return True, "draping"
        if counts.strangers:
            return False, f"no joint states, but other messages on their topic: {counts.strangers}"
        return True, "waiting for joint states" if not counts.received else "no joint states in the last second"

    def values(self, now_ns: int) -> dict[str, str]:
        """Named values as text. now_ns: time on the stamps' clock."""
        counts = self.counts
        age = None if counts.last_stamp_ns is None else (now_ns - counts.last_stamp_ns) / 1e9
        p50, p99 = self.evaluation_us or (None, None)
        return {
            "joint states received": str(counts.received),
            "joint states [Hz]": _number(self.received_rate, 1),
            "clouds published": str(self.published),
            "clouds [Hz]": _number(self.published_rate, 1),
            "joint states rejected": str(counts.rejected),
            "joint states before a garment was ready": str(counts.not_ready),
            "joint states that look like degrees": str(counts.implausible),
            "gravity messages rejected": str(counts.gravity_rejected),
            "wind messages rejected": str(counts.wind_rejected),
            "last rejection": counts.last_rejection or "none",
            "swaps failed": str(counts.swaps_failed),
            "last error": counts.last_error or "none",
            "joint states missing by gaps in stamps": str(counts.missing),
            "quality of service offered": counts.offered or "none",
            "publishers of another type": counts.strangers or "none",
            "deadline missed": str(counts.deadline_missed),
            "evaluation p50 [us]": _number(p50, 1),
            "evaluation p99 [us]": _number(p99, 1),
            "last stamp age [s]": _number(age, 3),
            "joint states with limbs separated": str(counts.limbs_separated),
            "largest separation [rad]": _number(counts.largest_separation, 3),
            "outside the trained range": "; ".join(self.beyond[:3]) or "none",
        }

    def fill(self, message) -> None:
        """Set the numbers of a `physkin_msgs/GarmentStatistics`."""
        counts = self.counts
        for name in ("received", "rejected", "not_ready", "implausible", "deadline_missed"):
            setattr(message, name, getattr(counts, name))
        message.published = self.published
        message.received_rate, message.published_rate = self.received_rate, self.published_rate
        message.evaluation_p50, message.evaluation_p99 = self.evaluation_us or (math.nan, math.nan)


class HealthReporter:
    """Takes the health of an avatar and its garments from one report to the next."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._before: dict[str, int] = {}

    def report(
        self, counts: AvatarStatistics, garments: Sequence[GarmentStatistics], beyond: Sequence[str], now_ns: int
    ) -> list[Health]:
        """Health of each garment since the last call. now_ns: monotonic time."""
        period = 1.0 if self._last_ns is None else max(1e-3, (now_ns - self._last_ns) / 1e9)
        self._last_ns = now_ns
        new = {name: self._since(name, count) for name, count in vars(counts).items() if isinstance(count, int)}
        found = []
        for index, garment in enumerate(garments):
            times, garment.evaluation_ns = garment.evaluation_ns, []
            p50, p99 = np.percentile(times, (50, 99)) / 1e3 if times else (0.0, 0.0)
            found.append(
                Health(
                    counts=counts,
                    published=garment.published,
                    period=period,
                    received_rate=new["received"] / period,
                    published_rate=self._since(f"published {index}", garment.published) / period,
                    evaluation_us=(float(p50), float(p99)) if times else None,
                    new=new,
                    beyond=beyond,
                )
            )
        return found

    def _since(self, name: str, count: int) -> int:
        new = count - self._before.get(name, 0)
        self._before[name] = count
        return new


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
