"""A tucked hem: held inside the waistband of the layer over it, whatever the pose, and the cloth above drawn along.

What of a garment lies below the waistband at rest is anchored to the layer over it, just inside. How far that moves it
is carried up the cloth, less and less. Only the pose decides, no earlier frame does.

NumPy reference; native/src/outfit/tuck.cpp is the same in C++.

Dimensions: `n` vertices of the tucked layer, `r` of the one over it, `a` anchored ones, `d` drawn along. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_core.model.skinning import unit
from physkin_core.model.surface_paths import openings, path_lengths
from physkin_core.runtime.layers_beneath import LAYER_GAP

__all__ = ["DRAWN_FROM", "Tuck", "apply_tuck", "bind_tuck"]

INSET = LAYER_GAP + 0.001
"""[m] inside the layer over it, a little more than what holds between vertices."""
BELOW = 0.002
"""[m] below the waistband from where cloth is held."""
HOLDING = 0.015
"""[m] below the waistband down to which anchors draw the cloth above along."""
FARTHEST = 0.2
"""[m] Cloth farther from the layer over it at rest is not tucked into it."""
DRAWN = 0.15
"""[m] along the cloth above the waistband that is drawn along."""
DRAWN_FROM = 4
"""Anchors that draw a vertex along."""


@dataclass(frozen=True)
class Tuck:
    """A tucked layer and the one over it. Index arrays are int32, shares float32.

    inner, outer: which layers. held: (a,) vertices of the tucked layer. anchor: (a, 3) vertices of the layer over it,
    anchor_share: (a, 3) their shares in the point that a vertex is held inside of. drawn: (d,) vertices of the tucked
    layer; drawn_by: (d, 4) indices into `held`, drawn_share: (d, 4) how much of their displacement it takes.
    """

    inner: int
    outer: int
    held: np.ndarray
    anchor: np.ndarray
    anchor_share: np.ndarray
    drawn: np.ndarray
    drawn_by: np.ndarray
    drawn_share: np.ndarray

    @property
    def needed(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices of the tucked layer and of the one over it that must be computed for the others to be drawn."""
        drawing = np.unique(self.drawn_by)
        return self.held[drawing], np.unique(self.anchor[drawing])

    def among(self, inner: np.ndarray, outer: np.ndarray) -> Tuck:
        """The same for only some vertices of both layers, in order of index, `needed` among them."""
        held = np.isin(self.held, inner) & np.isin(self.anchor, outer).all(axis=1)
        drawn = np.isin(self.drawn, inner)
        place = np.cumsum(held) - 1
        return replace(
            self,
            held=_places(inner, self.held[held]),
            anchor=_places(outer, self.anchor[held]),
            anchor_share=np.ascontiguousarray(self.anchor_share[held]),
            drawn=_places(inner, self.drawn[drawn]),
            drawn_by=place[self.drawn_by[drawn]].astype(np.int32),
            drawn_share=np.ascontiguousarray(self.drawn_share[drawn]),
        )


def bind_tuck(
    inner: int,
    outer: int,
    rest: tuple[np.ndarray, np.ndarray],
    faces: tuple[np.ndarray, np.ndarray],
) -> tuple[Tuck, np.ndarray] | None:
    """Find what to hold; None where the inner layer does not go over the top of the other.

    inner, outer: which layers. rest: their vertices (n, 3) and (r, 3) [m] at rest. faces: (f, 3) of these.
    Returns the tuck, and how far below the waistband (n,) [m] each vertex of the inner layer is held, 0 where not.
    """
    from point_cloud_utils import closest_points_on_mesh

    waistband = openings(rest[1], faces[1])[:1]
    if not waistband:
        return None
    cloth, over = (np.ascontiguousarray(x, dtype=np.float64) for x in rest)
    distance, face, share = closest_points_on_mesh(cloth, over, np.ascontiguousarray(faces[1], dtype=np.int64))
    corners = faces[1][face]
    depth = (share * path_lengths(over, faces[1], waistband[0])[corners]).sum(axis=1)
    outward = np.einsum("nk,nki->ni", share, vertex_normals(over, faces[1])[corners])
    alike = np.einsum("ni,ni->n", outward, vertex_normals(cloth, faces[0])) > 0
    depth = np.where((distance < FARTHEST) & alike & (depth > BELOW), depth, 0)
    held = np.flatnonzero(depth)
    holding = np.flatnonzero((depth > 0) & (depth < HOLDING))
    if len(holding) == 0:
        return None
    drawn, by, drawn_share = _drawn_along(cloth, faces[0], depth > 0, holding)
    tuck = Tuck(
        inner=inner,
        outer=outer,
        held=held.astype(np.int32),
        anchor=corners[held].astype(np.int32),
        anchor_share=share[held].astype(np.float32),
        drawn=drawn.astype(np.int32),
        drawn_by=np.searchsorted(held, by).astype(np.int32),
        drawn_share=drawn_share.astype(np.float32),
    )
    return tuck, depth


def apply_tuck(tuck: Tuck, inner: np.ndarray, outer: np.ndarray) -> None:
    """Hold and draw the tucked layer inner (n, 6) inside outer (r, 6): x, y, z [m] and normals; inner is written."""
    around = outer[tuck.anchor].astype(np.float64)
    at = np.einsum("ak,aki->ai", tuck.anchor_share, around)
    moved = at[:, :3] - INSET * unit(at[:, 3:]) - inner[tuck.held, :3]
    inner[tuck.held, :3] += moved
    inner[tuck.drawn, :3] += np.einsum("dk,dki->di", tuck.drawn_share, moved[tuck.drawn_by])


def _drawn_along(cloth: np.ndarray, faces: np.ndarray, held: np.ndarray, holding: np.ndarray):
    """Vertices (d,) drawn along, the anchored ones (d, 4) that draw them, and shares (d, 4)."""
    from scipy.spatial import cKDTree

    above = path_lengths(cloth, faces, holding)
    drawn = np.flatnonzero((above < DRAWN) & ~held)
    count = min(DRAWN_FROM + 1, len(holding))
    distance, near = cKDTree(cloth[holding]).query(cloth[drawn], k=[*range(1, count + 1)])
    # the farthest one counts nothing, so that the share is continuous over the cloth where another takes its place
    share = np.maximum(1 - distance[:, :-1] / distance[:, -1:], 1e-6) if count > DRAWN_FROM else 1 / distance
    share, near = share[:, :DRAWN_FROM], near[:, :DRAWN_FROM]
    if near.shape[1] < DRAWN_FROM:
        missing = DRAWN_FROM - near.shape[1]
        share, near = np.pad(share, ((0, 0), (0, missing))), np.pad(near, ((0, 0), (0, missing)))
    reach = above[drawn] / DRAWN
    fade = (1 - reach**2) ** 2
    return drawn, holding[near], fade[:, None] * share / share.sum(axis=1, keepdims=True)


def _places(kept: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Where vertices are in `kept` (k,), in order of index."""
    return np.searchsorted(kept, vertices).astype(np.int32)
