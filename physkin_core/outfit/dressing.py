"""The layers of an outfit, put on one after the other: each on the skin and what is already worn.

Dimensions: `n` garment vertices, `P` poses. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.surface_paths import HEM
from physkin_core.native_module import native
from physkin_core.outfit.layer_order import bind_layer_order
from physkin_core.outfit.tuck import tucked_depths
from physkin_core.runtime.binding import bind_garment, draping
from physkin_core.runtime.evaluator import drape_poses
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.runtime.rest_look import look_at_rest
from physkin_core.runtime.turned_cloth import turned_cloth

__all__ = ["MOST_LAYERS", "drapes", "put_on", "standing_out", "tuck_in"]

MOST_LAYERS = 4
DEEPEST_TUCK = 0.45
"""[m] A garment that reaches farther below a waistband cannot be tucked into it."""
OUTSIDE, MOST_OUTSIDE = 0.01, 0.35
"""An inner layer of which more than the second lies farther outside the outer one than the first [m] is misplaced."""
BELONGS = 0.15
"""[m] Cloth farther from the layer over it at rest is not under it."""


def put_on(
    garments: Sequence[WornGarment], avatar: Avatar, *, fit: float | None
) -> tuple[list[Layer], list[tuple[int, int]], list[str]]:
    """Put garments on an avatar, the innermost first. fit: of garments without their own.

    Returns the layers, all vertices given, which of them is tucked into which, and sentences to warn of.
    Raises ValueError, in one sentence, for what cannot be worn so.
    """
    _check(garments)
    layers: list[Layer] = []
    tucks: list[tuple[int, int]] = []
    worth_saying: list[str] = []
    for k, garment in enumerate(garments):
        own_fit = checked_fit(garment.model, fit if garment.fit is None else garment.fit)
        layers.append(_worn(garment, avatar, own_fit, layers))
        if not layers[k].at_rest.sits:
            worth_saying.append(f"{layers[k].name} on {avatar.source}: {layers[k].at_rest}")
        for inner, under in enumerate(layers[:-1]):
            if _waistband_of(garments, inner) == k:
                layers[inner] = _tucked_in(under, layers[k])
                tucks.append((inner, k))
            else:
                warning = _check_order(under, layers[k])
                worth_saying += [] if warning is None else [warning]
    return layers, tucks, worth_saying


def _worn(garment: WornGarment, avatar: Avatar, fit: float, beneath: Sequence[Layer]) -> Layer:
    """One more layer, over those beneath."""
    model = garment.model
    bound = bind_garment(model, avatar, fit=fit, beneath=beneath)
    with draping(model, avatar):
        (rest,) = drape_poses(bound, [(model.rig.rest, UPRIGHT_GRAVITY)])
    count = len(rest)
    return Layer(
        model=model,
        tucked=garment.tucked,
        fit=fit,
        bound=bound,
        rest=rest,
        at_rest=look_at_rest(rest[:, :3], bound.faces, avatar),
        tucked_depth=np.zeros(count),
        hidden=np.zeros(count, dtype=bool),
        turned=turned_cloth(rest, bound.faces, avatar),
        visible=np.arange(count, dtype=np.int32),
        bound_visible=bound,
    )


def drapes(
    layers: Sequence[Layer], tucks: Sequence[tuple[int, int]], poses: Iterable[tuple[np.ndarray, np.ndarray]]
) -> list[list[np.ndarray]]:
    """All layers (n, 6) in poses (joint positions [rad], gravity direction), with hems tucked in: a list a pose. tucks:
    which layer is tucked into which."""
    poses = list(poses)
    cloth = [list(drawn) for drawn in zip(*(layer.drape(poses) for layer in layers))]
    for inner, outer in tucks:
        tuck_in(layers[inner], layers[outer], [(drawn[inner], drawn[outer]) for drawn in cloth])
    return cloth


def tuck_in(under: Layer, over: Layer, drawn: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Move the inner layer (n, 6) inside the outer one (r, 6) in all poses; the inner ones are written."""
    rest, faces = (over.rest[:, :3], under.rest[:, :3]), (over.bound.faces, under.bound.faces)
    order = bind_layer_order(1, 0, rest, faces, [(outer, inner) for inner, outer in drawn])
    if order is not None:
        for inner, outer in drawn:
            native.LayerOrder(order, len(outer), len(inner)).apply(outer, inner, look_at_all=True)


def _check(garments: Sequence[WornGarment]) -> None:
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


def _waistband_of(garments: Sequence[WornGarment], inner: int) -> int | None:
    """Which layer a tucked one is tucked into; None where it is not, or there is none."""
    if not garments[inner].tucked:
        return None
    return next((k for k in range(inner + 1, len(garments)) if not garments[k].tucked), None)


def _tucked_in(under: Layer, over: Layer) -> Layer:
    """The one layer as it is worn tucked into the other."""
    depth = _depths(under, over)
    if depth is None:
        raise ValueError(f"{under.name!r} cannot be tucked into {over.name!r}: it does not reach that waistband")
    if depth.max() > DEEPEST_TUCK:
        raise ValueError(
            f"{under.name!r} cannot be tucked into {over.name!r}: it reaches {100 * depth.max():.0f} cm below the "
            f"waistband, at most {100 * DEEPEST_TUCK:.0f} cm fit"
        )
    rest = under.rest.copy()
    tuck_in(under, over, [(rest, over.rest)])
    return replace(under, rest=rest, tucked_depth=depth)


def _depths(under: Layer, over: Layer) -> np.ndarray | None:
    return tucked_depths((under.rest[:, :3], over.rest[:, :3]), (under.bound.faces, over.bound.faces))


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
    depth = None if under.tucked else _depths(under, over)
    if depth is None or depth.max() > DEEPEST_TUCK:
        return None
    return f"{under.name!r} goes under the waistband of {over.name!r} and is not tucked: put it after, or tuck it in"


def standing_out(under: Layer, over: Layer) -> tuple[float, float]:
    """Of the inner layer where it lies over or under the outer one at rest: the share outside, and how far [m]."""
    from scipy.spatial import cKDTree

    inner, outer = under.rest.astype(np.float64), over.rest.astype(np.float64)
    match = cKDTree(with_normals(outer[:, :3], outer[:, 3:])).query(with_normals(inner[:, :3], inner[:, 3:]))[1]
    gap = inner[:, :3] - outer[match, :3]
    near = (over.hem_distance[match] > HEM) & (np.linalg.norm(gap, axis=1) < BELONGS)
    if not near.any():
        return 0.0, 0.0
    off = np.einsum("ni,ni->n", gap, outer[match, 3:])[near]
    return float((off > OUTSIDE).mean()), float(off.max())
