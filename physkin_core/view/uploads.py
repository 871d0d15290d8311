"""Files that a browser has sent, in a folder of their own, under the names they had."""

from __future__ import annotations

import tempfile
from pathlib import Path

__all__ = ["Uploads"]

COMPANIONS = (".asf", ".rig.json", ".mtl", ".bin")
"""Ends of the names of files that others need: kept, and read with those."""


class Uploads:
    """Gone with the object."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="physkin-view-")

    def keep(self, name: str, content: bytes) -> Path:
        """Write a file, whatever folder its name asks for. Raises ValueError for a name that is none, or no content."""
        plain = Path(name.replace("\\", "/")).name
        if plain in ("", ".", ".."):
            raise ValueError(f"{name!r} is no name of a file")
        if not content:
            raise ValueError(f"{plain} is empty")
        path = Path(self._folder.name) / plain
        path.write_bytes(content)
        return path

    @staticmethod
    def is_companion(path: Path) -> bool:
        """Whether it only goes with another file, which is to be sent next."""
        return path.name.lower().endswith(COMPANIONS)
