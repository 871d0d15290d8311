"""Poses that follow targets: a step is Gauss-Newton's within limits, as a slow and plain computation has it."""

import numpy as np
import pytest
from random_models import random_rig

from physkin_core.motion.pose_solver import BLOCK, MAX_STEP, PULL, SMOOTHING, PoseSolver


class Problem:
    """A random rig, some of its bones that follow, and targets of `frames` frames."""

    def __init__(self, seed, *, bones=6, dofs=9, followers=4, frames=5):
        rng = np.random.default_rng(seed)
        self.rig = random_rig(rng, bones=bones, dofs=dofs)
        moved = [bone for bone in range(bones) if np.isin(self.rig.ancestors(bone), self.rig.dof_bones).any()]
        self.bones = rng.choice(moved, followers).tolist()
        self.axes, self.targets = rng.normal(size=(followers, 3, 3)), rng.normal(size=(frames, followers, 3, 3))
        self.solver = PoseSolver(self.rig, self.bones, self.axes)
        self.rest, self.lower, self.upper = (
            of[self.solver.dofs] for of in (self.rig.rest, self.rig.lower, self.rig.upper)
        )
        self.positions = rng.uniform(self.lower, self.upper, (frames, len(self.solver.dofs)))
        self.positions[:, ::3] = np.where(
            rng.random(self.positions[:, ::3].shape) < 0.5, self.lower[::3], self.upper[::3]
        )

    def residual(self, q, between, targets):
        positions = self.rig.rest.copy()
        positions[self.solver.dofs] = q
        missed = self.rig.bone_transforms(positions)[self.bones, :, :3] @ self.axes - targets
        return np.concatenate([missed.ravel(), PULL * (q - self.rest), SMOOTHING * (q - between)])

    def expected(self, frame):
        """The step of one frame, of differences of the residual."""
        q = self.positions[frame]
        inner = 0 < frame < len(self.positions) - 1
        between = (self.positions[frame - 1] + self.positions[frame + 1]) / 2 if inner else q
        values = [self.residual(q + nudge, between, self.targets[frame]) for nudge in (*np.eye(len(q)) * 1e-6, 0)]
        jacobian = (np.stack(values[:-1], axis=1) - values[-1][:, None]) / 1e-6
        slope = jacobian.T @ values[-1]
        free = ~(((q <= self.lower) & (slope > 0)) | ((q >= self.upper) & (slope < 0)))
        step = np.zeros_like(q)
        step[free] = np.linalg.lstsq(jacobian[:, free], -values[-1], rcond=None)[0]
        return np.clip(q + step * min(1.0, MAX_STEP / np.abs(step).max()), self.lower, self.upper)


@pytest.mark.parametrize("frames", [1, 2, 5])
@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_gauss_newtons(seed, frames):
    """On random trees, with joints on their limits, steps that are too long, and clips without a frame between two
    others. The expected step is of one-sided differences, whose error is of the size of their 1e-6."""
    problem = Problem(seed, frames=frames)
    expected = [problem.expected(frame) for frame in range(frames)]
    np.testing.assert_allclose(problem.solver.step(problem.targets, problem.positions), expected, atol=1e-4)


def test_frames_that_are_solved_apart_know_their_neighbours():
    """A clip is solved some frames at a time; where the parts meet makes no difference."""
    problem = Problem(1, frames=BLOCK + 2)
    found = problem.solver.step(problem.targets, problem.positions)
    for frame in (BLOCK - 1, BLOCK):
        np.testing.assert_allclose(found[frame], problem.expected(frame), atol=1e-4)


def test_targets_are_reached():
    """Steps lead to a pose that made the targets, but for the pull to rest."""
    problem = Problem(2, bones=5, dofs=5, followers=5, frames=1)
    pose = (2 * np.clip(problem.rest, problem.lower, problem.upper) + problem.lower + problem.upper) / 4
    made = problem.residual(pose, pose, 0)[: problem.targets.size].reshape(problem.targets.shape)
    positions = np.tile(problem.rest, (1, 1))
    for _ in range(30):
        positions = problem.solver.step(made, positions)
    np.testing.assert_allclose(problem.residual(positions[0], positions[0], made[0])[: made.size], 0, atol=0.01)
