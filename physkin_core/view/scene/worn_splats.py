"""Gaussian splats of one garment of an outfit, which are drawn in its place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.outfit.outfit import Outfit
from physkin_core.points.point_files import PointFile, splat_colours
from physkin_core.points.splat_draper import SplatSkinner
from physkin_core.points.splats import Splats
from physkin_core.quality import closest_points

__all__ = ["SplatFrame", "WornSplats"]


@dataclass(frozen=True)
class SplatFrame:
    """splats: in the root frame, of garment number `garment`. colours: (n, 3) sRGB in [0, 1], None for the
    garment's. opacity: (n,) in [0, 1]."""

    splats: Splats
    garment: int
    colours: np.ndarray | None
    opacity: np.ndarray


class WornSplats:
    """The splats of a file on the garment that they lie on; order of layers and tucks do not move them.

    Raises ValueError for splats farther than 5 cm from every garment of the outfit.
    """

    def __init__(self, path: Path, file: PointFile, outfit: Outfit) -> None:
        some = file.points[:: -(-len(file.points) // 1000)]
        meshes = [layer.model.garment for layer in outfit.layers]
        apart = [closest_points(some, mesh.vertices, mesh.faces)[0].mean() for mesh in meshes]
        self._garment = int(np.argmin(apart))
        try:
            self._skinner = SplatSkinner(outfit.layers[self._garment], file.splats)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        self._look = splat_colours(file.look, len(file.points))

    def frame(self, node_transforms: tuple[np.ndarray, ...]) -> SplatFrame:
        """Where they are; as of `Outfit.node_transforms`."""
        return SplatFrame(self._skinner.skin(node_transforms[self._garment]), self._garment, *self._look)
