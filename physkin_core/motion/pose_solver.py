"""Poses of a rig whose bones are to lie as targets say: bounded Gauss-Newton steps, all frames of a clip at once.

Dimensions: `T` frames, `n` turns (the rig's degrees of freedom that are solved for, parents first), `k` bones that
follow targets.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.progress import Watch
from physkin_core.rig.rig import Rig

__all__ = ["PoseSolver"]

PULL = 0.03  # towards the canonical pose [1/rad]; a bone's axis counts its length
SMOOTHING = 0.3  # towards the mean of the frames before and after [1/rad]
MAX_STEP = 0.4  # [rad] a step
BLOCK = 128  # frames solved together: bounds the memory
STRIDE = 4  # frames of a clip that is solved first, which is faster and smoother
ITERATIONS = 30, 15  # of these, and then of all frames


class PoseSolver:
    """Steps towards poses that bring bones where they should be.

    bones: (k,) indices of the bones that follow, which joints move. axes: (k, 3, 3) their weighted axes at rest, in
    columns. still: how the names of bones begin that stay at rest. dofs: (n,) indices of the degrees of freedom that
    are solved for.
    """

    def __init__(self, rig: Rig, bones: Sequence[int], axes: np.ndarray, *, still: tuple[str, ...] = ()) -> None:
        self._rig = rig
        self.dofs: list[int] = []
        self._parents: list[int] = []  # the turn before on the way from the root, -1 for none
        last = {-1: -1}  # the last turn that moves a bone
        for bone in sorted({above for each in bones for above in rig.ancestors(each)}):
            last[bone] = last[int(rig.parents[bone])]
            for dof in np.flatnonzero(rig.dof_bones == bone).tolist():
                if not rig.bone_names[bone].startswith(still):
                    self._parents.append(last[bone])
                    last[bone] = len(self.dofs)
                    self.dofs.append(dof)
        self._marks, self._followers = axes, [last[bone] for bone in bones]
        self._axes, self._rest = rig.dof_axes[self.dofs], rig.rest[self.dofs]
        self._lower, self._upper = rig.lower[self.dofs], rig.upper[self.dofs]
        self._cross = np.cross(np.eye(3), self._axes[:, None])[:, None]  # (n, 1, 3, 3)
        self._twice = self._cross @ self._cross
        self._below = np.eye(len(self.dofs), dtype=bool)  # whether a turn (row) is another or follows on it
        for turn, parent in enumerate(self._parents):
            if parent >= 0:
                self._below[turn] |= self._below[parent]
        self._moves = self._below[self._followers].T.astype(np.float64)  # (n, k)
        first = self._below.argmax(axis=1)
        self._groups = [np.flatnonzero(first == root) for root in np.unique(first)]  # no two share a turn

    def solve(self, targets: np.ndarray, watch: Watch = lambda share: None) -> np.ndarray:
        """Positions (T, d) [rad] of the rig, from rest, for targets (T, k, 3, 3) of the axes. watch: told the share
        done, 0 to 1, after every iteration."""
        found = np.tile(np.clip(self._rig.rest, self._rig.lower, self._rig.upper), (len(targets), 1))
        frames, here = np.arange(len(targets)), found[::STRIDE, self.dofs]
        for done in range(sum(ITERATIONS)):
            if done == ITERATIONS[0]:
                here = np.stack([np.interp(frames, frames[::STRIDE], turn) for turn in here.T], axis=1)
            here = self.step(targets[::STRIDE] if done < ITERATIONS[0] else targets, here)
            watch((done + 1) / sum(ITERATIONS))
        found[:, self.dofs] = here
        return found

    def step(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Positions (T, n) [rad] one step nearer to where the axes should be, targets (T, k, 3, 3)."""
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
        slope = (axes * torques).sum(axis=2) + PULL**2 * (here - self._rest) + SMOOTHING**2 * (here - between)
        free = np.where(slope > 0, here > self._lower, (here < self._upper) | (slope >= 0))
        bent = np.einsum("tnij,tnj->tni", curvatures.reshape(*axes.shape, 3), axes)
        step = np.where(free, -slope, 0.0)
        for group in self._groups:
            related, mine = self._below[np.ix_(group, group)], free[:, group]
            normal = (bent[:, group] @ axes[:, group].swapaxes(1, 2)) * (related & mine[:, :, None] & mine[:, None])
            normal += normal.swapaxes(1, 2) * ~related
            diagonal = np.arange(len(group))
            normal[:, diagonal, diagonal] += np.where(mine, PULL**2 + SMOOTHING**2, 1.0)
            step[:, group] = np.linalg.solve(normal, step[:, group, None])[..., 0]
        step *= MAX_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), MAX_STEP)
        return np.clip(here + step, self._lower, self._upper)

    def _posed(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (T, n, 3, 3) of all turns from rest, and their axes then (T, n, 3)."""
        angles = (positions - self._rest).T[..., None, None]
        rotations = np.eye(3) + np.sin(angles) * self._cross + (1 - np.cos(angles)) * self._twice
        for turn, parent in enumerate(self._parents):
            if parent >= 0:
                rotations[turn] = rotations[parent] @ rotations[turn]
        axes = np.einsum("ntij,nj->nti", rotations, self._axes)  # a turn leaves its own axis where it is
        return rotations.swapaxes(0, 1), axes.swapaxes(0, 1)
