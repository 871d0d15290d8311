"""PLY, STL and OFF files: a surface and nothing else, read by trimesh.

Dimensions: `n` vertices, `f` faces.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from physkin_core.file_reading import read_bytes

__all__ = ["read_surface"]


def read_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3), in the order of the file, and faces (f, 3). Raises whatever trimesh does for malformed files."""
    import trimesh

    kind = path.suffix.lower().removeprefix(".")
    mesh = trimesh.load_mesh(io.BytesIO(read_bytes(path)), file_type=kind, process=False)
    return np.asarray(mesh.vertices), np.asarray(getattr(mesh, "faces", ()))
