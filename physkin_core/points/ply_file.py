"""PLY files whose vertices are to be moved: everything else in them stays as it is, byte for byte.

Dimensions: `n` vertices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["PlyFile", "read_ply"]

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
    """Read a PLY file whose vertices come first and have x, y, z. Raises ValueError saying what it is instead."""
    content = path.read_bytes()
    mark = content.find(b"end_header", 0, LONGEST_HEADER)
    start = content.find(b"\n", mark) + 1
    if not content.startswith(b"ply") or mark < 0 or start == 0:
        raise ValueError(f"cannot read {path}: it is no PLY file, it has no header from 'ply' to 'end_header'")
    layout, count, properties = _layout(path, content[:mark].decode("ascii", errors="replace"))
    dtype = np.dtype([(name, ORDERS[layout] + kind) for name, kind in properties.items()])
    if layout == "ascii":
        vertices, end = _ascii_rows(path, content, start, count, dtype)
    else:
        end = start + count * dtype.itemsize
        if end > len(content):
            missing = end - len(content)
            raise ValueError(f"cannot read {path}: it is cut off, {missing} bytes of its {count} vertices are missing")
        vertices = np.frombuffer(content, dtype, count, start)
    return PlyFile(content[:start], layout == "ascii", vertices, content[end:])


def _layout(path: Path, header: str) -> tuple[str, int, dict[str, str]]:
    """What the header says: the layout, how many vertices, and the types of their properties by name."""
    layout, elements, properties = "", [], {}
    for line in header.splitlines():
        match line.split():
            case ["format", kind, _]:
                layout = kind
            case ["element", name, count]:
                elements.append((name, count))
            case ["property", kind, name] if len(elements) == 1:
                properties[name] = TYPES.get(kind, "")
            case ["property", *_, name] if len(elements) == 1:
                properties[name] = ""
    if layout not in ORDERS:
        raise ValueError(f"cannot read {path}: its format is {layout!r}, allowed: {', '.join(ORDERS)}")
    first, count = elements[0] if elements else ("none", "0")
    if first != "vertex" or not count.isdecimal():
        raise ValueError(f"cannot read {path}: its first element must be 'vertex' with a count, got {first!r} {count}")
    if odd := [name for name, kind in properties.items() if not kind]:
        raise ValueError(f"cannot read {path}: property {odd[0]!r} of its vertices must be one number")
    if wrong := [name for name in ("x", "y", "z") if properties.get(name, "")[:1] != "f"]:
        raise ValueError(f"cannot read {path}: its vertices must have a property {wrong[0]!r} of floating point")
    return layout, int(count), properties


def _ascii_rows(path: Path, content: bytes, start: int, count: int, dtype: np.dtype) -> tuple[np.ndarray, int]:
    """Vertices (count,) and where their lines end."""
    *lines, rest = content[start:].split(b"\n", count)
    if len(lines) < count:  # without a line end after the last
        lines, rest = [*lines, rest], b""
    try:
        words = np.array([line.split() for line in lines]).reshape(count, len(dtype.names))
        vertices = np.empty(count, dtype=dtype)
        for name, column in zip(dtype.names, words.T):
            vertices[name] = column.astype(dtype[name])
        return vertices, len(content) - len(rest)
    except ValueError as error:
        numbers = f"{count} lines of {len(dtype.names)} numbers"
        raise ValueError(f"cannot read {path}: its vertices must be {numbers}") from error


def _text(value: np.number) -> str:
    return np.format_float_positional(value, trim="-") if value.dtype.kind == "f" else str(value)
