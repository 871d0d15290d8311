"""What is added to rest vertices frame by frame, as glTF has it: an offset at rest and a few morph targets.

Dimensions: `T` frames, `v` vertices, `u` of them moved, `K` morph targets. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

__all__ = ["MOST_TARGETS", "MorphTargets", "in_few_targets", "unskinned"]

MOST_TARGETS = 32
ENOUGH = 0.004
"""[m] No more targets where every vertex is this close, at rest, to where it should be."""
STILL = 1e-6
"""[m] A vertex that skinning alone brings this close is not moved: floats are no more exact."""
DAMPING = 1e-3
"""Against the square of a stretch of 1: what skinning squeezes flat cannot be moved through that direction."""


@dataclass(frozen=True)
class MorphTargets:
    """moved: (u,) indices of vertices. targets: (K, u, 3) what a weight of 1 adds to these. weights: (T, K) from 0 to
    1, as Blender wants them; resting: (K,) those that make up the mean. turns: (K, u, 3) what a weight of 1 adds to
    normals, where these are to change."""

    moved: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    resting: np.ndarray
    turns: np.ndarray | None = None

    def with_turns(self, normals: np.ndarray, wanted: np.ndarray) -> MorphTargets:
        """The same with those turns that bring normals (u, 3) of the offset vertices closest to the ones wanted in each
        frame, (T, u, 3), before skinning."""
        apart = (wanted - normals).reshape(len(wanted), -1)
        turns = np.linalg.lstsq(self.weights, apart, rcond=None)[0].reshape(self.targets.shape)
        return replace(self, turns=turns)

    def of_vertices(self, vertices: np.ndarray) -> MorphTargets:
        """The same for vertices (w,) of these, some repeated."""
        moved = np.flatnonzero(np.isin(vertices, self.moved))
        of = np.searchsorted(self.moved, vertices[moved])
        turns = None if self.turns is None else self.turns[:, of]
        return replace(self, moved=moved, targets=self.targets[:, of], turns=turns)


def unskinned(rest: np.ndarray, matrices: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(v, 3) what is to be added to rest vertices (v, 3) so that skinning them by matrices (v, 3, 4) gives those wanted
    (v, 3); 0 where they are there already."""
    apart = wanted - np.einsum("vij,vj->vi", matrices[..., :3], rest) - matrices[..., 3]
    moved = np.flatnonzero(np.linalg.norm(apart, axis=1) > STILL)
    linear = matrices[moved, :, :3]
    squared = np.einsum("vji,vjk->vik", linear, linear) + DAMPING * np.eye(3)
    added = np.zeros_like(apart)
    added[moved] = np.linalg.solve(squared, np.einsum("vji,vj->vi", linear, apart[moved])[..., None])[..., 0]
    return added


def in_few_targets(added: np.ndarray, share: int = 1) -> tuple[MorphTargets, np.ndarray, np.ndarray]:
    """As few targets, at most `share` times `MOST_TARGETS`, as come close to what is added to vertices in all frames,
    (T, v, 3), as of `unskinned`; besides them an offset (u, 3) at rest; and what is still lacking, (T, u, 3). Targets
    are principal components of what is not the mean."""
    moved = np.flatnonzero(added.any(axis=(0, 2)))
    added = added[:, moved]
    mean = added.mean(axis=0)
    lacking = added - mean
    flat = lacking.reshape(len(added), -1)
    amounts = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]  # frames are fewer than coordinates
    count, directions = 0, np.empty((min(share * MOST_TARGETS, len(added)), *mean.shape))
    while count < len(directions) and np.linalg.norm(lacking, axis=2).max(initial=0) > ENOUGH:
        directions[count] = np.tensordot(amounts[:, count], lacking, 1)
        lacking -= amounts[:, count, None, None] * directions[count]
        count += 1
    amounts, directions = amounts[:, :count], directions[:count]
    least, spans = amounts.min(axis=0), np.ptp(amounts, axis=0)
    morphs = MorphTargets(moved, directions * spans[:, None, None], (amounts - least) / spans, -least / spans)
    return morphs, mean + np.einsum("k,kui->ui", least, directions), lacking
