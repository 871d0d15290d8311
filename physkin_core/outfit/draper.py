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
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.runtime.rest_look import RestLook
from physkin_core.sway.frame_input import UPRIGHT_GRAVITY

__all__ = ["Draper"]


class Draper:
    """Drapes one garment on one body, a pose at a time.

    If the garment does not fit the body, an AvatarWarning says so; `avatar.warnings` keeps it.

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
        TypeError: for anything but a model and an avatar.
        ValueError: for an unknown precision, a body of another rig, a fit that is not possible, or
            points that do not lie on this garment.

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
        if not isinstance(model, GarmentModel) or not isinstance(avatar, Avatar):
            given = f"{type(model).__name__}, {type(avatar).__name__}"
            raise TypeError(f"Draper takes a garment model, then an avatar: Draper(model, avatar), got Draper({given})")
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
        """(d,) names of the joint positions, in the order `drape` takes them."""
        return self.outfit.joint_names

    @property
    def instruction_set(self) -> str:
        """Instruction set that the native code uses, such as "v3" (x86-64-v3, with AVX2)."""
        return self.outfit.instruction_set

    @property
    def precision(self) -> Precision:
        """Precision of the network weights that the evaluator uses."""
        return self.outfit.precision

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
        """The model's mesh in the rest shape that is worn here, which depends on the fit. Strains are measured against
        it."""
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

        Raises:
            ValueError: as `Outfit.drape` does.

        Examples:
            >>> model = physkin.load_garment_model("tshirt")
            >>> cloud = physkin.Draper(model, physkin.load_avatar("me.glb", model.rig)).drape({"lowerarm01.L_z": -1.0})
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
            `out`, as for `drape`.

        Raises:
            ValueError: as `drape` and `BoneRotations.joint_positions` do.

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
        """How much the cloth swings when `drape` is given time and root: see `Outfit.sway`."""
        return self.outfit.frame_input.sway[0]

    @sway.setter
    def sway(self, amount: float) -> None:
        self.outfit.sway = amount

    @property
    def wind(self) -> tuple[float, float, float]:
        """Velocity [m/s] of the air in the world: see `Outfit.wind`."""
        return self.outfit.wind

    @wind.setter
    def wind(self, velocity: Sequence[float]) -> None:
        self.outfit.wind = velocity

    def reset(self) -> None:
        """Start again in the next frame from cloth that hangs still, as in the first frame."""
        self.outfit.reset()

    def bind_frame(self, joint_positions: np.ndarray, inputs: np.ndarray, out: np.ndarray) -> Callable[[], None]:
        """A function that drapes what given arrays hold when it is called: see `Outfit.bind_frame`."""
        return self.outfit.bind_frame(joint_positions, inputs, [out])

    def save_bound(self, path: str | Path) -> None:
        """Write what is bound here to a file for hosts without Python: see `Outfit.save_bound`."""
        self.outfit.save_bound(path)

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of the last frame, from the canonical frame of the garment node to the root
        frame."""
        return self.outfit.node_transforms()[0]

    def features(self) -> np.ndarray:
        """What moves the detail nodes in the last frame: (F,), empty for a garment without any."""
        return self.outfit.features()[0]

    def bone_transforms(self, joint_positions: np.ndarray) -> np.ndarray:
        """(b, 3, 4) canonical-to-posed transforms of the bones of this body: see `Outfit.bone_transforms`."""
        return self.outfit.bone_transforms(joint_positions)
