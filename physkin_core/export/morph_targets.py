"""What is added to rest vertices frame by frame, as glTF has it: an offset at rest and a few morph targets.

Dimensions: `T` frames, `v` vertices, `u` of them moved, `K` morph targets. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["MOST_TARGETS", "MorphTargets", "in_few_targets", "unskinned"]

MOST_TARGETS = 8
"""So many every glTF client should show."""
NEGLIGIBLE = 1e-4
"""[m] A target that moves no vertex farther is left out."""
STILL = 1e-6
"""[m] A vertex that skinning alone brings this close is not moved: floats are no more exact."""
DAMPING = 1e-3
"""Against the square of a stretch of 1: what skinning squeezes flat cannot be moved through that direction."""


@dataclass(frozen=True)
class MorphTargets:
    """moved: (u,) indices of vertices. offset: (u, 3) of these at rest. targets: (K, u, 3) what a weight of 1 adds;
    weights: (T, K) from -1 to 1. lacking: (T, u, 3) what is still to be added."""

    moved: np.ndarray
    offset: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    lacking: np.ndarray


def unskinned(rest: np.ndarray, matrices: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is to be added to rest vertices (v, 3) so that skinning them by matrices (v, 3, 4) gives those wanted
    (v, 3): indices (k,) of vertices where that is anything, and (k, 3)."""
    apart = wanted - np.einsum("vij,vj->vi", matrices[..., :3], rest) - matrices[..., 3]
    moved = np.flatnonzero(np.linalg.norm(apart, axis=1) > STILL)
    linear = matrices[moved, :, :3]
    squared = np.einsum("vji,vjk->vik", linear, linear) + DAMPING * np.eye(3)
    return moved, np.linalg.solve(squared, np.einsum("vji,vj->vi", linear, apart[moved])[..., None])[..., 0]


def in_few_targets(frames: Sequence[tuple[np.ndarray, np.ndarray]]) -> MorphTargets:
    """The offset and the targets that come closest to what is added in all frames: indices (k,) and (k, 3) of each, as
    of `unskinned`. The offset is the mean; targets are principal components of what is left."""
    moved = np.unique(np.concatenate([indices for indices, _ in frames]))
    added = np.zeros((len(frames), len(moved), 3))
    for frame, (indices, values) in zip(added, frames):
        frame[np.searchsorted(moved, indices)] = values
    offset = added.mean(axis=0)
    left = (added - offset).reshape(len(frames), -1)
    amounts, sizes, directions = np.linalg.svd(left, full_matrices=False)
    amounts = (amounts * sizes)[:, :MOST_TARGETS]
    targets = directions[:MOST_TARGETS].reshape(amounts.shape[1], len(moved), 3)
    most = np.abs(amounts).max(axis=0)
    reach = most * np.linalg.norm(targets, axis=2).max(axis=1, initial=0)
    worth = reach > NEGLIGIBLE
    weights, targets = amounts[:, worth] / most[worth], targets[worth] * most[worth, None, None]
    lacking = added - offset - np.einsum("tk,kui->tui", weights, targets)
    return MorphTargets(moved, offset, targets, weights, lacking)
