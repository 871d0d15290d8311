"""What was made last, as long as it takes no more than so many bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Any

__all__ = ["Kept"]


class Kept:
    """Values by key, the latest; those that were used longest ago go first. most: [bytes] of all together."""

    def __init__(self, most: int) -> None:
        self.most, self.size = most, 0
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def get(self, key: Hashable) -> Any:
        """The value of a key, None where it is not kept."""
        if key not in self._values:
            return None
        self._values.move_to_end(key)
        return self._values[key][0]

    def keep(self, key: Hashable, value: object, size: int) -> None:
        """Keep a value of so many bytes under a key that has none; one that is larger than all may be is not kept."""
        self._values[key] = value, size
        self.size += size
        while self.size > self.most:
            self.size -= self._values.popitem(last=False)[1][1]
