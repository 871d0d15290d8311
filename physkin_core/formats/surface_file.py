"""PLY, STL and OFF files: a surface and nothing else. trimesh reads them, after what it would trust is checked.

Dimensions: `n` vertices, `f` faces.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, read_bytes
from physkin_core.formats.mesh_limits import check_mesh_size
from physkin_core.formats.ply_file import read_ply_header

__all__ = ["LARGEST_TEXT", "check_text_size", "read_surface"]

LARGEST_TEXT = 1 << 27  # [bytes] of a mesh as text, which takes many times its size while it is read
MOST_LINES = 8_000_000
LINE_ENDS = b"\n\r\v\f\x1c\x1d\x1e\x85"
"""Where Python splits lines, and bytes of longer marks."""
STL_HEADER, STL_FACE = 84, 50  # [bytes]


def read_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3), in the order of the file, and faces (f, 3). Raises ContentError where it is too large, names
    more than it holds, or is malformed."""
    import trimesh

    content, suffix = read_bytes(path), path.suffix.lower().removeprefix(".")
    if suffix == "ply":
        header = read_ply_header(content)
        check_mesh_size(vertices=header.count("vertex"), faces=header.count("face"))
        is_text = header.layout == "ascii"
    else:
        is_text = suffix != "stl" or not _is_binary_stl(content)
    if is_text:
        check_text_size(content)
        check_mesh_size(parts=content.count(b"endsolid"))
    try:
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=suffix, process=False)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(getattr(mesh, "faces", ()))
    except Exception as error:  # whatever the parser trips over, the file is malformed
        raise ContentError(f"it is malformed: {type(error).__name__}: {error}") from error
    check_mesh_size(faces=len(faces))
    return vertices, faces


def check_text_size(content: bytes) -> None:
    """Raises ContentError where a mesh as text has too many bytes or lines."""
    if len(content) > LARGEST_TEXT:
        raise ContentError(f"it has {len(content)} bytes of text, allowed are {LARGEST_TEXT}; save it as binary")
    lines = sum(content.count(end) for end in LINE_ENDS)
    if lines > MOST_LINES:
        raise ContentError(f"it has {lines} lines, allowed are {MOST_LINES}; simplify the mesh")


def _is_binary_stl(content: bytes) -> bool:
    """By its length, which its count of faces tells. Raises ContentError for too many of them."""
    faces, rest = divmod(len(content) - STL_HEADER, STL_FACE)
    if rest or faces < 0 or int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little") != faces:
        return False
    check_mesh_size(faces=faces)
    return True
