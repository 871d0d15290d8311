"""Messages that never came, by the gaps that they leave in stamps that are otherwise even."""

from __future__ import annotations

__all__ = ["MissingMessages"]

CERTAIN = 8
"""Steps in a row that must be alike before a gap counts."""
ALIKE = 0.2
"""Of a step: how much one may differ from the others, or a gap from a number of them."""
PAUSE = 1_000_000_000
"""[ns] Where nothing came for so long, the publisher has paused."""
PACE = 1 / 8  # of the latest step, in the mean that a clock's drift changes


class MissingMessages:
    """Follows the stamps of one stream. Two publishers that take turns stamp unevenly, and nothing is counted then."""

    def __init__(self) -> None:
        self._stamp = self._arrived = 0
        self._step, self._even = 0.0, 0
        self._steps, self._alike = 1, 0
        self._passed = 0

    def count(self, stamp_ns: int, arrived_ns: int) -> int:
        """How many are missing before the message with this stamp, which has come at this time."""
        step, waited = stamp_ns - self._stamp, arrived_ns - self._arrived
        if step == 0:
            return 0
        self._stamp, self._arrived = stamp_ns, arrived_ns
        passed, self._passed = self._passed, 0
        if step < 0 or waited > PAUSE:
            self._even = 0
            return 0
        steps = max(1, round(step / self._step)) if self._even >= CERTAIN else 1
        self._alike = self._alike + 1 if steps == self._steps else 0
        self._steps = steps
        if abs(step - steps * self._step) > ALIKE * self._step or (steps > 1 and self._alike >= CERTAIN):
            self._step, self._even = float(step), 0  # another pace
        elif steps == 1:
            self._even += 1
            self._step += PACE * (step - self._step)
        else:
            return max(0, steps - 1 - passed)
        return 0

    def pass_over(self) -> None:
        """A message has come whose stamp is not known."""
        self._passed += 1
