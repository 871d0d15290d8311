"""How large a mesh may be, of any format: far beyond what avatars and garments need, and what memory and time allow."""

from __future__ import annotations

from physkin_core.file_reading import ContentError

__all__ = ["LARGEST_CONTENT", "MOST_FACES", "MOST_PARTS", "MOST_VERTICES", "check_mesh_size"]

LARGEST_CONTENT = 1 << 29
"""[bytes] What a file of meshes takes with all that it expands to."""
MOST_VERTICES, MOST_FACES = 1_000_000, 2_000_000
MOST_PARTS = 10_000
"""Objects, groups, materials or primitives."""


def check_mesh_size(*, vertices: int = 0, faces: int = 0, parts: int = 0) -> None:
    """Raises ContentError naming what there is too much of."""
    for count, most, what in ((vertices, MOST_VERTICES, "vertices"), (faces, MOST_FACES, "faces")):
        if count > most:
            raise ContentError(f"it has {count} {what} or more, allowed are {most}; simplify the mesh")
    if parts > MOST_PARTS:
        raise ContentError(f"it has {parts} parts or more, allowed are {MOST_PARTS}; join objects of one material")
