"""Checks that an output file can be written, before a command begins its work."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["check_folder", "check_other_file"]


def check_folder(path: Path) -> None:
    """Raises ValueError where `path` is a folder, or where its folder does not exist or may not be written to."""
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ValueError(f"cannot write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise ValueError(f"cannot write {path}: it is a folder")
    if not os.access(folder, os.W_OK):
        raise ValueError(f"cannot write {path}: the folder {path.parent} is read-only for this user")


def check_other_file(path: Path, *read: str | Path) -> None:
    """Raises ValueError where `path` is one of the files that are read: it would be lost."""
    if path.exists() and any(Path(file).is_file() and path.samefile(file) for file in read):
        raise ValueError(f"cannot write {path}: it is the file that is read; give another name")
