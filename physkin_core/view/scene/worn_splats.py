"""Gaussian splats of one garment of an outfit, which are drawn in its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.points.point_files import splat_colours
from physkin_core.points.splat_draper import SplatSkinner
from physkin_core.points.splats import Splats
from physkin_core.points.splats_on_outfit import SplatsOnOutfit

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
    """Splats, skinned to the garment of an outfit that they are on."""

    def __init__(self, splats: SplatsOnOutfit) -> None:
        self._garment, self._skinner = splats.garment, SplatSkinner(splats.bound)
        self._look = splat_colours(splats.look, self._skinner.splat_count)

    def frame(self, node_transforms: tuple[np.ndarray, ...], features: tuple[np.ndarray, ...]) -> SplatFrame:
        """Where they are; as of `Outfit.node_transforms` and `Outfit.features`."""
        splats = self._skinner.skin(node_transforms[self._garment], features[self._garment])
        return SplatFrame(splats, self._garment, *self._look)
