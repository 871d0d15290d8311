"""Gaussian splats of a garment, draped: centre, rotation and scales follow the garment nodes.

The deformation of the cloth at a splat is read off three short steps along the splat's own axes, whose ends are bound
and skinned as its centre is. That has all of the deformation in it, also what comes of influences changing from place
to place and of the rest shape that is worn; the blended transform of a splat's influences alone would miss both.
Dimensions: `n` splats, `d` scalar degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment_model import GarmentModel
from physkin_core.points.splats import Splats, moved_splats
from physkin_core.runtime.binding import FARTHEST_POINT, bind_points
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.draper import UPRIGHT_GRAVITY, Draper
from physkin_core.runtime.native_skinner import NativeSkinner

__all__ = ["SplatDraper"]

STEP = 0.003
"""[m] along an axis: short against folds, long against the precision of a position."""


class SplatDraper:
    """Drapes splats of one garment on one body, a pose at a time.

    splats: of the garment, in canonical space. fit, binding: as for `Draper`.
    Raises ValueError as `Draper` does, and for splats farther than 5 cm from the garment.
    """

    def __init__(
        self,
        model: GarmentModel,
        avatar: Avatar,
        splats: Splats,
        *,
        fit: float | None = None,
        binding: BoundGarment | None = None,
    ) -> None:
        bound = Draper(model, avatar, fit=fit).bound if binding is None else binding
        bind_points(model, splats.centres)  # so that what is refused is named by its splat
        ends = splats.centres + STEP * splats.axes().transpose(2, 0, 1)
        points = np.concatenate([splats.centres[None], ends]).reshape(-1, 3)
        placed = bind_points(model, points, rest=bound.vertices, farthest=FARTHEST_POINT + STEP)
        self._draper = Draper(model, avatar, fit=fit, binding=replace(bound, **placed))
        self._scales = splats.scales

    @property
    def splat_count(self) -> int:
        """Number of splats n."""
        return len(self._scales)

    def drape(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
    ) -> Splats:
        """The splats in one pose, given as to `Draper.drape`, in the root frame. Raises ValueError as that does."""
        return self._splats(self._draper.drape(joint_positions, gravity, effective_gravity=effective_gravity))

    def skin(self, node_transforms: np.ndarray) -> Splats:
        """The splats where garment nodes take them that somebody else computed, as of `Draper.node_transforms`: (m, 3,
        4) float32. Raises TypeError or ValueError as `NativeSkinner.skin` does."""
        cloud = np.empty((self._draper.vertex_count, 6), dtype=np.float32)
        self._skinner.skin(node_transforms, cloud)
        return self._splats(cloud)

    @cached_property
    def _skinner(self) -> NativeSkinner:
        bound = self._draper.bound
        fields = bound.vertices, bound.normals, bound.node_rest, bound.influence_nodes, bound.influence_weights
        return NativeSkinner(*fields)

    def _splats(self, cloud: np.ndarray) -> Splats:
        """Of the draped centres and ends of axes (4 n, 6)."""
        centres, *ends = cloud[:, :3].reshape(4, -1, 3)
        return moved_splats(centres, (np.stack(ends) - centres) / np.float32(STEP), self._scales)
