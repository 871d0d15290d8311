"""Files that browsers send, as viser gives them."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from physkin_core.view import uploads as module
from physkin_core.view.uploads import Uploads

viser = pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")


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
        self._take(SimpleNamespace(target=SimpleNamespace(value=viser.UploadedFile(name, content))))

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
