"""Draper: joint positions in, a garment out. An outfit of one garment, for whoever has no more.

Dimensions: `d` scalar degrees of freedom, `n` garment vertices, `m` garment nodes. Radians, metres, root frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.outfit.outfit import Outfit
from physkin_core.rig.bone_rotations import BoneRotations
from physkin_core.runtime.binding import bind_points
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Precision
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.runtime.rest_look import RestLook

__all__ = ["Draper"]


class Draper:
    """Drapes one garment on one body, a pose at a time: an `Outfit` of one, which its `outfit` is.

    Args:
        model: the garment model.
        avatar: the body, bound to the model's rig.
        precision, fit: as for `Outfit`.
        points: (n, 3) [m], optional: other points of the same garment to drape instead of its mesh, in canonical space.
            They have no faces.
        point_normals: (n, 3) unit normals of these points.

    Attributes:
        model: the garment model.
        outfit: the outfit of this one garment.

    Raises:
        TypeError, ValueError: as `Outfit` does.
        ValueError: for points that do not lie on this garment.

    Examples:
        >>> model = physkin.load_garment_model("tshirt")
        >>> draper = physkin.Draper(model, physkin.load_avatar("me.glb", model.rig))
        >>> cloud = draper.drape({"lowerarm01.L_z": -1.0})
        >>> cloud.shape == (draper.vertex_count, 6)
        True
    """

    def __init__(
        self,
        model: GarmentModel,
        avatar: Avatar,
        *,
        precision: Precision | None = None,
        fit: float | None = None,
        points: np.ndarray | None = None,
        point_normals: np.ndarray | None = None,
    ) -> None:
        self.model = model
        self.outfit = Outfit([WornGarment(model, fit=fit)], avatar, precision=precision)
        self._bone_rotations: dict[str, BoneRotations] = {}
        if points is not None:
            bound = self.layer.bound
            placed = bind_points(model, points, normals=point_normals, rest=bound.vertices)
            self.outfit = self.outfit.with_bound_garment(0, replace(bound, **placed))

    @property
    def layer(self) -> Layer:
        """The garment as it is worn here."""
        return self.outfit.layers[0]

    @property
    def avatar(self) -> Avatar:
        """The body, with its warnings."""
        return self.outfit.avatar

    @property
    def fit(self) -> float:
        """From 0 for one size to 1 for made to measure."""
        return self.layer.fit

    @property
    def bound(self) -> BoundGarment:
        """The garment bound to the body: all that a frame needs."""
        return self.layer.bound_visible

    @property
    def at_rest(self) -> RestLook:
        """How the garment sat on the body at rest when it was bound."""
        return self.layer.at_rest

    @property
    def joint_names(self) -> tuple[str, ...]:
        """See `Outfit.joint_names`."""
        return self.outfit.joint_names

    @property
    def instruction_set(self) -> str:
        """See `Outfit.instruction_set`."""
        return self.outfit.instruction_set

    @property
    def vertex_count(self) -> int:
        """Number of points n that `drape` writes."""
        return self.layer.vertex_count

    @property
    def faces(self) -> np.ndarray:
        """(f, 3) int32 triangles between the points that `drape` writes; (0, 3) when `points` were given."""
        return self.layer.faces

    @property
    def rest_garment(self) -> Garment:
        """See `Layer.rest_garment`."""
        return self.layer.rest_garment

    def drape(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
        time: float | None = None,
        root: np.ndarray | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Drape the garment in one pose.

        Args:
            joint_positions, gravity, effective_gravity, time, root: as for `Outfit.drape`.
            out: (n, 6) or (n, 3) writable float32 array with any row stride. None: a new (n, 6).

        Returns:
            `out`: x, y, z [m], then the unit normal of each vertex, in the root frame.
        """
        outs = None if out is None else [out]
        return self.outfit.drape(
            joint_positions, gravity, effective_gravity=effective_gravity, time=time, root=root, outs=outs
        )[0]

    def drape_rotations(
        self,
        rotations: np.ndarray | Mapping[str, Sequence[float]],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        skeleton: Literal["rig", "vrm"] = "rig",
        effective_gravity: np.ndarray | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Drape the garment in a pose that is given as rotations of bones.

        Args:
            rotations, skeleton: as for `BoneRotations`; unit quaternions x, y, z, w by bone, other bones being at rest.
            gravity, effective_gravity, out: as for `drape`.

        Returns:
            As `drape` does.

        Examples:
            >>> model = physkin.load_garment_model("tshirt")
            >>> draper = physkin.Draper(model, physkin.load_avatar("me.glb", model.rig))
            >>> cloud = draper.drape_rotations({"upperarm01.L": (0.0, 0.0, 0.259, 0.966)})
        """
        if skeleton not in self._bone_rotations:
            self._bone_rotations[skeleton] = BoneRotations(self.model.rig, skeleton=skeleton)
        positions = self._bone_rotations[skeleton].joint_positions(rotations)
        return self.drape(positions, gravity, effective_gravity=effective_gravity, out=out)

    @property
    def sway(self) -> float:
        """See `Outfit.sway`."""
        return self.outfit.frame_input.sway[0]

    @sway.setter
    def sway(self, amount: float) -> None:
        self.outfit.sway = amount

    @property
    def wind(self) -> tuple[float, float, float]:
        """See `Outfit.wind`."""
        return self.outfit.wind

    @wind.setter
    def wind(self, velocity: Sequence[float]) -> None:
        self.outfit.wind = velocity

    def reset(self) -> None:
        """See `Outfit.reset`."""
        self.outfit.reset()

    def bind_frame(self, joint_positions: np.ndarray, inputs: np.ndarray, out: np.ndarray) -> Callable[[], None]:
        """See `Outfit.bind_frame`."""
        return self.outfit.bind_frame(joint_positions, inputs, [out])

    def save_bound(self, path: str | Path) -> None:
        """See `Outfit.save_bound`."""
        self.outfit.save_bound(path)

    def node_transforms(self) -> np.ndarray:
        """(m, 3, 4): see `Outfit.node_transforms`."""
        return self.outfit.node_transforms()[0]

    def detail_offsets(self) -> np.ndarray:
        """(D, 3): see `Outfit.detail_offsets`."""
        return self.outfit.detail_offsets()[0]

    def bone_transforms(self, joint_positions: np.ndarray) -> np.ndarray:
        """See `Outfit.bone_transforms`."""
        return self.outfit.bone_transforms(joint_positions)
