"""What comes of putting garments on a body: the layers of an outfit, their order, and what of them is never seen.

It takes some tenths of a second a garment, and does not change from frame to frame: an `Outfit` drapes it, in this
process or in another one.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.outfit.coverage import OWN_CLOTHES, AlwaysCovered, OwnClothes, faces_of, own_clothes_beside
from physkin_core.outfit.dressing import drapes, put_on
from physkin_core.outfit.layer_order import LayerOrder, bind_layer_order
from physkin_core.outfit.taking_in import taken_in
from physkin_core.rig.rig import Rig
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.layer import Layer, WornGarment

__all__ = ["BoundOutfit", "bind_outfit", "hidden_body"]

log = logging.getLogger(__name__)

_in_use: WeakKeyDictionary[Avatar, WeakValueDictionary[str, BoundOutfit]] = WeakKeyDictionary()
"""What is worn by avatars that are in use, by garments and how they are worn."""

Poses = list[tuple[np.ndarray, np.ndarray]]
"""Joint positions and gravity of each."""


@dataclass(frozen=True)
class BoundOutfit:
    """Garments on one body: everything of an outfit that does not change with the pose.

    avatar: with all that was warned of, its clothes without what is replaced. layers: from the skin outwards. orders:
    what keeps them in order. body_hidden: (V,) bool, the body's vertices that are covered in all everyday poses; None
    where these have not been looked at.
    worth_saying: what there is to warn of beyond the avatar's own warnings.
    """

    avatar: Avatar
    layers: tuple[Layer, ...]
    orders: tuple[LayerOrder, ...] = ()
    body_hidden: np.ndarray | None = None
    worth_saying: tuple[str, ...] = ()

    def without_networks(self) -> BoundOutfit:
        """The same, its garment models without the networks that binding has folded into the layers."""
        return replace(self, layers=tuple(replace(layer, model=_without_networks(layer)) for layer in self.layers))


def bind_outfit(
    garments: Sequence[WornGarment],
    avatar: Avatar,
    *,
    fit: float | None = None,
    hide_covered: bool = True,
    own_clothes: OwnClothes = "replace",
) -> BoundOutfit:
    """Put garments on an avatar. Arguments and ValueErrors: as of `Outfit`.

    The same garments on the same avatar are bound once, as long as what that gave is in use: models and avatars are
    taken for the objects that they are, and are not written into.
    """
    if own_clothes not in OWN_CLOTHES:
        raise ValueError(f"own_clothes is {own_clothes!r}; allowed: {', '.join(OWN_CLOTHES)}")
    worn = [(id(garment.model), garment.tucked, garment.fit) for garment in garments]
    key = repr((worn, fit, hide_covered, own_clothes))
    known = _in_use.setdefault(avatar, WeakValueDictionary())
    bound = known.get(key)
    if bound is None:  # which keeps its models, so that nothing else has their ids
        bound = known[key] = _bound(garments, avatar, fit, hide_covered, own_clothes)
    return bound


def _bound(
    garments: Sequence[WornGarment], avatar: Avatar, fit: float | None, hide_covered: bool, own_clothes: OwnClothes
) -> BoundOutfit:
    layers, tucks, worth_saying = put_on(garments, avatar, fit=fit)
    orders: tuple[LayerOrder, ...] = ()
    body_hidden = None
    if len(layers) > 1:
        poses, checked = _poses_to_look_at(layers[0].model.rig)
        for inner, outer in tucks:
            layers[inner] = taken_in(layers[inner], layers[outer], poses)
        cloth = drapes(layers, tucks, poses)
        if checked:
            always = _looked_at(layers, cloth, poses, avatar)
            body_hidden = always.body
            layers = [replace(layer, hidden=mask) for layer, mask in zip(layers, always.cloth)]
        else:
            worth_saying.append("everyday poses are known for the default rig only: with this rig no cloth is left out")
        layers = [_giving_visible(layer) for layer in layers] if hide_covered else layers
        orders = _orders(layers, cloth, tucks)
        moved = {order.yielding for order in orders}
        layers = [replace(layer, moved=k in moved) for k, layer in enumerate(layers)]
    given = ", ".join(f"{layer.name} {layer.vertex_count} of {len(layer.rest)}" for layer in layers)
    log.info("draping on %s, vertices: %s", avatar.source, given)
    warnings = tuple(dict.fromkeys([*avatar.warnings, *worth_saying]))
    clothes = own_clothes_beside(avatar, layers, own_clothes)
    return BoundOutfit(
        replace(avatar, warnings=warnings, clothes=clothes), tuple(layers), orders, body_hidden, tuple(worth_saying)
    )


def hidden_body(layers: Sequence[Layer], avatar: Avatar) -> np.ndarray:
    """(V,) bool, the body's vertices that are covered in all everyday poses; none where these are of another rig."""
    poses, checked = _poses_to_look_at(layers[0].model.rig)
    if not checked:
        return np.zeros(len(avatar.vertices), dtype=bool)
    return _looked_at(layers, drapes(layers, (), poses), poses, avatar).body


def _poses_to_look_at(rig: Rig) -> tuple[Poses, bool]:
    """Poses (joint positions, gravity), the first at rest, and whether everyday ones are among them."""
    rest = [(rig.rest, UPRIGHT_GRAVITY)]
    try:
        return [*rest, *zip(*everyday_poses(rig))], True
    except ValueError:
        return rest, False


def _looked_at(layers: Sequence[Layer], cloth: list[list[np.ndarray]], poses: Poses, avatar: Avatar) -> AlwaysCovered:
    """What is covered in all poses."""
    always = AlwaysCovered(layers, avatar)
    for (positions, _), drawn in zip(poses, cloth):
        always.look(positions, drawn)
    return always


def _giving_visible(layer: Layer) -> Layer:
    """A layer of which the faces that are not hidden are given, and their vertices."""
    shown = layer.bound.faces[~faces_of(layer.bound.faces, layer.hidden)]
    visible = np.unique(shown).astype(np.int32)
    faces = np.searchsorted(visible, shown).astype(np.int32)
    return replace(layer, bound_visible=layer.bound.of_vertices(visible, faces), visible=visible)


def _orders(
    layers: Sequence[Layer], cloth: list[list[np.ndarray]], tucks: list[tuple[int, int]]
) -> tuple[LayerOrder, ...]:
    """What keeps the order of every two layers: the outer one yields, or the inner one where it is tucked in."""
    orders = []
    for outer in range(len(layers)):
        for inner in range(outer):
            pair = (outer, inner) if (inner, outer) in tucks else (inner, outer)
            rest = tuple(layers[k].rest[layers[k].visible, :3] for k in pair)
            poses = [tuple(drawn[k][layers[k].visible] for k in pair) for drawn in cloth]
            faces, turned = zip(*((layers[k].faces, layers[k].turned[layers[k].visible]) for k in pair))
            orders.append(bind_layer_order(*pair, rest, faces, poses, turned=turned))
    return tuple(order for order in orders if order is not None)


def _without_networks(layer: Layer) -> SkinnedGarment:
    model = layer.model
    return model.without_networks() if isinstance(model, GarmentModel) else model
