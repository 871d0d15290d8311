"""The layers of an outfit, put on one after the other: each on the skin and what is already worn.

Dimensions: `n` garment vertices, `P` poses. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.surface_paths import openings, path_lengths
from physkin_core.outfit.coverage import FROM_HEM, hem_distances
from physkin_core.outfit.layer_order import ReferenceLayerOrder, bind_layer_order
from physkin_core.outfit.tuck import tucked_depths
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.draper import Draper
from physkin_core.runtime.layers_beneath import LayerBeneath
from physkin_core.runtime.rest_look import RestLook, look_at_rest

__all__ = ["MOST_LAYERS", "Layer", "OutfitGarment", "drapes", "put_on", "standing_out", "tuck_in"]

MOST_LAYERS = 4
DEEPEST_TUCK = 0.3
"""[m] A garment that reaches farther below a waistband cannot be tucked into it."""
OUTSIDE, MOST_OUTSIDE = 0.01, 0.35
"""An inner layer of which more than the second lies farther outside the outer one than the first [m] is misplaced."""
BELONGS = 0.15
"""[m] Cloth farther from the layer over it at rest is not under it."""


@dataclass(frozen=True)
class OutfitGarment:
    """A garment of an outfit. tucked: its hem is worn under the waistband of the next layer that is not tucked. fit: as
    of `Draper`; None: the outfit's."""

    model: GarmentModel
    tucked: bool = False
    fit: float | None = None


@dataclass(frozen=True)
class Layer:
    """A garment as it is worn here, whole.

    draper: bound over what lies under it. at_rest: how it sits on the skin, before it is tucked in. rest: (n, 6)
    float32 vertices and normals of the drape at rest, tucked in. hem_distance: (n,) [m] along the cloth to its closest
    opening; tucked hems are none. tucked_depth: (n,) [m] below the waistband that it is tucked into, 0 above.
    """

    garment: OutfitGarment
    draper: Draper
    at_rest: RestLook
    rest: np.ndarray
    hem_distance: np.ndarray
    tucked_depth: np.ndarray

    @property
    def name(self) -> str:
        return self.garment.model.name

    @property
    def bound(self) -> BoundGarment:
        return self.draper.bound


def put_on(
    garments: Sequence[OutfitGarment], avatar: Avatar, *, fit: float | None, backend: Literal["native", "numpy"]
) -> tuple[list[Layer], list[tuple[int, int]], list[str]]:
    """Put garments on an avatar, the innermost first. fit: of garments without their own. backend: of every `Draper`.

    Returns the layers, which of them is tucked into which, and sentences to warn of.
    Raises ValueError, in one sentence, for what cannot be worn so.
    """
    _check(garments)
    layers: list[Layer] = []
    tucks: list[tuple[int, int]] = []
    worth_saying: list[str] = []
    for k, garment in enumerate(garments):
        beneath = [LayerBeneath(layer.rest, layer.garment.tucked) for layer in layers]
        model, own_fit = garment.model, fit if garment.fit is None else garment.fit
        bound = bind_garment(model, avatar, fit=own_fit, backend=backend, beneath=beneath) if layers else None
        draper = Draper(model, avatar, fit=own_fit, backend=backend, binding=bound)
        rest = draper.drape(model.rig.rest)
        at_rest = draper.at_rest
        if at_rest is None:
            at_rest = look_at_rest(rest[:, :3], draper.faces, avatar)
            worth_saying += [] if at_rest.sits else [f"{model.name} on {avatar.source}: {at_rest}"]
        hems = hem_distances(draper.bound.vertices, draper.faces)
        layers.append(Layer(garment, draper, at_rest, rest, hems, np.zeros(len(rest))))
        for inner, under in enumerate(layers[:-1]):
            if _waistband_of(garments, inner) == k:
                layers[inner] = _tucked_in(under, layers[k])
                tucks.append((inner, k))
            else:
                warning = _check_order(under, layers[k])
                worth_saying += [] if warning is None else [warning]
    return layers, tucks, worth_saying


def drapes(
    layers: Sequence[Layer], tucks: Sequence[tuple[int, int]], poses: Iterable[tuple[np.ndarray, np.ndarray]]
) -> list[list[np.ndarray]]:
    """All layers (n, 6) in poses (joint positions [rad], gravity direction), with hems tucked in: a list a pose. tucks:
    which layer is tucked into which."""
    cloth = [[layer.draper.drape(*pose) for layer in layers] for pose in poses]
    for inner, outer in tucks:
        tuck_in(layers[inner], layers[outer], [(drawn[inner], drawn[outer]) for drawn in cloth])
    return cloth


def tuck_in(under: Layer, over: Layer, drawn: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Move the inner layer (n, 6) inside the outer one (r, 6) in all poses; the inner ones are written."""
    rest, faces = (over.rest[:, :3], under.rest[:, :3]), (over.draper.faces, under.draper.faces)
    order = bind_layer_order(1, 0, rest, faces, [(outer, inner) for inner, outer in drawn])
    if order is not None:
        for inner, outer in drawn:
            ReferenceLayerOrder(order).apply(outer, inner, look_at_all=True)


def _check(garments: Sequence[OutfitGarment]) -> None:
    """Raise ValueError for what no body could wear."""
    names = [garment.model.name for garment in garments]
    if not 1 <= len(garments) <= MOST_LAYERS:
        raise ValueError(f"an outfit has 1 to {MOST_LAYERS} garments, got {len(garments)}: {', '.join(names)}")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"garment {name!r} is there {names.count(name)} times; an outfit wears a garment once")
    first = garments[0].model
    for garment in garments[1:]:
        if garment.model.rig.to_json() != first.rig.to_json():
            raise ValueError(
                f"garments {first.name!r} and {garment.model.name!r} were trained for different rigs; an outfit has one"
            )
    for k, garment in enumerate(garments):
        if garment.tucked and _waistband_of(garments, k) is None:
            raise ValueError(
                f"{garment.model.name!r} is tucked, but no layer after it has a waistband to take it; "
                "a tucked shirt stands before its trousers"
            )


def _waistband_of(garments: Sequence[OutfitGarment], inner: int) -> int | None:
    """Which layer a tucked one is tucked into; None where it is not, or there is none."""
    if not garments[inner].tucked:
        return None
    return next((k for k in range(inner + 1, len(garments)) if not garments[k].tucked), None)


def _tucked_in(under: Layer, over: Layer) -> Layer:
    """The one layer as it is worn tucked into the other."""
    depth = _depths(under, over)
    if depth is None:
        raise ValueError(f"{under.name!r} cannot be tucked into {over.name!r}: it does not go over its waistband")
    if depth.max() > DEEPEST_TUCK:
        raise ValueError(
            f"{under.name!r} cannot be tucked into {over.name!r}: it reaches {100 * depth.max():.0f} cm below the "
            f"waistband, at most {100 * DEEPEST_TUCK:.0f} cm fit"
        )
    rest = under.rest.copy()
    tuck_in(under, over, [(rest, over.rest)])
    hem = np.concatenate(openings(under.bound.vertices, under.draper.faces))
    hems = path_lengths(under.bound.vertices, under.draper.faces, hem[depth[hem] == 0])
    return replace(under, rest=rest, hem_distance=hems, tucked_depth=depth)


def _depths(under: Layer, over: Layer) -> np.ndarray | None:
    return tucked_depths((under.rest[:, :3], over.rest[:, :3]), (under.draper.faces, over.draper.faces))


def _check_order(under: Layer, over: Layer) -> str | None:
    """What to warn of where one layer is worn under another, if anything.

    Raises ValueError where much of what should lie under a layer hangs outside it at rest.
    """
    outside, deepest = standing_out(under, over)
    if outside > MOST_OUTSIDE:
        raise ValueError(
            f"{under.name!r} cannot be worn under {over.name!r}: {100 * outside:.0f} % of it there hangs outside, "
            f"up to {1000 * deepest:.0f} mm; put it after {over.name!r}"
        )
    depth = None if under.garment.tucked else _depths(under, over)
    if depth is None or depth.max() > DEEPEST_TUCK:
        return None
    return f"{under.name!r} goes under the waistband of {over.name!r} and is not tucked: put it after, or tuck it in"


def standing_out(under: Layer, over: Layer) -> tuple[float, float]:
    """Of the inner layer where it lies over or under the outer one at rest: the share outside, and how far [m]."""
    from scipy.spatial import cKDTree

    inner, outer = under.rest.astype(np.float64), over.rest.astype(np.float64)
    match = cKDTree(with_normals(outer[:, :3], outer[:, 3:])).query(with_normals(inner[:, :3], inner[:, 3:]))[1]
    gap = inner[:, :3] - outer[match, :3]
    near = (over.hem_distance[match] > FROM_HEM) & (np.linalg.norm(gap, axis=1) < BELONGS)
    if not near.any():
        return 0.0, 0.0
    off = np.einsum("ni,ni->n", gap, outer[match, 3:])[near]
    return float((off > OUTSIDE).mean()), float(off.max())
