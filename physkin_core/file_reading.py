"""Reads files from outside, which may be broken, endless or malicious, within limits, or refuses them in one sentence.

A reader raises `ContentError` for what is wrong with a file's content; `reading`, at the reader's edge, says which file
it is and makes all else that goes wrong the same kind of sentence.
"""

from __future__ import annotations

import codecs
import hashlib
import json
import math
import os
import re
import reprlib
import stat
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

__all__ = [
    "LARGEST_FILE",
    "LONGEST_SENTENCE",
    "ContentError",
    "digest_of",
    "file_beside",
    "listed",
    "numbers_of",
    "read_bytes",
    "read_json",
    "read_text",
    "reading",
    "sentence",
    "shown",
    "text_of",
    "with_decimal_points",
]

LARGEST_FILE = 1 << 29  # [bytes]
LONGEST_SENTENCE = 300  # [characters] of an error
LONGEST_VALUE = 60  # [characters] of a value in an error
LISTED = 4
"""Of many names in an error."""
NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?", re.IGNORECASE)
LONGEST_INTEGER = 1 << 10  # [bits]; Python refuses to write much longer ones


class ContentError(ValueError):
    """What is wrong with the content of a file, what is allowed and what to do; `reading` says which file."""


def read_bytes(path: Path, *, most: int = LARGEST_FILE) -> bytes:
    """The content of a regular file of at most `most` bytes, which is opened once.

    Raises OSError where it cannot be opened, ContentError where it is something else, too large, or changes meanwhile.
    """
    with open(path, "rb", opener=_open_at_once) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ContentError(f"{shown(path.name)} is not a regular file; a pipe, device or folder cannot be read")
        if status.st_size > most:
            raise ContentError(f"{shown(path.name)} has {status.st_size} bytes, allowed are {most}")
        content = file.read(status.st_size + 1)
    if len(content) != status.st_size:
        raise ContentError(f"{shown(path.name)} changed from {status.st_size} bytes while it was read; read it again")
    return content


def read_text(path: Path, *, most: int = LARGEST_FILE) -> str:
    """The text of a file. Raises as `read_bytes` and `text_of` do."""
    return text_of(read_bytes(path, most=most))


def digest_of(files: Iterable[Path], *settings: object) -> str:
    """SHA-256 of the kinds and contents of those files that are there, and of settings (by `repr`)."""
    known: list[object] = [*settings]
    for file in filter(Path.is_file, files):
        with open(file, "rb") as content:
            known.append((file.suffix.lower(), hashlib.file_digest(content, "sha256").hexdigest()))
    return hashlib.sha256(repr(known).encode()).hexdigest()


def text_of(content: bytes) -> str:
    """Text as programs write it, with plain line ends: UTF-8, UTF-16, or else Shift-JIS or Latin-1.

    Raises ContentError for a zero byte, with its line."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = content.decode("utf-16", "replace")
    elif 0 in content[:2] != b"\0\0":
        text = content.decode("utf-16-be" if content[0] == 0 else "utf-16-le", "replace")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:  # Latin-1 has no letters where Shift-JIS's kana begin
            text = content.decode("cp932" if re.search(rb"[\x81-\x9f]", content) else "latin-1", "replace")
    text = text.rstrip("\0")  # a disk's last block
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise ContentError(f"line {line} has a zero byte: it is damaged, or no text")
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")


def with_decimal_points(line: str) -> str:
    """A line with points for decimal commas, and blanks for commas and semicolons that separate numbers."""
    if "," not in line and ";" not in line:
        return line
    line = line.replace(";", " ")
    return line.replace(",", " " if "." in line or re.search(r",(\s|$|[^\s,]*,)", line) else ".")


def numbers_of(words: Sequence[str], count: int, line: int) -> list[float]:
    """The `count` finite numbers that words of a line are. Raises ContentError, naming it, where they are not."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        wrong = next((shown(word) for word in words if not NUMBER.fullmatch(word)), f"{len(words)} values")
        raise ContentError(f"line {line} has {wrong}; allowed are {count} finite numbers")
    return numbers


def read_json(content: bytes) -> object:
    """The value of a JSON text. Raises ContentError where it is none."""
    try:
        return json.loads(text_of(content))
    except ValueError as error:
        raise ContentError(f"it is not JSON: {error}") from error


def file_beside(file: Path, name: str) -> Path:
    """The file that `file` names. Raises ContentError unless it is in the folder of `file` or below, links followed."""
    try:
        folder = file.parent.resolve()
        beside = (folder / name).resolve()
        inside, there = beside.is_relative_to(folder), beside.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # too long, a circle of links, a zero byte
        raise ContentError(f"it names {shown(name)}, which no file can be called") from error
    if not inside:
        raise ContentError(f"it names {shown(name)}, outside the folder that it is in; move that file beside it")
    if not there:
        raise ContentError(f"it names {shown(name)}, which does not exist beside it")
    return beside


@contextmanager
def reading(subject: str, error: type[ValueError]) -> Iterator[None]:
    """Whatever goes wrong inside is raised as `error`: one sentence that begins with the subject, "avatar me.glb".

    What is an `error` already says so itself, and is only shortened. A package that is not installed is told as it is.
    """
    try:
        yield
    except ModuleNotFoundError:
        raise
    except Exception as wrong:  # whatever a parser trips over, the file is not readable
        if isinstance(wrong, error):
            if str(wrong) == sentence(str(wrong)):
                raise
            text = str(wrong)
        else:
            text = f"{subject}{_what_is_wrong(wrong)}"
        if len(text) > LONGEST_SENTENCE:  # what is wrong is worth more than the folders on the way
            text = text.replace(subject, _without_folders(subject))
        raise error(sentence(text)) from wrong


def sentence(text: str) -> str:
    """A text for an error or a log: one line of at most `LONGEST_SENTENCE` characters, escaped where not printable, the
    middle left out where it is too long."""
    line = " ".join(_shortened(text, 4 * LONGEST_SENTENCE).split())
    return _shortened(_printable(line), LONGEST_SENTENCE)


def shown(value: object) -> str:
    """A value from outside for an error: its `repr`, shortened and escaped."""
    if isinstance(value, int) and value.bit_length() > LONGEST_INTEGER:
        return f"an integer of {value.bit_length()} bits"
    return _shortened(_printable(_REPR.repr(value)), LONGEST_VALUE)


def listed(names: Collection[object], most: int = LISTED) -> str:
    """Names from outside for an error: the first few as `shown`, and how many there are besides."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(shown, islice(names, most))) + more


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = LONGEST_VALUE


def _open_at_once(path: str, flags: int) -> int:
    """A pipe that nobody writes to would be waited for."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _what_is_wrong(error: Exception) -> str:
    match error:
        case ContentError():
            return f": {error}"
        case FileNotFoundError():
            return ": no such file"
        case OSError():
            return f" cannot be read: {error.strerror or error}"
        case RecursionError():
            return " is nested too deeply"
        case MemoryError():
            return " does not fit in memory"
    return f" is malformed: {type(error).__name__}: {error}"


def _without_folders(subject: str) -> str:
    first, last = subject.find(os.sep), subject.rfind(os.sep)
    return f"{subject[:first]}…{subject[last:]}" if first < last else subject


def _printable(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def _shortened(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    tail = (most - 1) // 2
    return f"{text[: most - 1 - tail]}…{text[-tail:]}"
