"""The document of a glTF 2.0 file, JSON whose members are checked when they are asked for, and its binary chunk."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import TypeVar

from physkin_core.file_reading import ContentError, read_json, shown

__all__ = ["GltfEntry", "parse_gltf"]

GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
GLB_HEADER, CHUNK_HEADER = 12, 8  # [bytes]
LARGEST_INTEGER = 1 << 53

Choice = TypeVar("Choice")


class GltfEntry:
    """An object of the document. where: its path there, for errors; empty for all of it. What is null is left out.

    Raises ContentError where a member is not what it is asked for as.
    """

    def __init__(self, members: object, where: str) -> None:
        if not isinstance(members, dict):
            raise ContentError(f"{where or 'the document'} is {shown(members)}, it must be a JSON object")
        self.members, self.where = members, where

    def __contains__(self, key: str) -> bool:
        return self.members.get(key) is not None

    def integer(self, key: str, otherwise: int | None = None) -> int:
        """A whole number from 0. otherwise: what is meant where it is left out; None where it must not be."""
        value = self.members.get(key)
        value = otherwise if value is None else value
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < LARGEST_INTEGER:
            raise self._wrong(key, "a whole number from 0")
        return value

    def index(self, key: str) -> int | None:
        """A whole number from 0, None where it is left out."""
        return self.integer(key) if key in self else None

    def indices(self, key: str) -> list[int]:
        """Whole numbers from 0, none where they are left out."""
        values = self._list(key)
        if not all(type(value) is int and 0 <= value < LARGEST_INTEGER for value in values):
            raise self._wrong(key, "whole numbers from 0")
        return values

    def numbers(self, key: str, count: int | None = None) -> list[float] | None:
        """So many finite numbers, any count for None; None where they are left out."""
        if key not in self:
            return None
        values = self._list(key)
        plain = all(type(value) in (int, float) and abs(value) < 1e300 and math.isfinite(value) for value in values)
        if not plain or count not in (None, len(values)):
            raise self._wrong(key, f"{'' if count is None else f'{count} '}finite numbers")
        return [float(value) for value in values]

    def text(self, key: str) -> str:
        """A text, empty where it is left out."""
        value = self.members.get(key)
        if value is not None and not isinstance(value, str):
            raise self._wrong(key, "a text")
        return value or ""

    def choice(self, key: str, allowed: Mapping[object, Choice]) -> Choice:
        """What `allowed` has for a member."""
        value = self.members.get(key)
        if not isinstance(value, (int, str)) or value not in allowed:
            raise self._wrong(key, f"one of {', '.join(map(str, allowed))}")
        return allowed[value]

    def entry(self, key: str) -> GltfEntry:
        """An object within, empty where it is left out."""
        return GltfEntry(self.members[key] if key in self else {}, self._path(key))

    def entries(self, key: str) -> list[GltfEntry]:
        """The objects of a list within, none where it is left out."""
        return [GltfEntry(each, f"{self._path(key)}[{number}]") for number, each in enumerate(self._list(key))]

    def count(self, key: str) -> int:
        """The length of a list within."""
        return len(self._list(key))

    def item(self, key: str, number: int) -> GltfEntry:
        """One object of a list within."""
        values = self._list(key)
        if not 0 <= number < len(values):
            raise ContentError(f"it names {key}[{number}], allowed are 0 to {len(values) - 1}")
        return GltfEntry(values[number], f"{self._path(key)}[{number}]")

    def _list(self, key: str) -> list:
        value = self.members[key] if key in self else []
        if not isinstance(value, list):
            raise self._wrong(key, "a list")
        return value

    def _path(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def _wrong(self, key: str, allowed: str) -> ContentError:
        return ContentError(f"{self._path(key)} is {shown(self.members.get(key))}, it must be {allowed}")


def parse_gltf(content: bytes) -> tuple[GltfEntry, bytes]:
    """The document and the binary chunk, empty for none, of a GLB or glTF file. Raises ContentError."""
    if content[: len(GLB_MAGIC)] != GLB_MAGIC:
        if not content[:64].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
            found = f"begins with {shown(content[:16])}" if content else "is empty"
            allowed = f"allowed are {GLB_MAGIC!r} and JSON"
            raise ContentError(f"it is not a glTF file: it {found}, {allowed}; export or download it again")
        return GltfEntry(read_json(content), ""), b""
    if len(content) < GLB_HEADER:
        raise ContentError(f"it is truncated: {len(content)} of at least {GLB_HEADER} bytes; export it again")
    version, length = struct.unpack_from("<II", content, len(GLB_MAGIC))
    if version != 2:
        raise ContentError(f"it is glTF version {version}, allowed is 2; export it as glTF 2.0")
    if length > len(content):
        raise ContentError(f"it is truncated: {len(content)} of {length} bytes; export it again")
    kind, text, end = _chunk(content[:length], GLB_HEADER)
    if kind != JSON_CHUNK:
        raise ContentError(f"its first chunk is {shown(kind)}, it must be {JSON_CHUNK!r}")
    kind, binary, _ = _chunk(content[:length], end)  # later ones are extensions'
    return GltfEntry(read_json(text), ""), binary if kind == BINARY_CHUNK else b""


def _chunk(content: bytes, start: int) -> tuple[bytes, bytes, int]:
    """Kind and content of a chunk of a GLB, both empty where there is none, and where it ends."""
    if start + CHUNK_HEADER > len(content):
        return b"", b"", start
    length, kind = struct.unpack_from("<I4s", content, start)
    end = start + CHUNK_HEADER + length
    if end > len(content):
        raise ContentError(f"it is truncated: its chunk {kind!r} ends at byte {end} of {len(content)}")
    return kind, content[start + CHUNK_HEADER : end], end
