"""PLY files whose vertices are to be moved while everything else in them stays as it is, byte for byte.

Dimensions: `n` vertices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, read_bytes, shown

__all__ = ["PlyFile", "read_ply"]

TYPES = {
    name: kind
    for kind, names in {
        "i1": ("char", "int8"),
        "u1": ("uchar", "uint8"),
        "i2": ("short", "int16"),
        "u2": ("ushort", "uint16"),
        "i4": ("int", "int32"),
        "u4": ("uint", "uint32"),
        "f4": ("float", "float32"),
        "f8": ("double", "float64"),
    }.items()
    for name in names
}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 1 << 16  # [bytes]


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
    mark = content.find(b"end_header", 0, LONGEST_HEADER)
    start = content.find(b"\n", mark) + 1
    if not content.startswith(b"ply") or mark < 0 or start == 0:
        raise ContentError(
            f"it is not a PLY file: it has no header from 'ply' to 'end_header' in {LONGEST_HEADER} bytes"
        )
    layout, count, properties = _vertices(content[:mark].decode("ascii", errors="replace"))
    dtype = np.dtype([(name, ORDERS[layout] + kind) for name, kind in properties.items()])
    if layout == "ascii":
        vertices, rest = _ascii_rows(content[start:], count, dtype)
    else:
        missing = start + count * dtype.itemsize - len(content)
        if missing > 0:
            raise ContentError(f"it is cut off: {missing} bytes of its {count} vertices are missing")
        vertices = np.frombuffer(content, dtype, count, start)
        rest = content[start + vertices.nbytes :]
    return PlyFile(content[:start], layout == "ascii", vertices, rest)


def _vertices(header: str) -> tuple[str, int, dict[str, str]]:
    """The layout of a file, how many vertices it has, and the types of their properties by name."""
    layout, elements, count, properties = "", [], "", {}
    for line in header.splitlines():
        match line.split():
            case ["format", layout, _]:
                pass
            case ["element", name, number]:
                elements.append(name)
                count = count or number
            case ["property", *kind, name] if len(elements) == 1:
                if name in properties:
                    raise ContentError(f"its vertices have property {shown(name)} twice")
                properties[name] = TYPES.get(" ".join(kind), "")
    if layout not in ORDERS:
        raise ContentError(f"its format is {shown(layout)}, allowed: {', '.join(ORDERS)}")
    if elements[:1] != ["vertex"] or not (count.isascii() and count.isdecimal() and len(count) < 12):
        found = " ".join([*elements[:1], count]) or "none"
        raise ContentError(f"its first element must be 'vertex' with a count, got {shown(found)}")
    if odd := [name for name, kind in properties.items() if not kind]:
        raise ContentError(f"property {shown(odd[0])} of its vertices must be one number")
    if wrong := [name for name in ("x", "y", "z") if properties.get(name, "")[:1] != "f"]:
        raise ContentError(f"its vertices must have a property {wrong[0]!r} of floating point")
    return layout, int(count), properties


def _ascii_rows(content: bytes, count: int, dtype: np.dtype) -> tuple[np.ndarray, bytes]:
    """Vertices (count,) of lines, and what comes after these."""
    *lines, rest = content.split(b"\n", count)
    if len(lines) < count:  # without a line end after the last
        lines, rest = [*lines, rest], b""
    try:
        vertices = np.loadtxt(lines, dtype, comments=None, ndmin=1) if count else np.empty(0, dtype)
    except ValueError:
        vertices = None
    if vertices is None or len(vertices) != count:
        raise ContentError(f"its vertices must be {count} lines of {len(dtype.names)} numbers")
    return vertices, rest


def _text(value: np.number) -> str:
    return np.format_float_positional(value, trim="-") if value.dtype.kind == "f" else str(value)
