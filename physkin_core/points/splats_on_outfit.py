"""Splats of a file on whichever garment of an outfit they lie on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.points.point_files import PointFile
from physkin_core.points.splat_draper import BoundSplats, bind_splats
from physkin_core.quality import closest_points
from physkin_core.runtime.layer import Layer

__all__ = ["SplatsOnOutfit", "splats_on_outfit"]


@dataclass(frozen=True)
class SplatsOnOutfit:
    """garment: which one of the outfit they are on. bound: to it. look: (n,) records of all else that is known of them,
    as of `PointFile`."""

    garment: int
    bound: BoundSplats
    look: np.ndarray | None


def splats_on_outfit(path: str | Path, file: PointFile, layers: Sequence[Layer]) -> SplatsOnOutfit:
    """Bind the splats of a file to the closest garment, in canonical space; order of layers and tucks do not move them.

    Raises ValueError for splats farther than 5 cm from every garment.
    """
    some = file.points[:: -(-len(file.points) // 1000)]
    meshes = [layer.model.garment for layer in layers]
    apart = [closest_points(some, mesh.vertices, mesh.faces)[0].mean() for mesh in meshes]
    garment = int(np.argmin(apart))
    try:
        return SplatsOnOutfit(garment, bind_splats(layers[garment], file.splats), file.look)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
