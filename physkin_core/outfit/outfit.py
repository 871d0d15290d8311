"""Outfit: several garments on one body, worn over each other. Joint positions in, a cloud for each garment out.

Dimensions: `d` degrees of freedom, `n` vertices of a garment, `v` of them given, `f` faces. Radians, metres, root
frame.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cache, cached_property, partial
from typing import Literal

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.garment_model import GarmentModel
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.outfit.coverage import Cover, covered, faces_of, slimmed
from physkin_core.outfit.layer_order import LayerOrder, bind_layer_order
from physkin_core.outfit.layers import Layer, OutfitGarment, drapes, put_on
from physkin_core.outfit.outfit_evaluators import NativeOutfitEvaluator, ReferenceOutfitEvaluator
from physkin_core.outfit.taking_in import taken_in
from physkin_core.outfit.tuck import DEEP, SLIDES
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.draper import BACKENDS, UPRIGHT_GRAVITY, Draper
from physkin_core.separation.limb_separator import LimbSeparator
from physkin_core.sway.pace import FrameClock
from physkin_core.sway.sway import Sway, checked_amount

__all__ = ["Outfit"]

log = logging.getLogger(__name__)


class Outfit:
    """Drapes up to four garments on one body, a pose at a time.

    garments: from the skin outwards; `OutfitGarment(model, tucked=True)` for one whose hem is worn under the waistband
        of the next. A garment knows what lies under it, so that the same shirt is wider over trousers.
    hide: leave out what cannot be seen in everyday poses; `visible` says which vertices are given. False: give all.
    backend, precision, fit, normals, separate_limbs: as of `Draper`; fit of garments without their own.
    hidden: (n,) bool of each garment, what is covered in all everyday poses; visible: (v,) int32, the vertices that are
    given; faces: (f, 3) int32 of these. body_mask: (F,) bool, the body's faces that are covered. at_rest: how each
    garment sits on the skin, a tucked one before it is tucked and taken in: that puts some of the hem into the skin
    below the waistband, where nobody sees it. fits: what each is worn in. bounds, orders: what a frame needs: bound
    garments of the vertices given, and what keeps layers in order.
    What can be worn but looks odd is issued as AvatarWarning, which `warnings` keeps.
    Raises TypeError for anything but garments and an avatar; ValueError, in one sentence, for what cannot be worn (a
    garment twice, more than four, several rigs, a tuck or an order that does not go) and for what `Draper` refuses.
    """

    def __init__(
        self,
        garments: Sequence[GarmentModel | OutfitGarment],
        avatar: Avatar,
        *,
        backend: Literal["native", "numpy"] = "native",
        precision: Literal["fp32", "bf16", "int8"] | None = None,
        fit: float | None = None,
        normals: Literal["skinned", "faces"] = "skinned",
        separate_limbs: bool = False,
        hide: bool = True,
    ) -> None:
        self.garments = _checked_garments(garments, avatar)
        if backend not in BACKENDS:
            raise ValueError(f"unknown backend {backend!r}; allowed: {', '.join(BACKENDS)}")
        if backend == "numpy" and precision not in (None, "fp32"):
            raise ValueError(f"the numpy backend computes with the model's own network weights, not in {precision!r}")
        layers, tucks, worth_saying = put_on(self.garments, avatar, fit=fit, backend=backend)
        self.at_rest = tuple(layer.at_rest for layer in layers)
        self.fits = tuple(layer.draper.fit for layer in layers)
        rig = layers[0].garment.model.rig
        poses, checked = _poses_to_look_at(rig)
        if not checked and len(layers) > 1:
            worth_saying.append("everyday poses are of the default rig: with this one nothing of an outfit is hidden")
        for inner, outer in tucks:
            layers[inner] = taken_in(layers[inner], layers[outer], poses)
        self._drapers = [layer.draper for layer in layers]
        cloth = drapes(layers, tucks, poses)
        self.hidden, body_hidden = _hidden(layers, cloth, poses, avatar)
        if not checked:
            self.hidden, body_hidden = tuple(np.zeros_like(mask) for mask in self.hidden), np.zeros_like(body_hidden)
        self.body_mask = faces_of(avatar.faces, body_hidden)
        self.visible, self.faces = _given(layers, self.hidden if hide else [np.zeros_like(m) for m in self.hidden])
        self.bounds = tuple(_among(layer, *given) for layer, *given in zip(layers, self.visible, self.faces))
        self.orders = _orders(layers, self.visible, self.faces, cloth, tucks)
        kinds = {"native": partial(NativeOutfitEvaluator, precision=precision), "numpy": ReferenceOutfitEvaluator}
        self._new_evaluator = partial(kinds[backend], self.bounds, self.orders, normals=normals)
        self.backend = backend
        self.avatar = avatar
        self._separates = separate_limbs
        self._sways = (1.0,) * len(self.models)
        self._begin()
        if self._limb_separator is not None:
            worth_saying.extend(self._limb_separator.warnings)
        for warning in worth_saying:
            warnings.warn(warning, AvatarWarning, stacklevel=2)
        found = [warning for draper in self._drapers for warning in draper.avatar.warnings]
        self.warnings = tuple(dict.fromkeys([*found, *worth_saying]))
        self.avatar = replace(avatar, warnings=self.warnings)
        self._covers_at_rest = _covers(layers, [layer.rest for layer in layers])
        given = ", ".join(f"{layer.name} {len(v)} of {len(layer.rest)}" for layer, v in zip(layers, self.visible))
        log.info("draping an outfit on %s, vertices: %s", avatar.source, given)

    def _begin(self) -> None:
        """Make what a frame writes to."""
        rig = self.models[0].rig
        self._evaluator = self._new_evaluator()
        self._sway, self._clock = Sway(backend=self.backend), FrameClock()
        self._separated = rig.rest.astype(np.float32)
        self._limb_separator = LimbSeparator(rig, self.avatar, backend=self.backend) if self._separates else None

    def twin(self) -> Outfit:
        """The same outfit on the same body with frames of its own, for another performer; nothing is bound anew, and
        `sway` is as it is here now."""
        twin = copy(self)
        twin._begin()
        return twin

    @property
    def models(self) -> tuple[GarmentModel, ...]:
        """From the skin outwards."""
        return tuple(garment.model for garment in self.garments)

    @property
    def drapers(self) -> tuple[Draper, ...]:
        """Each garment by itself and whole, bound over what lies beneath: no order, no tuck."""
        return tuple(self._drapers)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(d,) names of the joint positions, in the order `drape` takes them."""
        return self.models[0].rig.joint_names

    @property
    def vertex_counts(self) -> tuple[int, ...]:
        """Points v that `drape` writes, of each garment."""
        return tuple(len(indices) for indices in self.visible)

    @property
    def moved(self) -> tuple[bool, ...]:
        """Whether vertices of each garment are moved after skinning, to keep the order of layers or a tucked hem."""
        moved = {order.yielding for order in self.orders}
        return tuple(k in moved for k in range(len(self.garments)))

    @property
    def rest_garments(self) -> tuple[Garment, ...]:
        """Each model's whole mesh in the rest shape worn here."""
        return tuple(draper.rest_garment for draper in self._drapers)

    @property
    def separated_positions(self) -> np.ndarray:
        """(d,) float32 [rad] the joint positions of the last drape, limbs separated, as of `Draper`."""
        if self._limb_separator is None:
            raise ValueError("this outfit separates no limbs and drapes positions as given; see separate_limbs")
        return self._separated.copy()

    @property
    def instruction_set(self) -> str:
        """What evaluates: the native evaluator's instruction set, or "numpy"."""
        return self._evaluator.instruction_set

    @property
    def precision(self) -> str:
        """Of the network weights it computes with: "fp32", "bf16" or "int8"."""
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
        """Deform all garments for one pose.

        joint_positions, gravity, effective_gravity, time, root: as of `Draper.drape`; where one garment's model knows
        no accelerated roots, all of them follow the direction alone. outs: writable float32 views, one a garment,
        all (v, 6) or all (v, 3), any row stride; default new (v, 6). Returns `outs`: x, y, z [m], then unit normals;
        row k of a garment is its vertex `visible[garment][k]`.
        Raises ValueError as `Draper.drape` does. Order is kept from one frame to the next: give frames in their order.
        """
        learnt = [bool(bound.sway_layers) and effective_gravity is None for bound in self.bounds]
        felt = [(gravity, effective_gravity, 0.0)] * len(self._drapers)
        if root is not None:
            felt = self._swaying(time, root, effective_gravity, learnt)
        poses = [draper.checked_pose(joint_positions, *each) for draper, (*each, _) in zip(self._drapers, felt)]
        positions, down = poses[-1]
        if time is not None:
            tell = partial(self._sway.moment, self._clock.passed(time), self._clock.elapsed, rooted=root is not None)
            told = zip(poses, felt, learnt, self.sways)
            down = np.stack([tell(twist=t, learnt=by, amount=a).after(each) for (_, each), (*_, t), by, a in told])
        if self._limb_separator is not None:
            positions, _ = self._limb_separator.separate(positions, out=self._separated)
        if outs is None:
            outs = [np.empty((count, 6), dtype=np.float32) for count in self.vertex_counts]
        self._evaluator.evaluate(positions, down, outs)
        return list(outs)

    def _swaying(
        self, time: float | None, root: np.ndarray | None, given: np.ndarray | None, learnt: Sequence[bool]
    ) -> list[tuple]:
        """Gravity, effective gravity and twist of each garment, as `Sway.gravity` tells them."""
        tell = cache(
            partial(self._sway.gravity, time, root, given, accelerated=True)
        )  # the root moves once: asked again at that time, only the amount differs
        return [tell(learnt=by, amount=amount) for by, amount in zip(learnt, self.sways)]

    @property
    def sway(self) -> float | tuple[float, ...]:
        """How much the garments swing where `drape` is told time and root, 0 to 1, as of `Draper`: one number for all,
        or, where they differ, one each from the skin outwards. Raises ValueError, when set, for other numbers, or
        another number of them."""
        return self._sways if len(set(self._sways)) > 1 else self._sways[0]

    @sway.setter
    def sway(self, amount: float | Sequence[float]) -> None:
        many = isinstance(amount, Sequence) or np.ndim(amount) > 0
        amounts = tuple(amount) if many else (amount,) * len(self.models)
        if len(amounts) != len(self.models):
            raise ValueError(f"sway has {len(amounts)} numbers; expected one for each of {len(self.models)} garments")
        self._sways = tuple(checked_amount(each) for each in amounts)

    @property
    def sways(self) -> tuple[float, ...]:
        """`sway` of each garment."""
        return self._sways

    def reset(self) -> None:
        """Let the cloth hang still, as if the next frame were the first; see `Sway.reset`."""
        self._sway.reset()
        self._clock.reset()

    def bind_step(
        self, joint_positions: np.ndarray, gravity: np.ndarray, outs: Sequence[np.ndarray]
    ) -> Callable[[], None]:
        """A frame bound to its arrays, as `Draper.bind_step`: `step()` drapes what they hold now into `outs`."""
        separator = self._limb_separator
        draped = joint_positions if separator is None else self._separated
        if self.backend == "native":
            evaluate = self._evaluator.bind_step(draped, gravity, outs).step
        else:
            evaluate = partial(self._evaluator.evaluate, draped, gravity, outs)
        check = self._drapers[0].check_unusual

        def step() -> None:
            check(joint_positions)
            if separator is not None:
                separator.separate(joint_positions, out=draped)
            evaluate()

        return step

    def node_transforms(self) -> tuple[np.ndarray, ...]:
        """Garment node transforms (m, 3, 4) of each garment in the last frame, canonical garment node frame to root
        frame. Skinned by `bounds` they give the vertices as they are before `moved` ones are moved."""
        return tuple(self._evaluator.node_transforms(k) for k in range(len(self.garments)))

    def bone_transforms(self, joint_positions: np.ndarray) -> np.ndarray:
        """(b, 3, 4) canonical-to-posed transforms of this body's bones, for posing the body beside the garments.

        Limbs are separated, where drapes are."""
        if self._limb_separator is not None:
            joint_positions, _ = self._limb_separator.separate(np.asarray(joint_positions, dtype=np.float32))
        return self._drapers[0].bone_transforms(joint_positions)

    @cached_property
    def body_to_draw(self) -> Avatar:
        """The avatar and its accessories, skin under cloth up to 6 mm slimmer, so that none shows through where cloth
        lies a little too deep."""
        return slimmed(self.avatar, self._covers_at_rest).with_accessories()

    @cached_property
    def faces_to_draw(self) -> np.ndarray:
        """Mask over the faces of `body_to_draw`: all but those of `body_mask`."""
        accessories = len(self.body_to_draw.faces) - len(self.body_mask)
        return np.concatenate([~self.body_mask, np.ones(accessories, dtype=bool)])

    def posed_body(self, joint_positions: np.ndarray) -> np.ndarray:
        """(V, 3) [m] `body_to_draw` in a pose, for drawing it beside the garments; limbs as of `bone_transforms`."""
        return self.body_to_draw.posed_vertices(self.bone_transforms(joint_positions))


def _checked_garments(garments: Sequence[GarmentModel | OutfitGarment], avatar: Avatar) -> tuple[OutfitGarment, ...]:
    if isinstance(garments, GarmentModel | OutfitGarment) or not isinstance(avatar, Avatar):
        given = f"{type(garments).__name__}, {type(avatar).__name__}"
        raise TypeError(f"Outfit takes a list of garments, then an avatar: Outfit([inner, outer], avatar), got {given}")
    checked = [OutfitGarment(garment) if isinstance(garment, GarmentModel) else garment for garment in garments]
    for garment in checked:
        if not isinstance(garment, OutfitGarment) or not isinstance(garment.model, GarmentModel):
            raise TypeError(
                f"a garment of an outfit is a GarmentModel or an OutfitGarment, got {type(garment).__name__}"
            )
    return tuple(checked)


def _poses_to_look_at(rig: Rig) -> tuple[list[tuple[np.ndarray, np.ndarray]], bool]:
    """Poses (joint positions, gravity), the first at rest, and whether everyday ones are among them."""
    rest = [(rig.rest, UPRIGHT_GRAVITY)]
    try:
        return [*rest, *zip(*everyday_poses(rig))], True
    except ValueError:
        return rest, False


def _hidden(layers: Sequence[Layer], cloth: list[list[np.ndarray]], poses: list, avatar: Avatar):
    """What is covered in all poses: a mask (n,) of each layer, and one of the body's vertices."""
    hidden = [np.ones(len(layer.rest), dtype=bool) for layer in layers]
    body = np.ones(len(avatar.vertices), dtype=bool)
    for (positions, _), drawn in zip(poses, cloth):
        drawn = [layer.astype(np.float64) for layer in drawn]
        covers = _covers(layers, drawn)
        skin = avatar.posed_vertices(layers[0].draper.bone_transforms(positions)).astype(np.float64)
        skin = np.concatenate([skin, vertex_normals(skin, avatar.faces)], axis=1)
        for mask, points, over in [
            (body, skin, covers),
            *((hidden[k], drawn[k], _over(layers[k], covers[k + 1 :])) for k in range(len(layers))),
        ]:
            left = np.flatnonzero(mask)
            mask[left] = covered(points[left, :3], points[left, 3:], over)
    return tuple(mask | (layer.tucked_depth > DEEP) for layer, mask in zip(layers, hidden)), body


def _covers(layers: Sequence[Layer], drawn: Sequence[np.ndarray]) -> list[Cover]:
    """Layers as they are drawn in a pose, (n, 6) each."""
    return [Cover(d[:, :3], d[:, 3:], layer.hem_distance) for layer, d in zip(layers, drawn)]


def _over(layer: Layer, covers: Sequence[Cover]) -> list[Cover]:
    """What covers a layer. A tucked one may slide up, so that more of it, below a waistband, counts as near that."""
    slides = SLIDES if layer.garment.tucked else 0
    return [replace(cover, hem_distance=cover.hem_distance - slides) for cover in covers]


def _given(layers: Sequence[Layer], hidden: Sequence[np.ndarray]):
    """Of each layer the vertices (v,) int32 that are given, and faces (f, 3) of these."""
    shown = [layer.draper.faces[~faces_of(layer.draper.faces, mask)] for layer, mask in zip(layers, hidden)]
    visible = [np.unique(faces).astype(np.int32) for faces in shown]
    return tuple(visible), tuple(np.searchsorted(v, faces).astype(np.int32) for v, faces in zip(visible, shown))


def _among(layer: Layer, vertices: np.ndarray, faces: np.ndarray) -> BoundGarment:
    """A layer's bound garment, of which only some vertices (v,) are computed. What is tucked in does not twist."""
    bound = layer.bound
    if layer.garment.tucked:
        bound = replace(bound, node_twist=np.empty(0, dtype=np.float32))
    fields = ("vertices", "normals", "influence_nodes", "influence_weights")
    return replace(
        bound, faces=faces, **{name: np.ascontiguousarray(getattr(bound, name)[vertices]) for name in fields}
    )


def _orders(layers, visible, faces, cloth, tucks) -> tuple[LayerOrder, ...]:
    """What keeps the order of every two layers: the outer one yields, or the inner one where it is tucked in."""
    orders = []
    for outer in range(len(layers)):
        for inner in range(outer):
            pair = (outer, inner) if (inner, outer) in tucks else (inner, outer)
            rest = tuple(layers[k].rest[visible[k], :3] for k in pair)
            poses = [tuple(drawn[k][visible[k]] for k in pair) for drawn in cloth]
            orders.append(bind_layer_order(*pair, rest, tuple(faces[k] for k in pair), poses))
    return tuple(order for order in orders if order is not None)
