"""Poses that follow targets: a step is Gauss-Newton's within limits, as a slow and plain computation has it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.native_module import native

PULLS = [0.03, 0.3, 0.4]  # to rest, to neighbours [1/rad]; longest step [rad]


class Problem:
    """A random tree of `turns`, some moving followers, and targets of `frames` frames."""

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

    def solver(self):
        turns = np.column_stack([self.axes, self.rest, self.lower, self.upper]).tolist()
        return native.PoseSolver(self.parents, turns, self.followers, self.marks.reshape(-1, 9).tolist(), PULLS)

    def step(self):
        next_positions = np.full_like(self.positions, np.nan)
        self.solver().step(self.targets, self.positions, next_positions)
        return next_positions

    def residual(self, q, between, targets):
        turned = []
        for k, parent in enumerate(self.parents):
            turn = Rotation.from_rotvec(self.axes[k] * (q[k] - self.rest[k]))
            turned.append(turn if parent < 0 else turned[parent] * turn)
        missed = [turned[k].as_matrix() @ mark - target for k, mark, target in zip(self.followers, self.marks, targets)]
        return np.concatenate([np.ravel(missed), PULLS[0] * (q - self.rest), PULLS[1] * (q - between)])

    def expected(self):
        frames = []
        for t, q in enumerate(self.positions):
            inner = 0 < t < len(self.positions) - 1
            between = (self.positions[t - 1] + self.positions[t + 1]) / 2 if inner else q
            value = self.residual(q, between, self.targets[t])
            nudges = 1e-6 * np.eye(len(q))
            columns = [
                (
                    self.residual(q + nudge, between, self.targets[t])
                    - self.residual(q - nudge, between, self.targets[t])
                )
                for nudge in nudges
            ]
            jacobian = np.stack(columns, axis=1) / 2e-6
            slope = jacobian.T @ value
            free = ~(((q <= self.lower) & (slope > 0)) | ((q >= self.upper) & (slope < 0)))
            step = np.zeros_like(q)
            step[free] = np.linalg.lstsq(jacobian[:, free], -value, rcond=None)[0]
            step *= min(1.0, PULLS[2] / np.abs(step).max())
            frames.append(np.clip(q + step, self.lower, self.upper))
        return np.array(frames)


@pytest.mark.parametrize("seed", range(12))
def test_a_step_is_gauss_newtons(seed):
    """On random trees, with joints on their limits and steps that are too long."""
    problem = Problem(np.random.default_rng(seed))
    np.testing.assert_allclose(problem.step(), problem.expected(), atol=1e-6)


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_short_clips(frames):
    """Have no frame between two others."""
    problem = Problem(np.random.default_rng(1), frames=frames)
    np.testing.assert_allclose(problem.step(), problem.expected().reshape(frames, 9), atol=1e-6)


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


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("parents", [-1, 1, 0, 0, 0, 0, 0, 0, 0], "turn 1 has parent 1; a parent comes before"),
        ("parents", [-2] * 9, "turn 0 has parent -2"),
        ("parents", [-1] * 8, "a turn needs a parent and 6 numbers"),
        ("followers", [0, 0, 0, 9], "a follower has turn 9; there are 9"),
        ("followers", [0, 0, 0], "a follower a turn and 9"),
        ("targets", np.zeros((5, 3, 3, 3)), r"targets \(frames, 4, 3, 3\)"),
        ("positions", np.zeros((4, 9)), r"must be \(frames, 9\)"),
        ("positions", np.zeros((5, 8)), r"must be \(frames, 9\)"),
    ],
)
def test_what_does_not_fit_is_refused(field, value, message):
    problem = Problem(np.random.default_rng(0))
    setattr(problem, field, value)
    with pytest.raises(ValueError, match=message):
        problem.step()
