"""Files that browsers send: how large they may be, where they are kept, and that none stays which could not be read."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Lock

from physkin_core.file_reading import shown
from physkin_core.view.page import Page

__all__ = ["Uploads"]

LARGEST, MOST = 256 << 20, 1 << 30
"""[bytes] Of one file, and of all that are kept."""
COMPANIONS = (".asf", ".rig.json", ".bones.json", ".mtl", ".bin")
"""Ends of the names of files that others need: kept, and read with those."""


class Uploads:
    """Files that a browser has sent, under the names they had, in a folder that goes with this object."""

    def __init__(self, page: Page) -> None:
        self._page, self._one_at_a_time = page, Lock()
        self._folder = tempfile.TemporaryDirectory(prefix="physkin-view-", ignore_cleanup_errors=True)
        self._kept = Path(self._folder.name) / "kept"
        self._kept.mkdir()

    def add_button(self, label: str, *, hint: str, load: Callable[[Path], None]) -> None:
        """Add a button that sends files; `load` is given where one is kept, unless it only goes with another."""

        def take(event) -> None:
            sent = event.target.value
            with self._one_at_a_time, self.kept(sent.name, sent.content) as path:
                if path.name.lower().endswith(COMPANIONS):
                    self._page.notice(f"Kept {path.name}", "now send the file that it goes with")
                else:
                    load(path)

        self._page.server.gui.add_upload_button(label, hint=hint, icon="upload").on_upload(self._page.guarded(take))

    @contextlib.contextmanager
    def kept(self, name: str, content: bytes) -> Iterator[Path]:
        """Write a file here, whatever folder its name asks for. An error inside takes it away again, and puts back what
        it has replaced. Raises ValueError for a name that is none, and for a file that is too large."""
        plain = Path(name.replace("\\", "/")).name
        if plain in ("", ".", "..") or "\0" in plain:
            raise ValueError(f"{shown(name)} is not a file name; rename it")
        if not 0 < len(content) <= LARGEST:
            allowed = f"allowed are 1 to {LARGEST}; larger ones are for the command line"
            raise ValueError(f"{shown(name)} has {len(content)} bytes; {allowed}")
        held = sum(path.stat().st_size for path in self._kept.iterdir())
        if held + len(content) > MOST:
            raise ValueError(f"{shown(name)} is too much: the page has {held} bytes of files, of {MOST}; start it anew")
        path, before = self._kept / plain, Path(self._folder.name) / "before"
        if path.exists():
            os.replace(path, before)
        try:
            path.write_bytes(content)
            yield path
        except BaseException:
            with contextlib.suppress(OSError):  # a name that is too long
                path.unlink(missing_ok=True)
            if before.exists():
                os.replace(before, path)
            raise
        before.unlink(missing_ok=True)
