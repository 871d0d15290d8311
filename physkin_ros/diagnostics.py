"""What the drape node counts, and how it reports that on `/diagnostics`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from physkin_core.push_out import ContactResidual

__all__ = ["DrapeStatistics", "contact_values", "diagnostic_status"]


@dataclass
class DrapeStatistics:
    """Counts since the node started, and evaluation times since the last report.

    last_stamp_ns: stamp of the last joint state that was draped [ns], None before the first. gravity_rejected: messages
    of a direction that is none; they count as rejections to warn about, but not as joint states.
    """

    received: int = 0
    published: int = 0
    rejected: int = 0
    gravity_rejected: int = 0
    last_rejection: str = ""
    last_stamp_ns: int | None = None
    _evaluation_ns: list[int] = field(default_factory=list)
    _reported_rejections: int = 0

    def draped(self, stamp_ns: int, evaluation_ns: int) -> None:
        """Count a cloud, its joint state's stamp and how long the evaluation took."""
        self.published += 1
        self.last_stamp_ns = stamp_ns
        self._evaluation_ns.append(evaluation_ns)

    def reject(self, reason: str) -> None:
        """Count a joint state that was not draped, and keep why."""
        self.rejected += 1
        self.last_rejection = reason

    def reject_gravity(self, reason: str) -> None:
        """Count a gravity message that was not used, and keep why."""
        self.gravity_rejected += 1
        self.last_rejection = reason

    def report(self, now_ns: int) -> tuple[bool, str, dict[str, str]]:
        """State since the last report: whether all was well, a sentence, and named values as text.

        now_ns: time on the stamps' clock [ns].
        """
        rejections = self.rejected + self.gravity_rejected
        new_rejections, self._reported_rejections = rejections - self._reported_rejections, rejections
        times, self._evaluation_ns = self._evaluation_ns, []
        p50, p99 = np.percentile(times, (50, 99)) / 1e3 if times else (None, None)
        age = None if self.last_stamp_ns is None else (now_ns - self.last_stamp_ns) / 1e9
        values = {
            "joint states received": str(self.received),
            "clouds published": str(self.published),
            "joint states rejected": str(self.rejected),
            "gravity messages rejected": str(self.gravity_rejected),
            "last rejection": self.last_rejection or "none",
            "evaluation p50 [us]": _number(p50, 1),
            "evaluation p99 [us]": _number(p99, 1),
            "last stamp age [s]": _number(age, 3),
        }
        if new_rejections:
            return False, f"{new_rejections} messages rejected: {self.last_rejection}", values
        return True, "draping" if times else "waiting for joint states", values


def contact_values(residual: ContactResidual) -> dict[str, str]:
    """What the push-out left of the last frame's contact, as named values."""
    return {
        "vertices left inside": str(residual.left_inside),
        "deepest left inside [mm]": _number(1e3 * residual.deepest, 2),
    }


def diagnostic_status(name: str, hardware_id: str, well: bool, message: str, values: dict[str, str]):
    """A `diagnostic_msgs/DiagnosticStatus`, OK when `well`, else WARN."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=DiagnosticStatus.OK if well else DiagnosticStatus.WARN,
        name=name,
        hardware_id=hardware_id,
        message=message,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _number(value: float | None, decimals: int) -> str:
    return "none" if value is None else f"{value:.{decimals}f}"
