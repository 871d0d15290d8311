"""What comes of putting garments on a body: the layers of an outfit, their order, and what of them is never seen.

It takes some tenths of a second a garment, and does not change from frame to frame: an `Outfit` drapes it, in this
process or in another one.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import vertex_normals
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.outfit.coverage import OWN_CLOTHES, Cover, OwnClothes, covered, faces_of, own_clothes_beside
from physkin_core.outfit.dressing import drapes, put_on
from physkin_core.outfit.layer_order import LayerOrder, bind_layer_order
from physkin_core.outfit.taking_in import taken_in
from physkin_core.outfit.tuck import DEEP, SLIDES
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.sway.frame_input import UPRIGHT_GRAVITY

__all__ = ["BoundOutfit", "bind_outfit", "covers_of", "hidden_body"]

log = logging.getLogger(__name__)

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
    hide: bool = True,
    own_clothes: OwnClothes = "replace",
) -> BoundOutfit:
    """Put garments on an avatar. Arguments and ValueErrors: as of `Outfit`."""
    if own_clothes not in OWN_CLOTHES:
        raise ValueError(f"own_clothes is {own_clothes!r}; allowed: {', '.join(OWN_CLOTHES)}")
    layers, tucks, worth_saying = put_on(garments, avatar, fit=fit)
    orders: tuple[LayerOrder, ...] = ()
    body_hidden = None
    if len(layers) > 1:
        poses, checked = _poses_to_look_at(layers[0].model.rig)
        for inner, outer in tucks:
            layers[inner] = taken_in(layers[inner], layers[outer], poses)
        cloth = drapes(layers, tucks, poses)
        if checked:
            hidden, body_hidden = _hidden(layers, cloth, poses, avatar)
            layers = [replace(layer, hidden=mask) for layer, mask in zip(layers, hidden)]
        else:
            worth_saying.append("everyday poses are of the default rig: with this one nothing is hidden")
        layers = [_giving_visible(layer) if hide else _untwisted(layer, layer.given) for layer in layers]
        orders = _orders(layers, cloth, tucks)
        moved = {order.yielding for order in orders}
        layers = [replace(layer, moved=k in moved) for k, layer in enumerate(layers)]
    given = ", ".join(f"{layer.name} {layer.vertex_count} of {len(layer.rest)}" for layer in layers)
    log.info("draping on %s, vertices: %s", avatar.source, given)
    warnings = tuple(dict.fromkeys([*avatar.warnings, *worth_saying]))
    clothes = own_clothes_beside(avatar, covers_of(layers, [layer.rest for layer in layers]), own_clothes)
    return BoundOutfit(
        replace(avatar, warnings=warnings, clothes=clothes), tuple(layers), orders, body_hidden, tuple(worth_saying)
    )


def hidden_body(layers: Sequence[Layer], avatar: Avatar) -> np.ndarray:
    """(V,) bool, the body's vertices that are covered in all everyday poses; none where these are of another rig."""
    poses, checked = _poses_to_look_at(layers[0].model.rig)
    if not checked:
        return np.zeros(len(avatar.vertices), dtype=bool)
    return _hidden(layers, drapes(layers, (), poses), poses, avatar)[1]


def covers_of(layers: Sequence[Layer], drawn: Sequence[np.ndarray]) -> list[Cover]:
    """Layers as they are drawn in a pose, (n, 6) each."""
    return [Cover(d[:, :3], d[:, 3:], layer.hem_distance) for layer, d in zip(layers, drawn)]


def _poses_to_look_at(rig: Rig) -> tuple[Poses, bool]:
    """Poses (joint positions, gravity), the first at rest, and whether everyday ones are among them."""
    rest = [(rig.rest, UPRIGHT_GRAVITY)]
    try:
        return [*rest, *zip(*everyday_poses(rig))], True
    except ValueError:
        return rest, False


def _hidden(
    layers: Sequence[Layer], cloth: list[list[np.ndarray]], poses: Poses, avatar: Avatar
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """What is covered in all poses: a mask (n,) of each layer, and one of the body's vertices."""
    hidden = [np.ones(len(layer.rest), dtype=bool) for layer in layers]
    body = np.ones(len(avatar.vertices), dtype=bool)
    for (positions, _), drawn in zip(poses, cloth):
        drawn = [layer.astype(np.float64) for layer in drawn]
        covers = covers_of(layers, drawn)
        skin = avatar.posed_vertices(layers[0].model.rig.bone_transforms(positions, heads=avatar.bone_heads)).astype(
            np.float64
        )
        skin = np.concatenate([skin, vertex_normals(skin, avatar.faces)], axis=1)
        for mask, points, over in [
            (body, skin, covers),
            *((hidden[k], drawn[k], _over(layers[k], covers[k + 1 :])) for k in range(len(layers))),
        ]:
            left = np.flatnonzero(mask)
            mask[left] = covered(points[left, :3], points[left, 3:], over)
    return tuple(mask | (layer.tucked_depth > DEEP) for layer, mask in zip(layers, hidden)), body


def _over(layer: Layer, covers: Sequence[Cover]) -> list[Cover]:
    """What covers a layer. A tucked one may slide up, so that more of it, below a waistband, counts as near that."""
    slides = SLIDES if layer.tucked else 0
    return [replace(cover, hem_distance=cover.hem_distance - slides) for cover in covers]


def _giving_visible(layer: Layer) -> Layer:
    """A layer of which the faces that are not hidden are given, and their vertices."""
    shown = layer.bound.faces[~faces_of(layer.bound.faces, layer.hidden)]
    visible = np.unique(shown).astype(np.int32)
    faces = np.searchsorted(visible, shown).astype(np.int32)
    return replace(_untwisted(layer, layer.bound.of_vertices(visible, faces)), visible=visible)


def _untwisted(layer: Layer, given: BoundGarment) -> Layer:
    """What is tucked in does not twist."""
    if layer.tucked:
        given = replace(given, node_twist=np.empty(0, dtype=np.float32))
    return replace(layer, given=given)


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
            orders.append(bind_layer_order(*pair, rest, tuple(layers[k].faces for k in pair), poses))
    return tuple(order for order in orders if order is not None)


def _without_networks(layer: Layer) -> SkinnedGarment:
    model = layer.model
    return model.without_networks() if isinstance(model, GarmentModel) else model
