"""A garment of an outfit, told as a `Draper` tells of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from physkin_core import Avatar, GarmentModel, Outfit
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["OutfitLayer"]


@dataclass(frozen=True)
class OutfitLayer:
    """Garment `index` of `outfit`, from the skin outwards. Points are those of the vertices that are given."""

    outfit: Outfit
    index: int

    @property
    def model(self) -> GarmentModel:
        return self.outfit.models[self.index]

    @property
    def avatar(self) -> Avatar:
        """With the warnings of the whole outfit."""
        return self.outfit.avatar

    @property
    def bound(self) -> BoundGarment:
        """Of the vertices that are given alone."""
        return self.outfit.bounds[self.index]

    @property
    def faces(self) -> np.ndarray:
        """(f, 3) int32 triangles between the points of a cloud."""
        return self.outfit.faces[self.index]

    @property
    def vertex_count(self) -> int:
        """Points of a cloud."""
        return self.outfit.vertex_counts[self.index]

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.outfit.joint_names

    @property
    def fit(self) -> float:
        return self.outfit.fits[self.index]

    @property
    def backend(self) -> str:
        return self.outfit.backend

    @property
    def instruction_set(self) -> str:
        return self.outfit.instruction_set

    @property
    def precision(self) -> str:
        return self.outfit.precision

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of the last frame."""
        return self.outfit.node_transforms()[self.index]

    def mesh_fields(self) -> Mapping[str, object]:
        """What a `physkin_msgs/GarmentMesh` says of a garment of an outfit."""
        outfit, k = self.outfit, self.index
        return {
            "layer": k,
            "layers": len(outfit.models),
            "moved": outfit.moved[k],
            "model_vertex_count": len(outfit.hidden[k]),
            "visible": outfit.visible[k],
            "body_covered": outfit.body_mask if k == 0 else (),
        }
