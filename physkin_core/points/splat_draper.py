"""Gaussian splats of a garment, draped: centre, rotation and scales follow the garment nodes.

The deformation of the cloth at a splat is read off three short steps along the splat's own axes, whose ends are bound
and skinned as its centre is. That has all of the deformation in it, also what comes of influences changing from place
to place and of the rest shape that is worn; the blended transform of a splat's influences alone would miss both.
Dimensions: `n` splats, `d` scalar degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.skinning import SkinningData
from physkin_core.outfit.draper import Draper
from physkin_core.points.splats import Splats, moved_splats
from physkin_core.runtime.binding import FARTHEST_POINT, bind_points
from physkin_core.runtime.evaluator import NO_DETAIL, Skinner
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.layer import Layer

__all__ = ["BoundSplats", "SplatDraper", "SplatSkinner", "bind_splats"]

STEP = 0.003
"""[m] along an axis: short against folds, long against the precision of a position."""


@dataclass(frozen=True)
class BoundSplats:
    """Splats on one garment as it is worn. skinning: of their centres, and then of the ends of three steps from each
    along its axes: (4 n) points. scales: (n, 3) as of `Splats`."""

    skinning: SkinningData
    scales: np.ndarray


def bind_splats(layer: Layer, splats: Splats) -> BoundSplats:
    """Skin splats of a garment, in canonical space, to its garment nodes. Raises ValueError for splats farther than
    5 cm from the garment."""
    bind_points(layer.model, splats.centres)  # so that what is refused is named by its splat
    ends = splats.centres + STEP * splats.axes().transpose(2, 0, 1)
    points = np.concatenate([splats.centres[None], ends]).reshape(-1, 3)
    placed = bind_points(layer.model, points, rest=layer.bound.vertices, farthest=FARTHEST_POINT + STEP)
    del placed["faces"]
    bound = layer.bound
    return BoundSplats(
        SkinningData(node_rest=bound.node_rest, detail_node_count=bound.detail_node_count, **placed), splats.scales
    )


class SplatSkinner:
    """Splats of a garment where its garment nodes take them. Raises ValueError as `Skinner` does."""

    def __init__(self, bound: BoundSplats) -> None:
        self._skinner = Skinner(bound.skinning)
        self._scales = bound.scales

    @property
    def splat_count(self) -> int:
        """Number of splats n."""
        return len(self._scales)

    def skin(self, node_transforms: np.ndarray, detail_offsets: np.ndarray = NO_DETAIL) -> Splats:
        """The splats in the root frame. node_transforms: (m, 3, 4) float32 as of `Outfit.node_transforms`,
        detail_offsets (D, 3) as of `Outfit.detail_offsets`. Raises TypeError or ValueError as `Skinner.skin` does."""
        cloud = np.empty((self._skinner.vertex_count, 6), dtype=np.float32)
        self._skinner.skin(node_transforms, cloud, detail_offsets)
        centres, *ends = cloud[:, :3].reshape(4, -1, 3)
        return moved_splats(centres, (np.stack(ends) - centres) / np.float32(STEP), self._scales)


class SplatDraper:
    """Drapes Gaussian splats of one garment on one body, a pose at a time.

    Args:
        model: the garment model.
        avatar: the body, bound to the model's rig.
        splats: of the garment, in canonical space.
        fit: as for `Draper`.

    Attributes:
        avatar: the body, with its warnings.

    Raises:
        ValueError: as `Draper` does, and for splats farther than 5 cm from the garment.

    Examples:
        >>> model = physkin.load_garment_model("tshirt")
        >>> splats = physkin.Splats(model.garment.vertices[:9], 9 * [[0, 0, 0, 1]], 9 * [[0.004, 0.004, 0.0004]])
        >>> draper = physkin.SplatDraper(model, physkin.load_avatar("me.glb", model.rig), splats)
        >>> draper.drape({"lowerarm01.L_z": -1.0}).centres.shape
        (9, 3)
    """

    def __init__(self, model: GarmentModel, avatar: Avatar, splats: Splats, *, fit: float | None = None) -> None:
        self._draper = Draper(model, avatar, fit=fit)
        self.avatar = self._draper.avatar
        self._skinner = SplatSkinner(bind_splats(self._draper.layer, splats))

    @property
    def splat_count(self) -> int:
        """Number of splats n."""
        return self._skinner.splat_count

    def drape(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
    ) -> Splats:
        """Drape the splats in one pose.

        Args:
            joint_positions, gravity, effective_gravity: as for `Draper.drape`.

        Returns:
            The splats in the root frame.

        Raises:
            ValueError: as `Draper.drape` does.
        """
        self._draper.drape(joint_positions, gravity, effective_gravity=effective_gravity)
        return self._skinner.skin(self._draper.node_transforms(), self._draper.detail_offsets())
