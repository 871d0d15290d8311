"""The known names that a wrong one may have meant."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches

__all__ = ["nearest_names"]

LONGEST = 60
"""Names are compared up to this length: the work grows with its square, and strangers choose names."""


def nearest_names(name: str, known: Collection[str], *, most: int = 3) -> str:
    """Up to `most` of the names that are known, as "'a' or 'b'", the nearest first; "" when none is near."""
    folded = {each.casefold(): each for each in known}
    near = get_close_matches(str(name)[:LONGEST].casefold(), folded, n=most, cutoff=0.5)
    return " or ".join(repr(folded[each]) for each in near)
