"""One thing that was looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """subject: what it is about. state: "good", "absent" (what it brings cannot be used, the rest can) or "broken"
    (installed or needed, and does not work). said: what was found. remedy: what to do; empty if nothing."""

    subject: str
    state: Literal["good", "absent", "broken"]
    said: str
    remedy: str = ""
