"""Poses of a skeleton whose bones are to lie as targets say: bounded Gauss-Newton steps, all frames of a clip at once.

Dimensions: `T` frames, `n` turns (rotations about one fixed axis each, parents first), `k` bones that follow targets.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["PoseSolver"]

BLOCK = 128
"""Frames solved together: bounds the memory."""


class PoseSolver:
    """Steps towards poses that bring bones where they should be.

    Args:
        parents: (n,) the turn before on the way from the root, -1 for none.
        axes: (n, 3) unit axes at rest.
        rest, lower, upper: (n,) [rad].
        followers: (k,) the last turn that moves each following bone.
        marks: (k, 3, 3) weighted axes of these bones at rest, in columns.
        rest_pull, smoothing: how hard a position is pulled to its rest, and to the mean of the frames before and after
            [1/rad]; a mark counts its length.
        longest_step: [rad].
    """

    def __init__(
        self,
        parents: Sequence[int],
        axes: np.ndarray,
        rest: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        followers: Sequence[int],
        marks: np.ndarray,
        *,
        rest_pull: float,
        smoothing: float,
        longest_step: float,
    ) -> None:
        self._parents, self._axes, self._marks = parents, axes, marks
        self._rest, self._lower, self._upper = rest, lower, upper
        self._to_rest, self._to_neighbours, self._longest = rest_pull**2, smoothing**2, longest_step
        self._followers = list(followers)
        self._cross = np.cross(np.eye(3), axes[:, None])[:, None]  # (n, 1, 3, 3)
        self._twice = self._cross @ self._cross
        self._below = np.eye(len(parents), dtype=bool)  # whether a turn (row) is another or follows on it
        for turn, parent in enumerate(parents):
            if parent >= 0:
                self._below[turn] |= self._below[parent]
        self._moves = self._below[self._followers].T.astype(np.float64)  # (n, k)
        first = self._below.argmax(axis=1)
        self._groups = [np.flatnonzero(first == root) for root in np.unique(first)]  # no two share a turn

    def step(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Positions (T, n) [rad] one step nearer to where the marks should be, targets (T, k, 3, 3)."""
        between = positions.copy()
        between[1:-1] = (positions[:-2] + positions[2:]) / 2
        there = np.empty_like(positions)
        for start in range(0, len(positions), BLOCK):
            at = slice(start, start + BLOCK)
            there[at] = self._stepped(targets[at], positions[at], between[at])
        return there

    def _stepped(self, targets: np.ndarray, here: np.ndarray, between: np.ndarray) -> np.ndarray:
        rotations, axes = self._posed(here)
        # Of the sum of |mark - target|^2 / 2 over the bones that a turn moves: torque (its gradient about any axis w is
        # w . torque) and curvature (Gauss-Newton's second derivative about axes v, w is v . curvature w).
        posed = rotations[:, self._followers] @ self._marks
        across = targets @ posed.swapaxes(2, 3)
        torques = np.stack([across[..., i, j] - across[..., j, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1)
        inertia = posed @ posed.swapaxes(2, 3)
        curvatures = np.trace(inertia, axis1=2, axis2=3)[..., None, None] * np.eye(3) - inertia
        torques, curvatures = self._moves @ torques, self._moves @ curvatures.reshape(*curvatures.shape[:2], 9)
        slope = (
            (axes * torques).sum(axis=2) + self._to_rest * (here - self._rest) + self._to_neighbours * (here - between)
        )
        free = np.where(slope > 0, here > self._lower, (here < self._upper) | (slope >= 0))
        bent = np.einsum("tnij,tnj->tni", curvatures.reshape(*axes.shape, 3), axes)
        step = np.where(free, -slope, 0.0)
        for group in self._groups:
            related, mine = self._below[np.ix_(group, group)], free[:, group]
            normal = (bent[:, group] @ axes[:, group].swapaxes(1, 2)) * (related & mine[:, :, None] & mine[:, None])
            normal += normal.swapaxes(1, 2) * ~related
            diagonal = np.arange(len(group))
            normal[:, diagonal, diagonal] += np.where(mine, self._to_rest + self._to_neighbours, 1.0)
            step[:, group] = np.linalg.solve(normal, step[:, group, None])[..., 0]
        step *= self._longest / np.maximum(np.abs(step).max(axis=1, keepdims=True), self._longest)
        return np.clip(here + step, self._lower, self._upper)

    def _posed(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (T, n, 3, 3) of all turns from rest, and their axes then (T, n, 3)."""
        angles = (positions - self._rest).T[..., None, None]
        own = np.eye(3) + np.sin(angles) * self._cross + (1 - np.cos(angles)) * self._twice
        rotations = np.empty_like(own)
        for turn, parent in enumerate(self._parents):
            rotations[turn] = rotations[parent] @ own[turn] if parent >= 0 else own[turn]
        axes = np.einsum("ntij,nj->nti", rotations, self._axes)  # a turn leaves its own axis where it is
        return rotations.swapaxes(0, 1), axes.swapaxes(0, 1)
