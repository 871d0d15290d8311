"""Poses that follow targets: a step is Gauss-Newton's within limits, as a slow and plain computation has it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.motion.pose_solver import BLOCK, PoseSolver

PULL, SMOOTHING, LONGEST = 0.03, 0.3, 0.4


class Problem:
    """A random tree of turns, some moving followers, and targets of `frames` frames."""

    def __init__(self, rng, *, turns=9, followers=4, frames=5):
        self.parents = [int(rng.integers(-1, k)) if k else -1 for k in range(turns)]
        self.axes = rng.normal(size=(turns, 3))
        self.axes /= np.linalg.norm(self.axes, axis=1, keepdims=True)
        self.rest, self.lower, self.upper = rng.normal(size=turns) * 0.1, np.full(turns, -0.5), np.full(turns, 0.7)
        self.followers = rng.integers(0, turns, followers).tolist()
        self.marks = rng.normal(size=(followers, 3, 3))
        self.targets = rng.normal(size=(frames, followers, 3, 3))
        self.positions = rng.uniform(self.lower, self.upper, (frames, turns))
        self.positions[:, ::3] = rng.choice([-0.5, 0.7], self.positions[:, ::3].shape)  # on a limit

    def step(self):
        limits = self.rest, self.lower, self.upper
        pulls = {"rest_pull": PULL, "smoothing": SMOOTHING, "longest_step": LONGEST}
        solver = PoseSolver(self.parents, self.axes, *limits, self.followers, self.marks, **pulls)
        return solver.step(self.targets, self.positions)

    def residual(self, q, between, targets):
        turned = []
        for k, parent in enumerate(self.parents):
            turn = Rotation.from_rotvec(self.axes[k] * (q[k] - self.rest[k]))
            turned.append(turn if parent < 0 else turned[parent] * turn)
        missed = [turned[k].as_matrix() @ mark - target for k, mark, target in zip(self.followers, self.marks, targets)]
        return np.concatenate([np.ravel(missed), PULL * (q - self.rest), SMOOTHING * (q - between)])

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
        return np.clip(q + step * min(1.0, LONGEST / np.abs(step).max()), self.lower, self.upper)


@pytest.mark.parametrize("frames", [1, 2, 5])
@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_gauss_newtons(seed, frames):
    """On random trees, with joints on their limits, steps that are too long, and clips without a frame between two
    others. The expected step is of one-sided differences, whose error is of the size of their 1e-6."""
    problem = Problem(np.random.default_rng(seed), frames=frames)
    expected = [problem.expected(frame) for frame in range(frames)]
    np.testing.assert_allclose(problem.step(), expected, atol=1e-4)


def test_frames_that_are_solved_apart_know_their_neighbours():
    """A clip is solved some frames at a time; where the parts meet makes no difference."""
    problem = Problem(np.random.default_rng(1), turns=3, followers=2, frames=BLOCK + 2)
    found = problem.step()
    for frame in (BLOCK - 1, BLOCK):
        np.testing.assert_allclose(found[frame], problem.expected(frame), atol=1e-4)


def test_targets_are_reached():
    """Within limits, steps lead to a pose that made the targets, but for the pull to rest."""
    problem = Problem(np.random.default_rng(2), turns=5, followers=5)
    problem.followers = list(range(5))
    pose = np.random.default_rng(3).uniform(-0.3, 0.5, (1, 5))
    zero = problem.residual(pose[0], pose[0], np.zeros((5, 3, 3)))[:45].reshape(5, 3, 3)
    problem.targets, problem.positions = zero[None], np.zeros((1, 5))
    for _ in range(30):
        problem.positions = problem.step()
    np.testing.assert_allclose(problem.positions, pose, atol=0.01)
