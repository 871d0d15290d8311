"""Files that browsers send, over a real socket."""

from __future__ import annotations

import threading
import time
from itertools import count

import pytest

from physkin_core.view import uploads as module
from physkin_core.view.uploads import Uploads

pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")

import msgspec  # noqa: E402
import viser  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from physkin_core.view.page import Page  # noqa: E402

NUMBERS = count()


class Sender:
    """A page with one button, and a browser that sends files to it. loaded: name and content of those that came; told:
    the notices. A file of the content b"bad" cannot be read."""

    def __init__(self, port: int) -> None:
        self.page, self.loaded, self.told = Page(port=port), [], []
        self.page.notice = lambda title, body="", *, kind="done": self.told.append(body)
        self.uploads = Uploads(self.page)
        self.uploads.add_button("Send", hint="", load=self._load)
        (self._button,) = self.uploads._loads
        self.open()

    def open(self) -> None:
        protocol = f"viser-v{viser.__version__}"
        address = f"ws://localhost:{self.page.server.get_port()}"
        self._socket = connect(address, subprotocols=[protocol], max_size=None, compression=None)
        threading.Thread(target=lambda socket: [None for _ in socket], args=(self._socket,), daemon=True).start()

    def _load(self, path) -> None:
        content = path.read_bytes()
        if content == b"bad":
            raise ValueError("it cannot be read")
        self.loaded.append((path.name, content))

    def send(self, name: str, parts: list[bytes], *, size: int | None = None, announced: int | None = None) -> None:
        """size, announced: what is said of its bytes and parts, which may be a lie."""
        transfer = str(next(NUMBERS))
        keys = {"source_component_uuid": self._button, "transfer_uuid": transfer}
        size = sum(map(len, parts)) if size is None else size
        announced = len(parts) if announced is None else announced
        start = {"filename": name, "mime_type": "", "part_count": announced, "size_bytes": size}
        self._message(type="FileTransferStartUpload", **keys, **start)
        for index, content in enumerate(parts):
            self._message(type="FileTransferPart", **keys, part_index=index, content=content)

    def _message(self, **fields) -> None:
        self._socket.send(msgspec.msgpack.encode(fields))

    def until(self, true) -> None:
        end = time.monotonic() + 20
        while not true():
            assert time.monotonic() < end, (self.loaded, self.told)
            time.sleep(0.01)

    def files(self) -> list[str]:
        folder = self.uploads._kept.parent
        return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())

    def close(self) -> None:
        self._socket.close()
        self.page.server.stop()


@pytest.fixture
def sender():
    made = Sender(8398)
    yield made
    made.close()


def test_files_come_as_they_were_sent(sender):
    """In parts, one after the other; a companion is kept, and stands beside what is read next."""
    sender.send("../../evil/me.glb", [b"x" * 1000, b"y"])
    sender.send("walk.asf", [b"z"])
    sender.send("C:\\here\\walk.amc", [b"a"])
    sender.until(lambda: len(sender.loaded) == 2)
    assert sender.loaded == [("me.glb", b"x" * 1000 + b"y"), ("walk.amc", b"a")]
    assert sender.files() == ["kept/me.glb", "kept/walk.amc", "kept/walk.asf"]
    assert sender.told == ["now send the file that it goes with"]


def test_what_cannot_be_read_does_not_stay(sender):
    """And what it would have replaced is there again."""
    sender.send("me.glb", [b"good"])
    sender.send("me.glb", [b"bad"])
    sender.send("you.glb", [b"bad"])
    sender.until(lambda: len(sender.told) == 2)
    assert sender.told == ["it cannot be read"] * 2 and sender.files() == ["kept/me.glb"]
    assert (sender.uploads._kept / "me.glb").read_bytes() == b"good"
    sender.send("me.glb", [b"better"])
    sender.until(lambda: len(sender.loaded) == 2)
    assert sender.files() == ["kept/me.glb"]


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        ({"name": "..", "parts": [b"x"]}, "'..' is not a file name; rename it"),
        ({"name": "a\0b.glb", "parts": [b"x"]}, "is not a file name; rename it"),
        ({"name": "x" * 400, "parts": [b"x"]}, "File name too long"),
        ({"name": "no.glb", "parts": []}, "'no.glb' has 0 bytes; allowed are 1 to 268435456"),
        ({"name": "\x1b[2J" + "x" * 9000, "parts": [], "size": 1 << 40}, "'\\x1b[2Jxxx"),
        ({"name": "less.glb", "parts": [b"x", b"y"], "size": 3}, "did not arrive as announced"),
        ({"name": "more.glb", "parts": [b"x" * 100, b"y"], "size": 9}, "did not arrive as announced"),
    ],
)
def test_what_is_refused(sender, sent, told):
    """In a sentence, once, without a file that stays; the next one is taken."""
    sender.send(**sent)
    sender.until(lambda: sender.told)
    sender.send("me.glb", [b"x"])
    sender.until(lambda: sender.loaded)
    assert len(sender.told) == 1 and told in sender.told[0] and len(sender.told[0]) <= 300
    assert sender.files() == ["kept/me.glb"]


def test_all_that_is_sent_is_limited(sender, monkeypatch):
    """What is kept counts, and what is on its way, until its browser is gone."""
    monkeypatch.setattr(module, "MOST", 1000)
    sender.send("kept.glb", [b"x" * 500])
    sender.until(lambda: sender.loaded)
    sender.send("coming.glb", [b"x"], size=400, announced=2)
    sender.send("toomuch.glb", [b"x" * 101])
    sender.until(lambda: sender.told)
    assert "'toomuch.glb' is too much: the page has 900 bytes of files" in sender.told[0]
    sender._socket.close()
    sender.until(lambda: not sender.uploads._arriving and sender.files() == ["kept/kept.glb"])
    sender.open()
    for k in range(module.MOST_ARRIVING + 1):
        sender.send(f"{k}.glb", [], size=1, announced=1)
    sender.until(lambda: len(sender.told) == 2)
    assert "'8.glb' has to wait: 8 files are on their way" in sender.told[1]
