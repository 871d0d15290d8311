"""Files that browsers send: how large they may be, where they are kept, and that none stays which could not be read."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import IO

from physkin_core.file_reading import shown
from physkin_core.view.page import Page

__all__ = ["Uploads"]

LARGEST, MOST = 256 << 20, 1 << 30
"""[bytes] Of one file, and of all that are kept or on their way."""
MOST_ARRIVING = 8
COMPANIONS = (".asf", ".rig.json", ".mtl", ".bin")
"""Ends of the names of files that others need: kept, and read with those."""


@dataclass
class Arriving:
    """A file on its way. parts: how many it comes in; part: the next of them. size: [bytes] as announced. load: what it
    is for."""

    client_id: int
    name: str
    size: int
    parts: int
    load: Callable[[Path], None]
    file: IO[bytes]
    part: int = 0


class Uploads:
    """Files that a browser has sent, under the names they had, in a folder that goes with this object.

    It takes the place of what viser does with files: that keeps whatever comes, of any size, in memory.
    """

    def __init__(self, page: Page) -> None:
        from viser import _messages as messages

        self._folder = tempfile.TemporaryDirectory(prefix="physkin-view-", ignore_cleanup_errors=True)
        self._kept, self._coming = (Path(self._folder.name) / name for name in ("kept", "coming"))
        self._kept.mkdir()
        self._coming.mkdir()
        self._page, self._messages, self._numbers = page, messages, count()
        self._loads: dict[str, Callable[[Path], None]] = {}
        self._arriving: dict[str, Arriving] = {}
        self._loader = ThreadPoolExecutor(1, thread_name_prefix="physkin-uploads")
        gui = page.server.gui
        self._browsers = gui._websock_interface
        for kind, takes, took in (
            (messages.FileTransferStartUpload, self._begin, gui._handle_file_transfer_start),
            (messages.FileTransferPart, self._go_on, gui._handle_file_transfer_part),
        ):
            self._browsers.unregister_handler(kind, took)
            self._browsers.register_handler(kind, page.guarded(takes))
        self._browsers.on_client_disconnect(self._forget)

    def add_button(self, label: str, *, hint: str, load: Callable[[Path], None]) -> None:
        """Add a button that sends files; `load` is given where one is kept, unless it only goes with another."""
        button = self._page.server.gui.add_upload_button(label, hint=hint, icon="upload")
        self._loads[button._impl.uuid] = load

    @contextlib.contextmanager
    def kept(self, name: str, content: Path) -> Iterator[Path]:
        """Move a file here, whatever folder its name asks for. An error inside takes it away again, and puts back what
        it has replaced. Raises ValueError for a name that is none."""
        plain = Path(name.replace("\\", "/")).name
        if plain in ("", ".", "..") or "\0" in plain:
            raise ValueError(f"{shown(name)} is not a file name; rename it")
        path, before = self._kept / plain, self._coming / f"before{next(self._numbers)}"
        if path.exists():
            os.replace(path, before)
        try:
            os.replace(content, path)
            yield path
        except BaseException:
            path.unlink(missing_ok=True)
            if before.exists():
                os.replace(before, path)
            raise
        before.unlink(missing_ok=True)

    @staticmethod
    def is_companion(path: Path) -> bool:
        """Whether it only goes with another file, which is to be sent next."""
        return path.name.lower().endswith(COMPANIONS)

    def _begin(self, client_id: int, message) -> None:
        """A file is announced. What is refused is not begun, so that its parts go nowhere."""
        load = self._loads.get(message.source_component_uuid)
        if load is None:
            return
        try:
            self._check(message.filename, message.size_bytes)
        except ValueError:
            self._acknowledge(message, message.size_bytes, message.size_bytes)  # or its button waits for ever
            raise
        file = open(self._coming / str(next(self._numbers)), "wb")
        size, parts = message.size_bytes, message.part_count
        self._arriving[message.transfer_uuid] = Arriving(client_id, message.filename, size, parts, load, file)

    def _check(self, name: str, size: int) -> None:
        if not 0 < size <= LARGEST:
            allowed = f"allowed are 1 to {LARGEST}; larger ones are for the command line"
            raise ValueError(f"{shown(name)} has {shown(size)} bytes; {allowed}")
        held = 0
        for path in self._kept.iterdir():
            with contextlib.suppress(FileNotFoundError):  # the loader has just put it aside
                held += path.stat().st_size
        held += sum(each.size for each in self._arriving.values())
        if held + size > MOST:
            raise ValueError(f"{shown(name)} is too much: the page has {held} bytes of files, of {MOST}; start it anew")
        if len(self._arriving) >= MOST_ARRIVING:
            raise ValueError(f"{shown(name)} has to wait: {MOST_ARRIVING} files are on their way; send it again then")

    def _go_on(self, client_id: int, message) -> None:
        arriving = self._arriving.get(message.transfer_uuid)
        if arriving is None or arriving.client_id != client_id:
            return
        received = arriving.file.tell() + len(message.content)
        arriving.part += 1
        whole = arriving.part >= arriving.parts
        if message.part_index != arriving.part - 1 or received > arriving.size or (whole and received < arriving.size):
            self._drop(message.transfer_uuid)
            self._acknowledge(message, arriving.size, arriving.size)
            raise ValueError(f"{shown(arriving.name)} did not arrive as announced; send it again")
        arriving.file.write(message.content)
        self._acknowledge(message, received, arriving.size)
        if whole:
            del self._arriving[message.transfer_uuid]
            arriving.file.close()
            self._loader.submit(self._page.guarded(self._load), arriving)

    def _load(self, arriving: Arriving) -> None:
        content = Path(arriving.file.name)
        try:
            with self.kept(arriving.name, content) as path:
                if self.is_companion(path):
                    self._page.notice(f"Kept {path.name}", "now send the file that it goes with")
                else:
                    arriving.load(path)
        finally:
            content.unlink(missing_ok=True)

    def _forget(self, browser) -> None:
        for transfer in [key for key, each in self._arriving.items() if each.client_id == browser.client_id]:
            self._drop(transfer)

    def _drop(self, transfer: str) -> None:
        arriving = self._arriving.pop(transfer)
        arriving.file.close()
        Path(arriving.file.name).unlink(missing_ok=True)

    def _acknowledge(self, message, received: int, size: int) -> None:
        self._browsers.queue_message(
            self._messages.FileTransferPartAck(
                source_component_uuid=message.source_component_uuid,
                transfer_uuid=message.transfer_uuid,
                transferred_bytes=received,
                total_bytes=size,
            )
        )
