"""A tucked garment taken in, so that it goes into the waistband by itself in most poses: once, when it is put on.

The order of layers would move its hem inside in every pose anew, in folds of single edges. What it moves in most
everyday poses is sewn into the rest shape instead, smoothly: what is left to move in a frame is less, and strains the
cloth less.

Dimensions: `n` vertices of the tucked layer, `P` poses. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.model.surface_paths import mesh_edges
from physkin_core.outfit.dressing import tuck_in
from physkin_core.runtime.binding import rest_normals
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.layer import Layer

__all__ = ["taken_in"]

SEEN, BURIED = 0.5, 0.95
"""Shares of the poses in which cloth above the waistband, and below, is to be inside by itself. What is seen keeps its
shape where it can; what nobody sees need not, and would poke through."""
FROM, TO = 0.01, 0.04
"""[m] below the waistband between which the one share becomes the other."""
ROUNDS = 20
"""Times that the displacement is averaged with that of neighbours, by half."""


def taken_in(under: Layer, over: Layer, poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> Layer:
    """A tucked layer made narrower where it goes into the waistband of `over`. poses: joint positions [rad] and
    gravity directions."""
    drawn = list(zip(under.drape(poses), over.drape(poses)))
    loose = [cloth[:, :3].copy() for cloth, _ in drawn]
    tuck_in(under, over, drawn)
    pushes = np.stack([np.linalg.norm(cloth[:, :3] - before, axis=1) for (cloth, _), before in zip(drawn, loose)])
    bound = under.bound
    buried = np.clip((under.tucked_depth - FROM) / (TO - FROM), 0, 1)
    seen_push, buried_push = np.quantile(pushes, (SEEN, BURIED), axis=0)
    inwards = ((1 - buried) * seen_push + buried * buried_push)[:, None] * bound.normals
    vertices = (bound.vertices - _smooth(inwards, bound.faces)).astype(np.float32)
    bound = replace(bound, vertices=vertices, normals=rest_normals(under.model, vertices))
    narrower = replace(under, bound=bound, bound_visible=bound)
    (rest,) = narrower.drape([(under.model.rig.rest, UPRIGHT_GRAVITY)])
    narrower = replace(narrower, rest=rest)
    tuck_in(narrower, over, [(rest, over.rest)])
    return narrower


def _smooth(values: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Values (n, 3) at vertices of faces (f, 3), averaged with those around."""
    from scipy.sparse import coo_array

    edges, _ = mesh_edges(faces)
    ends = np.concatenate([edges, edges[:, ::-1]]).T
    count = np.maximum(np.bincount(ends[0], minlength=len(values)), 1)
    average = coo_array((1 / count[ends[0]], ends), shape=(len(values),) * 2).tocsr()
    for _ in range(ROUNDS):
        values = (values + average @ values) / 2
    return values
