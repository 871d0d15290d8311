"""Gaussian splats as the files of 3D Gaussian splatting have them."""

import numpy as np

COUNT = 40
FIELDS = ("x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(3)),
          "opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4)))  # fmt: skip


def splat_table(points=None, *, count=COUNT):
    """(n, fields) float32: logarithms of scales, quaternions w, x, y, z; at points (n, 3) or anywhere."""
    rng = np.random.default_rng(0)
    count = count if points is None else len(points)
    table = rng.uniform(0.1, 0.9, size=(count, len(FIELDS))).astype(np.float32)
    table[:, 3:6] = 0
    table[:, FIELDS.index("scale_0") :][:, :3] = rng.uniform(-7, -5, size=(count, 3))
    turns = rng.normal(size=(count, 4))
    table[:, FIELDS.index("rot_0") :] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    if points is not None:
        table[:, :3] = points
    return table


def splat_ply(layout, points=None, *, count=COUNT, scale=None, tail=b""):
    """A file. scale: instead of every `scale_0`. tail: bytes after the vertices."""
    table = splat_table(points, count=count)
    if scale is not None:
        table[:, FIELDS.index("scale_0")] = scale
    header = ["ply", f"format {layout} 1.0", "comment made up", f"element vertex {len(table)}"]
    header += [*(f"property float {name}" for name in FIELDS), "end_header", ""]
    if layout == "ascii":
        rows = "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in table.tolist()).encode()
    else:
        rows = table.astype("<f4" if "little" in layout else ">f4").tobytes()
    return "\n".join(header).encode() + rows + tail
