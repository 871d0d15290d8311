"""Outfit: one to four garments on one body, worn over each other. Joint positions in, a cloud for each garment out.

Dimensions: `d` degrees of freedom, `n` vertices of a garment, `v` of them given, `f` faces. Radians, metres, root
frame.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.outfit.bound_outfit import BoundOutfit, bind_outfit, hidden_body
from physkin_core.outfit.coverage import OwnClothes, covers_of, faces_of, slimmed
from physkin_core.rig.rig import Rig
from physkin_core.rig.vrm_bones import vrm_bone_table
from physkin_core.runtime.bound_file import save_bound_outfit
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Evaluator, Precision
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY, FrameInput
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.runtime.other_fabrics import fabric_of, other_fabrics

__all__ = ["Outfit"]

log = logging.getLogger(__name__)

FULL_TURN = 2 * np.pi


class Outfit:
    """Drapes one to four garments on one body, a pose at a time.

    An AvatarWarning says if garments look odd together, or do not sit well. A joint more than a full turn beyond its
    limits is probably given in degrees: the first one is logged as a warning.

    Args:
        garments: from the skin outwards; `WornGarment(model, tucked=True)` for one whose hem is worn under the
            waistband of the next. Each is fitted over what lies beneath it: the same shirt is wider over trousers.
        avatar: the body, bound to the rig of the garments.
        precision: of the network weights: "fp32", "bf16" or "int8". None: int8.
        fit: 1 for made to measure, 0 for one size, or a number between. It holds for garments that have no fit of
            their own (`WornGarment.fit`). Above 0 it needs garments that were trained on the default rig
            (`load_body_model().rig`). None: 1 with that rig, 0 with others. Above 0, binding takes some tenths of a
            second longer; frames take the same time.
        hide_covered: leave out of the clouds what outer garments cover in everyday poses; `Layer.visible` lists the
            vertices that remain. False: clouds have all vertices.
        own_clothes: what pictures show of clothes that the avatar wears already. "replace": all but those that the
            garments replace; "hide": none; "keep": all that is not under a garment. This does not change the drape.

    Attributes:
        layers: the garments as they are worn here, from the skin outwards.
        orders: what keeps neighbouring layers in order.
        avatar: the body.
        warnings: of the avatar, and of how garments sit.

    Raises:
        TypeError: for anything but garments and an avatar.
        ValueError: for what cannot be worn (a garment twice, more than four, several rigs, a body of another rig, an
            impossible tuck or order), a fit that is not possible, an unknown precision.

    Examples:
        >>> trousers, tshirt = map(physkin.load_garment_model, ("trousers", "tshirt"))
        >>> outfit = physkin.Outfit([trousers, tshirt], physkin.load_avatar("me.glb", tshirt.rig))
        >>> [cloud.shape[1] for cloud in outfit.drape({})]
        [6, 6]
    """

    def __init__(
        self,
        garments: Sequence[GarmentModel | WornGarment],
        avatar: Avatar,
        *,
        precision: Precision | None = None,
        fit: float | None = None,
        hide_covered: bool = True,
        own_clothes: OwnClothes = "replace",
    ) -> None:
        worn = _checked_garments(garments, avatar)
        bound = bind_outfit(worn, avatar, fit=fit, hide_covered=hide_covered, own_clothes=own_clothes)
        self._wear(bound, precision)
        for warning in bound.worth_saying:
            warnings.warn(warning, AvatarWarning, stacklevel=2)

    @classmethod
    def from_bound(
        cls,
        bound: BoundOutfit,
        *,
        precision: Precision | None = None,
    ) -> Outfit:
        """An outfit that has been bound already, perhaps by another process. It issues no warnings again.

        Raises:
            ValueError: for an unknown precision, or arrays that do not fit together.
        """
        outfit = cls.__new__(cls)
        outfit._wear(bound, precision)
        return outfit

    def _wear(self, bound: BoundOutfit, precision: Precision | None) -> None:
        self._bound = bound  # what is bound again while it is in use is this
        self.avatar, self.warnings, self.orders = bound.avatar, bound.avatar.warnings, bound.orders
        self._body_hidden = bound.body_hidden
        self._asked = precision
        self._begin(bound.layers)

    def _begin(self, layers: Sequence[Layer]) -> None:
        """Make what a frame writes to."""
        self.layers = tuple(layers)
        self._evaluator = Evaluator([layer.bound_visible for layer in layers], self.orders, precision=self._asked)
        self.frame_input = FrameInput(len(layers))
        self._frames = self._evaluator.frames(self.frame_input, self.rig.rest, self.rig.joint_indices)
        self._warned_of_degrees = False

    def twin(self) -> Outfit:
        """The same outfit on the same body, for another performer. It keeps its own frames, and starts with the
        `sway` and `wind` of this one. Nothing is bound again.

        Examples:
            >>> tshirt = physkin.load_garment_model("tshirt")
            >>> outfit = physkin.Outfit([tshirt], physkin.load_avatar("me.glb", tshirt.rig))
            >>> second = outfit.twin()
        """
        twin, here = copy(self), self.frame_input
        twin._begin(self.layers)
        twin.frame_input.sway, twin.frame_input.wind = here.sway, here.wind
        return twin

    def with_bound_garment(self, garment: int, bound: BoundGarment) -> Outfit:
        """A twin in which the cloud of one garment holds other points, such as a finer mesh.

        Args:
            garment: index of the garment.
            bound: these points, bound to the same garment nodes.
        """
        twin, layers = copy(self), list(self.layers)
        layers[garment] = replace(layers[garment], bound_visible=bound, visible=np.empty(0, dtype=np.int32))
        twin._begin(layers)
        return twin

    def save_bound(self, path: str | Path) -> None:
        """Write what is bound here to a file for hosts without Python: C (`native/include/physkin.h`) and browsers. It
        holds all fabrics that each garment has learnt."""
        others = [other_fabrics(layer, self.avatar, self.layers[:k]) for k, layer in enumerate(self.layers)]
        save_bound_outfit(
            [replace(layer.bound_visible, **fields) for layer, (_, fields) in zip(self.layers, others)],
            path,
            fabrics=[[fabric_of(layer.model), *names] for layer, (names, _) in zip(self.layers, others)],
            names=[layer.name for layer in self.layers],
            joint_names=self.joint_names,
            orders=self.orders,
            texts=vrm_bone_table(self.rig),
        )

    @property
    def rig(self) -> Rig:
        """The rig that all garments share."""
        return self.layers[0].model.rig

    @property
    def garments(self) -> list[SkinnedGarment]:
        """The models that are worn, from the skin outwards."""
        return [layer.model for layer in self.layers]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(d,) names of the joint positions, in the order `drape` takes them."""
        return self.rig.joint_names

    @property
    def instruction_set(self) -> str:
        """Instruction set that the native code uses, such as "v3" (x86-64-v3, with AVX2)."""
        return self._evaluator.instruction_set

    @property
    def precision(self) -> Precision:
        """Precision of the network weights that the evaluator uses."""
        return self._evaluator.precision

    def drape(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
        time: float | None = None,
        root: np.ndarray | None = None,
        outs: Sequence[np.ndarray] | None = None,
    ) -> list[np.ndarray]:
        """Drape all garments in one pose.

        Args:
            joint_positions: (d,) [rad] in the order of `joint_names`; or positions by joint name, all others being at
                rest.
            gravity: (3,) direction of gravity in the root frame, of any length but zero, for a root that is not
                accelerated.
            effective_gravity: (3,) [m/s2] in the root frame: gravity minus the acceleration of the root. Zero in free
                fall, at most three times gravity. Used instead of `gravity`.
            time: [s] of this frame. Frames must then come in their order, and cloth that would leap between two of them
                moves over at a limited speed. Cloth also swings as the joints move, as much as `sway` says.
            root: (7,), with `time`: where the root is in the world, as for `FrameInput.set_root`. It also says where
                down is, and makes cloth lag, swing and settle as the root moves, too.
            outs: one writable float32 array for each garment, all (v, 6) or all (v, 3), with any row stride. None: new
                (v, 6).

        Returns:
            `outs`: x, y, z [m], then unit normals. Row k of a garment is its vertex `Layer.visible[k]`.

        Raises:
            ValueError: for wrong lengths, unknown joints and values that are not finite, naming the joint.
            TypeError: for an output of another dtype, or that cannot be written.

        Examples:
            >>> tshirt = physkin.load_garment_model("tshirt")
            >>> outfit = physkin.Outfit([tshirt], physkin.load_avatar("me.glb", tshirt.rig))
            >>> (cloud,) = outfit.drape({"lowerarm01.L_z": -1.0})
        """
        look_at = self.checked_positions
        return self._frames.drape(joint_positions, look_at, gravity, effective_gravity, time, root, outs)

    def checked_positions(self, joint_positions: np.ndarray | Mapping[str, float]) -> np.ndarray:
        """Joint positions, checked and in the rig's order. Warns once if values look like degrees.

        Args:
            joint_positions: as for `drape`.

        Returns:
            (d,) float32 [rad].

        Raises:
            ValueError: as `drape` does.
        """
        rig = self.rig
        if isinstance(joint_positions, Mapping):
            joint_positions = rig.joint_positions(joint_positions)
        positions = np.ascontiguousarray(joint_positions, dtype=np.float32)
        if positions.shape != rig.rest.shape:
            raise ValueError(f"joint positions have shape {positions.shape}, expected {rig.rest.shape}")
        if positions.dot(positions) <= FULL_TURN**2:  # the cheapest question that all usual poses pass, and no NaN
            return positions
        if not np.isfinite(positions).all():
            joint = int(np.flatnonzero(~np.isfinite(positions))[0])
            raise ValueError(f"joint {rig.joint_names[joint]!r} is {positions[joint]}; positions must be finite [rad]")
        beyond = np.maximum(rig.lower - positions, positions - rig.upper)
        if not self._warned_of_degrees and beyond.max() > FULL_TURN:
            self._warned_of_degrees = True
            joint = int(beyond.argmax())
            log.warning(
                "joint %r is %g, a full turn beyond its limits of %.2f to %.2f rad: degrees? Positions are in radians",
                *(rig.joint_names[joint], positions[joint], rig.lower[joint], rig.upper[joint]),
            )
        return positions

    def bind_frame(
        self, joint_positions: np.ndarray, inputs: np.ndarray, outs: Sequence[np.ndarray]
    ) -> Callable[[], None]:
        """A function that drapes what given arrays hold when it is called, for loops in which every microsecond counts.

        Args:
            joint_positions: (d,) float32 [rad].
            inputs: `rows` of a `FrameInput`.
            outs: as for `drape`.

        Returns:
            The function. It takes no arguments and writes into `outs`.
        """
        return self._evaluator.bind_frame(joint_positions, inputs, outs).step

    @property
    def sway(self) -> float | tuple[float, ...]:
        """How much the garments swing when `drape` is given time and root, from 0 to 1: one number for all, or one for
        each garment from the skin outwards. 1 is the default. At 0 every frame is draped by itself, whatever its time.

        Raises:
            ValueError: if a value is not from 0 to 1, or if there are not as many values as garments.
        """
        sways = self.frame_input.sway
        return sways if len(set(sways)) > 1 else sways[0]

    @sway.setter
    def sway(self, amount: float | Sequence[float]) -> None:
        many = isinstance(amount, Sequence) or np.ndim(amount) > 0
        given: Any = amount
        self.frame_input.sway = tuple(given) if many else (given,) * len(self.layers)

    @property
    def wind(self) -> tuple[float, float, float]:
        """Velocity [m/s] of the air in the world; (0, 0, 0), the default, is still air. May change at any time.

        Raises:
            ValueError: when set to anything but three finite numbers, at most 13 m/s long.
        """
        return self.frame_input.wind

    @wind.setter
    def wind(self, velocity: Sequence[float]) -> None:
        self.frame_input.wind = velocity

    def reset(self) -> None:
        """Start again in the next frame from cloth that hangs still, as in the first frame."""
        self.frame_input.reset()
        self._evaluator.forget()

    def node_transforms(self) -> tuple[np.ndarray, ...]:
        """Garment node transforms (m, 3, 4) of each garment in the last frame, from the canonical frame of the garment
        node to the root frame. Skinned by `Layer.bound_visible` they give the vertices before layers and tucked hems
        are put in order.
        """
        return tuple(self._evaluator.node_transforms(k) for k in range(len(self.layers)))

    def detail_offsets(self) -> tuple[np.ndarray, ...]:
        """How far the detail nodes of each garment are from their places at rest in the last frame: (D, 3) [m], (0, 3)
        for a garment without any. Skinning takes them together with `node_transforms`.
        """
        return tuple(self._evaluator.detail_offsets(k) for k in range(len(self.layers)))

    def bone_transforms(self, joint_positions: np.ndarray) -> np.ndarray:
        """Transforms of the bones of this body, for posing the body with the garments.

        Args:
            joint_positions: (d,) [rad] in the order of `joint_names`.

        Returns:
            (b, 3, 4), canonical to posed, in the root frame.
        """
        return self.rig.bone_transforms(joint_positions, heads=self.avatar.bone_heads)

    @cached_property
    def body_mask(self) -> np.ndarray:
        """(f,) bool, the body's faces that are covered in all everyday poses."""
        hidden = self._body_hidden
        return faces_of(self.avatar.faces, hidden_body(self.layers, self.avatar) if hidden is None else hidden)

    @cached_property
    def body_to_draw(self) -> Avatar:
        """The avatar, its accessories and what it still wears, skin under cloth up to 6 mm slimmer, so that none shows
        through where cloth lies a little too deep."""
        covers = covers_of(self.layers, [layer.rest for layer in self.layers])
        return slimmed(self.avatar, covers).with_accessories()

    @cached_property
    def faces_to_draw(self) -> np.ndarray:
        """Mask over the faces of `body_to_draw`: all but those of `body_mask`."""
        accessories = len(self.body_to_draw.faces) - len(self.body_mask)
        return np.concatenate([~self.body_mask, np.ones(accessories, dtype=bool)])

    def posed_body(self, joint_positions: np.ndarray) -> np.ndarray:
        """`body_to_draw` in a pose, for drawing it with the garments.

        Args:
            joint_positions: (d,) [rad] in the order of `joint_names`.

        Returns:
            (V, 3) [m] in the root frame.
        """
        return self.body_to_draw.posed_vertices(self.bone_transforms(joint_positions))


def _checked_garments(garments: Sequence[GarmentModel | WornGarment], avatar: Avatar) -> tuple[WornGarment, ...]:
    if isinstance(garments, GarmentModel | WornGarment):
        raise TypeError(f"Outfit takes a list of garments, got one {type(garments).__name__}: put it into a list")
    if not isinstance(avatar, Avatar):
        raise TypeError(
            f"garments are put on an Avatar, got {type(avatar).__name__}: garments come first, then the avatar"
        )
    for garment in garments:
        model = garment.model if isinstance(garment, WornGarment) else garment
        if not isinstance(model, GarmentModel):
            raise TypeError(f"a garment of an outfit is a GarmentModel or a WornGarment, got {type(model).__name__}")
    return tuple(each if isinstance(each, WornGarment) else WornGarment(each) for each in garments)
