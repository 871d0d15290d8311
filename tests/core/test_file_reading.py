"""Files from outside are opened once, limited and contained; what is wrong with them is told in one sentence."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path

import pytest
from fuzzing import damaged

from physkin_core.file_reading import (
    LONGEST_SENTENCE,
    ContentError,
    file_beside,
    read_bytes,
    read_json,
    reading,
    sentence,
    shown,
    text_of,
    with_decimal_points,
)
from physkin_core.formats.obj_file import read_obj


class OwnError(ValueError):
    """What some reader raises."""


def _fails(error):
    with reading("avatar me.glb", OwnError):
        raise error


def test_files_are_limited(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bytes(tmp_path / "a", most=5) == b"12345"
    with pytest.raises(ContentError, match="'a' has 5 bytes, allowed are 4"):
        read_bytes(tmp_path / "a", most=4)


@pytest.mark.timeout(20)
def test_only_regular_files_are_read(tmp_path):
    """A pipe that nobody writes to, and a device that never ends."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ContentError, match="not a regular file"):
            read_bytes(path)
    with pytest.raises(OwnError, match="^body cannot be read: Is a directory$"), reading("body", OwnError):
        read_bytes(tmp_path)


def test_a_file_that_grows_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"12345")
    before = os.stat(tmp_path / "a")
    (tmp_path / "a").write_bytes(b"1234567")
    monkeypatch.setattr(os, "fstat", lambda descriptor: before)
    with pytest.raises(ContentError, match="changed from 5 bytes while it was read"):
        read_bytes(tmp_path / "a")


def test_named_files_are_beside(tmp_path):
    """In the folder or below; neither through a link nor by any path out of it."""
    folder = tmp_path / "folder"
    (folder / "maps").mkdir(parents=True)
    (folder / "maps" / "skin.png").write_bytes(b"x")
    (tmp_path / "secret").write_bytes(b"x")
    (folder / "link").symlink_to(tmp_path / "secret")
    (folder / "circle").symlink_to(folder / "circle")
    file = folder / "me.obj"
    assert file_beside(file, "maps/../maps/skin.png").read_bytes() == b"x"
    for name in ("../secret", "/etc/passwd", str(tmp_path / "secret"), "link", "../../../../../../../../etc/passwd"):
        with pytest.raises(ContentError, match="outside the folder that it is in"):
            file_beside(file, name)
    for name in ("gone.png", "", "maps"):
        with pytest.raises(ContentError, match="does not exist beside it"):
            file_beside(file, name)
    for name in ("circle", "a\0b", "a" * 100_000):
        with pytest.raises(ContentError, match="which no file can be called|does not exist") as told:
            file_beside(file, name)
        assert len(str(told.value)) < LONGEST_SENTENCE and str(told.value).isprintable()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ContentError("it has 5 bytes"), "avatar me.glb: it has 5 bytes"),
        (OwnError("all of it"), "all of it"),
        (FileNotFoundError(2, "No such file or directory"), "avatar me.glb: no such file"),
        (PermissionError(13, "Permission denied"), "avatar me.glb cannot be read: Permission denied"),
        (RecursionError("maximum recursion depth"), "avatar me.glb is nested too deeply"),
        (MemoryError(), "avatar me.glb does not fit in memory"),
        (OverflowError("too large"), "avatar me.glb is malformed: OverflowError: too large"),
        (struct.error("short"), "avatar me.glb is malformed: error: short"),
        (KeyError("node"), "avatar me.glb is malformed: KeyError: 'node'"),
        (RuntimeError("a\nb \x1b[2J"), "avatar me.glb is malformed: RuntimeError: a b \\x1b[2J"),
    ],
)
def test_whatever_goes_wrong_is_one_sentence(error, message):
    with pytest.raises(OwnError) as told:
        _fails(error)
    assert str(told.value) == message


def test_long_errors_are_shortened():
    """The reader's own ones, too; the beginning and the end stay."""
    for error in (OwnError("a" * 5000 + "; do this"), TypeError("a" * 10**6 + "; do this")):
        with pytest.raises(OwnError) as told:
            _fails(error)
        assert len(str(told.value)) == LONGEST_SENTENCE
        assert "aaa…aaa" in str(told.value) and str(told.value).endswith("; do this")


def test_folders_are_left_out_first():
    """Where a sentence is too long; what is wrong stays whole."""
    subject = f"avatar /{'folder/' * 40}me.glb"
    for wrong in (ContentError("a" * 200), OwnError(f"{subject}: {'a' * 200}")):
        with pytest.raises(OwnError) as told, reading(subject, OwnError):
            raise wrong
        assert str(told.value) == f"avatar …/me.glb: {'a' * 200}"


def test_missing_packages_are_told_as_they_are():
    with pytest.raises(ModuleNotFoundError, match="pillow"):
        _fails(ModuleNotFoundError("pillow"))


def test_deep_text_is_refused():
    with pytest.raises(OwnError, match="^map is nested too deeply$"), reading("map", OwnError):
        json.loads("[" * 100_000)


def test_what_is_no_json_is_refused():
    """Numbers that Python refuses, too; the mark of a byte order is none of the text."""
    assert read_json(b'\xef\xbb\xbf{"a": [1, 2]}') == {"a": [1, 2]}
    with pytest.raises(ContentError, match="it is not JSON: Exceeds the limit"):
        read_json(b"9" * 5000)


TEXT = "v 1 2\n幾何\tname\n"


@pytest.mark.parametrize(
    "content",
    [
        *(TEXT.encode(name) for name in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "shift-jis")),
        b"\xfe\xff" + TEXT.encode("utf-16-be"),
        TEXT.replace("\n", "\r\n").encode(),
        TEXT.replace("\n", "\r\r\n").encode("utf-16"),
        TEXT.replace("\n", "\r").encode(),
        TEXT.encode() + b"\0" * 512,
    ],
)
def test_text_is_read_in_any_encoding(content):
    """Whatever the byte order and the line ends; a disk's last block may be padded."""
    assert text_of(content) == TEXT


def test_text_of_western_names():
    """Letters of Latin-1 are no Shift-JIS, and nothing else changes, whatever the bytes are."""
    assert text_of("Hüfte\xa0é {\n".encode("latin-1")) == "Hüfte\xa0é {\n"
    assert text_of(b"\x81\n{") == "\ufffd\n{"


def test_line_ends_take_no_time():
    """However many there are in a row, of either kind."""
    assert text_of(b"\r" * 10**6 + b"x") == "\n" * 10**6 + "x"


def test_what_is_no_text_is_refused():
    """With the line, where there is one."""
    with pytest.raises(ContentError, match="^line 3 has a zero byte: it is damaged, or no text$"):
        text_of(b"a\r\nb\r\nc\0d")
    with pytest.raises(ContentError, match="not JSON: line 2 has a zero byte"):
        read_json(b'{"a":\n1\0}')


def test_decimal_commas():
    """Commas are decimal where nothing says that they separate numbers."""
    for line, meant in {
        "v 0,5 -1 2,25": [0.5, -1, 2.25],
        "v 0.5, -1, 2.25": [0.5, -1, 2.25],
        "v 0.5,-1,2.25": [0.5, -1, 2.25],
        "v 1, 2, 3": [1, 2, 3],
        "v 1,2,3": [1, 2, 3],
        "v 0,5;1;2,5": [0.5, 1, 2.5],
    }.items():
        assert [float(word) for word in with_decimal_points(line).split()[1:]] == meant, line


def test_objects_are_read_in_any_encoding(tmp_path):
    """With decimal commas, too; the written copy is plain."""
    path = tmp_path / "a.obj"
    path.write_bytes("g 袖\nv 0,5 0 1,25\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".replace("\n", "\r\r\n").encode("shift-jis"))
    file = read_obj(path)
    assert file.vertices[0].tolist() == [0.5, 0, 1.25] and file.names[0].group == "袖"
    file.write(path, file.vertices)
    assert path.read_text("utf-8") == "g 袖\nv 0.5 0 1.25\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_values_are_shown_short_and_escaped():
    assert shown("bone") == "'bone'"
    assert shown(3) == "3"
    assert shown("\x1b[2J\n\ud800\u202e") == r"'\x1b[2J\n\ud800\u202e'"
    assert shown(10**5000) == "an integer of 16610 bits"
    for value in ("a" * 10**6, b"\0" * 10**6, list(range(10**5)), {"a": ["b" * 100] * 100}, 10**300):
        assert len(shown(value)) <= 60 and shown(value).isprintable()


def test_sentences_are_printable_lines():
    assert sentence("a\r\n\tb\0") == r"a b\x00"
    assert len(sentence("\0" * 10**6)) == LONGEST_SENTENCE


def test_damage_is_seeded():
    """Equal for equal seeds, and seldom none."""
    content = bytes(range(256)) * 20 + b"vertex 100\n" * 20
    assert [damaged(content, seed) for seed in range(50)] == [damaged(content, seed) for seed in range(50)]
    assert sum(damaged(content, seed) == content for seed in range(200)) < 20
    assert isinstance(damaged(b"", 1), bytes)
