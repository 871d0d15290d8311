"""Files that browsers send, one of them over a real socket."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest

from physkin_core.view import uploads as module
from physkin_core.view.uploads import Uploads

pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")

import msgspec  # noqa: E402
import viser  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from physkin_core.view.page import Page  # noqa: E402

CAMERA = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 0), "look_at": (1, 0, 0), "up_direction": (0, 0, 1)}
CAMERA |= {"fov": 1.0, "near": 0.1, "far": 9.0, "image_height": 9, "image_width": 9}


class Sender:
    """Uploads with one button. loaded: name and content of files that came; told: the notices. A file of the content
    b"bad" cannot be read."""

    def __init__(self) -> None:
        self.loaded, self.told, self._take = [], [], None
        button = SimpleNamespace(on_upload=lambda take: setattr(self, "_take", take))
        gui = SimpleNamespace(add_upload_button=lambda label, **_: button)
        self.uploads = Uploads(
            SimpleNamespace(
                server=SimpleNamespace(gui=gui),
                notice=lambda title, body: self.told.append(body),
                guarded=self._guarded,
            )
        )
        self.uploads.add_button("Send", hint="", load=self._load)

    def _guarded(self, callback):
        def called(*arguments) -> None:
            try:
                callback(*arguments)
            except (ValueError, OSError) as error:
                self.told.append(str(error))

        return called

    def _load(self, path) -> None:
        content = path.read_bytes()
        if content == b"bad":
            raise ValueError("it cannot be read")
        self.loaded.append((path.name, content))

    def send(self, name: str, content: bytes) -> None:
        self._take(SimpleNamespace(target=SimpleNamespace(value=SimpleNamespace(name=name, content=content))))

    def files(self) -> list[str]:
        folder = self.uploads._kept.parent
        return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def sender():
    return Sender()


def test_files_come_as_they_were_sent(sender):
    """Under their plain names; a companion is kept, and stands beside what is read next."""
    sender.send("../../evil/me.glb", b"x" * 1000)
    sender.send("walk.asf", b"z")
    sender.send("C:\\here\\walk.amc", b"a")
    assert sender.loaded == [("me.glb", b"x" * 1000), ("walk.amc", b"a")]
    assert sender.files() == ["kept/me.glb", "kept/walk.amc", "kept/walk.asf"]
    assert sender.told == ["now send the file that it goes with"]


def test_what_cannot_be_read_does_not_stay(sender):
    """And what it would have replaced is there again."""
    for name, content in (("me.glb", b"good"), ("me.glb", b"bad"), ("you.glb", b"bad")):
        sender.send(name, content)
    assert sender.told == ["it cannot be read"] * 2 and sender.files() == ["kept/me.glb"]
    assert (sender.uploads._kept / "me.glb").read_bytes() == b"good"
    sender.send("me.glb", b"better")
    assert sender.loaded[-1] == ("me.glb", b"better") and sender.files() == ["kept/me.glb"]


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("..", b"x", "'..' is not a file name; rename it"),
        ("a\0b.glb", b"x", "is not a file name; rename it"),
        ("x" * 400, b"x", "File name too long"),
        ("no.glb", b"", "'no.glb' has 0 bytes; allowed are 1 to 40"),
        ("\x1b[2J" + "x" * 9000, b"x" * 41, "'\\x1b[2Jxxx"),
        ("more.glb", b"x" * 39, "'more.glb' is too much: the page has 30 bytes of files, of 60; start it anew"),
    ],
)
def test_what_is_refused(name, content, told, sender, monkeypatch):
    """In a sentence, once, without a file that stays; the next one is taken."""
    monkeypatch.setattr(module, "LARGEST", 40)
    monkeypatch.setattr(module, "MOST", 60)
    sender.send("first.glb", b"x" * 30)
    sender.send(name, content)
    sender.send("me.glb", b"x")
    assert [each for each, _ in sender.loaded] == ["first.glb", "me.glb"]
    (said,) = sender.told
    assert told in said and sender.files() == ["kept/first.glb", "kept/me.glb"]


def test_a_browser_sends_a_file():
    """Over a real socket, as viser's page does."""
    page, loaded = Page(port=8398), []
    Uploads(page).add_button("Send", hint="", load=lambda path: loaded.append((path.name, path.read_bytes())))
    address, protocol = f"ws://localhost:{page.server.get_port()}", f"viser-v{viser.__version__}"
    (button,) = page.server.gui._gui_input_handle_from_uuid
    keys = {"source_component_uuid": button, "transfer_uuid": "1"}
    start = {"filename": "me.glb", "mime_type": "", "part_count": 2, "size_bytes": 3}
    try:
        with connect(address, subprotocols=[protocol], max_size=None, compression=None) as socket:
            threading.Thread(target=lambda: [None for _ in socket], daemon=True).start()
            socket.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **CAMERA}))  # what a browser begins with
            socket.send(msgspec.msgpack.encode({"type": "FileTransferStartUpload", **keys, **start}))
            for index, content in enumerate((b"ab", b"c")):
                part = {"type": "FileTransferPart", **keys, "part_index": index, "content": content}
                socket.send(msgspec.msgpack.encode(part))
            end = time.monotonic() + 20
            while not loaded and time.monotonic() < end:
                time.sleep(0.01)
        assert loaded == [("me.glb", b"abc")]
    finally:
        page.server.stop()
