"""PLY files: what the header says, and files whose vertices are to be moved while everything else in them stays as it
is, byte for byte.

Dimensions: `n` vertices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, read_bytes, shown

__all__ = ["PlyElement", "PlyFile", "PlyHeader", "read_ply", "read_ply_header"]

TYPES = {
    **{name: "i1" for name in ("char", "int8")},
    **{name: "u1" for name in ("uchar", "uint8")},
    **{name: "i2" for name in ("short", "int16")},
    **{name: "u2" for name in ("ushort", "uint16")},
    **{name: "i4" for name in ("int", "int32")},
    **{name: "u4" for name in ("uint", "uint32")},
    **{name: "f4" for name in ("float", "float32")},
    **{name: "f8" for name in ("double", "float64")},
}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 1 << 16  # [bytes]
MOST_POINTS = 8_000_000
LONGEST_NUMBER = 100  # [characters]
ROWS_AT_ONCE = 10_000


@dataclass(frozen=True)
class PlyElement:
    """Rows of a table. properties: type by name, as in `TYPES`; empty for a list or an unknown type."""

    name: str
    count: int
    properties: dict[str, str]


@dataclass(frozen=True)
class PlyHeader:
    """What stands before the data: how they are laid out, the tables, and where the data begin [bytes]."""

    layout: str
    elements: tuple[PlyElement, ...]
    end: int

    def count(self, name: str) -> int:
        """Rows of the table of that name, 0 where there is none."""
        return sum(element.count for element in self.elements if element.name == name)


@dataclass(frozen=True)
class PlyFile:
    """header: to the end of its last line. vertices: (n,) records, fields as the properties are called. rest: what
    comes after them, faces mostly."""

    header: bytes
    is_ascii: bool
    vertices: np.ndarray
    rest: bytes

    def columns(self, names: tuple[str, ...]) -> np.ndarray | None:
        """(n, k) float64 properties of the vertices; None unless all of them are there."""
        if not set(names) <= set(self.vertices.dtype.names):
            return None
        return np.stack([self.vertices[name] for name in names], axis=1).astype(np.float64)

    def write(self, path: Path, columns: Mapping[str, np.ndarray]) -> None:
        """Write a file of the same kind with other values (n,) of some properties of the vertices."""
        vertices = self.vertices.copy()
        for name, column in columns.items():
            vertices[name] = column
        rows = vertices.tobytes()
        if self.is_ascii:
            rows = "".join(" ".join(map(_text, row)) + "\n" for row in vertices).encode()
        path.write_bytes(self.header + rows + self.rest)


def read_ply(path: Path) -> PlyFile:
    """Read a PLY file whose vertices come first and have x, y, z. Raises ContentError saying what it is instead."""
    content = read_bytes(path)
    header = read_ply_header(content)
    first = header.elements[0] if header.elements else PlyElement("none", 0, {})
    if first.name != "vertex" or first.count > MOST_POINTS:
        found = f"{shown(first.name)} {first.count}"
        raise ContentError(f"its first element must be 'vertex' with a count up to {MOST_POINTS}, got {found}")
    if odd := [name for name, kind in first.properties.items() if not kind]:
        raise ContentError(f"property {shown(odd[0])} of its vertices must be one number")
    if wrong := [name for name in ("x", "y", "z") if first.properties.get(name, "")[:1] != "f"]:
        raise ContentError(f"its vertices must have a property {wrong[0]!r} of floating point")
    dtype = np.dtype([(name, ORDERS[header.layout] + kind) for name, kind in first.properties.items()])
    if header.layout == "ascii":
        vertices, end = _ascii_rows(content, header.end, first.count, dtype)
    else:
        vertices = np.frombuffer(content, dtype, first.count, header.end)
        end = header.end + first.count * dtype.itemsize
    return PlyFile(content[: header.end], header.layout == "ascii", vertices, content[end:])


def read_ply_header(content: bytes) -> PlyHeader:
    """What a PLY file's header says. Raises ContentError where it is none, or more than the file can hold."""
    mark = content.find(b"end_header", 0, LONGEST_HEADER)
    end = content.find(b"\n", mark) + 1
    if not content.startswith(b"ply") or mark < 0 or end == 0:
        raise ContentError(
            f"it is not a PLY file: it has no header from 'ply' to 'end_header' in {LONGEST_HEADER} bytes"
        )
    layout, elements = "", []
    for line in content[:mark].decode("ascii", errors="replace").splitlines():
        match line.split():
            case ["format", kind, _]:
                layout = kind
            case ["element", name, count]:
                if not (count.isascii() and count.isdecimal() and len(count) < 12):
                    raise ContentError(f"its element {shown(name)} must have a count, got {shown(count)}")
                elements.append(PlyElement(name, int(count), {}))
            case ["property", *kind, name] if elements:
                if name in elements[-1].properties:
                    raise ContentError(f"its {shown(elements[-1].name)} have property {shown(name)} twice")
                elements[-1].properties[name] = TYPES.get(kind[0], "") if len(kind) == 1 else ""
    if layout not in ORDERS:
        raise ContentError(f"its format is {shown(layout)}, allowed: {', '.join(ORDERS)}")
    if empty := [element.name for element in elements if not element.properties]:
        raise ContentError(f"its element {shown(empty[0])} has no properties, at least one is needed")
    missing = end + sum(element.count * _least_size(element, layout) for element in elements) - len(content)
    if missing > 0:
        rows = ", ".join(f"{element.count} {shown(element.name)}" for element in elements[:3])
        raise ContentError(f"it is cut off, at least {missing} bytes of its rows ({rows}) are missing")
    return PlyHeader(layout, tuple(elements), end)


def _least_size(element: PlyElement, layout: str) -> int:
    """[bytes] that a row takes at least: lists and unknown types one, a row of text one, but for the last line end."""
    if layout == "ascii":
        return 1
    return sum(np.dtype(kind).itemsize if kind else 1 for kind in element.properties.values())


def _ascii_rows(content: bytes, start: int, count: int, dtype: np.dtype) -> tuple[np.ndarray, int]:
    """Vertices (count,) and where their lines end."""
    *lines, rest = content[start:].split(b"\n", count)
    if len(lines) < count:  # without a line end after the last
        lines, rest = [*lines, rest], b""
    vertices = np.empty(count, dtype=dtype)
    try:
        for first in range(0, count, ROWS_AT_ONCE):
            rows = [line.split() for line in lines[first : first + ROWS_AT_ONCE]]
            if max(len(word) for row in rows for word in row) > LONGEST_NUMBER:
                raise ValueError
            words = np.array(rows).reshape(len(rows), len(dtype.names))
            for name, column in zip(dtype.names, words.T):
                vertices[name][first : first + len(rows)] = column.astype(dtype[name])
    except ValueError as error:
        numbers = f"{count} lines of {len(dtype.names)} numbers of at most {LONGEST_NUMBER} characters"
        raise ContentError(f"its vertices must be {numbers}") from error
    return vertices, len(content) - len(rest)


def _text(value: np.number) -> str:
    return np.format_float_positional(value, trim="-") if value.dtype.kind == "f" else str(value)
