"""Ball joints: a rotation to the degrees of freedom that the rig has there, or three angles that compose to one.

Seen in the rig's own axes the rotation is taken apart, into rotations about those axes in the rig's order; where the
rig shares a limb's twist among two bones, the second gets half. What the rig has no joint for is left out. All ball
joints of a message are computed at once. Dimensions: `L` ball joints. Radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["BallJoint", "BallJoints", "BallRotations"]

UPRIGHT = 1e-7  # cosine of the middle angle below which the outer two are one


@dataclass(frozen=True)
class BallJoint:
    """One ball joint.

    axes: (3, 3) rows are the unit axes the incoming angles turn about, outermost first, root frame. Of no account where
        rotations come in.
    before, after: (3, 3) rotations; the rig's bone turns by before @ (incoming rotation) @ after from its canonical
        pose, as seen from its parent.
    frame: (3, 3) columns are the rig's axes in the order it turns about them; they may be left-handed.
    joints: rig joint for each column of `frame`, "" where the rig has none; then, optionally, the joint that takes half
        of the rotation about column `twist`.
    """

    axes: np.ndarray
    before: np.ndarray
    after: np.ndarray
    frame: np.ndarray
    joints: tuple[str, ...]
    twist: int | None = None


class BallRotations:
    """Rotations of ball joints to joint positions of the rig. index: of each rig joint."""

    def __init__(self, balls: Sequence[BallJoint], index: Mapping[str, int]) -> None:
        self._before = np.array([ball.frame.T @ ball.before for ball in balls])
        self._after = np.array([ball.after @ ball.frame for ball in balls])
        signs = np.array([np.sign(np.linalg.det(ball.frame)) for ball in balls])
        twist = np.zeros((len(balls), 3))
        for row, ball in enumerate(balls):
            if ball.twist is not None:
                twist[row, ball.twist] = 0.5
        self._twist = twist if twist.any() else None
        self._twist_axis = _Axes(np.array([_cross(2 * row) for row in twist]))
        slots = [(row, slot, joint) for row, ball in enumerate(balls) for slot, joint in enumerate(ball.joints)]
        slots = [(4 * row + slot, index[joint], signs[row], row) for row, slot, joint in slots if joint]
        self._slot, self.targets, self._sign, self.owners = (np.array(column) for column in zip(*slots))

    def solve(self, rotations: np.ndarray, positions: np.ndarray) -> None:
        """Write the rig's joints `targets` into `positions` (d,), each from the row `owners` of rotations (L, 3, 3)."""
        turn = self._before @ rotations @ self._after
        found = np.zeros((len(turn), 4))
        _three_angles(turn, found)
        if self._twist is not None:
            half = (found[:, :3] * self._twist).sum(axis=1)
            _three_angles(turn @ self._twist_axis.turn(-half[:, None, None]), found)
            found[:, 3] = half
        positions[self.targets] = self._sign * found.ravel()[self._slot]


class BallJoints:
    """The ball joints of one set of names.

    balls: each with the indices of its three angles among a message's values, -1 for zero. index: of each rig joint.
    sources: indices of all values that are read.
    """

    def __init__(self, balls: Sequence[tuple[BallJoint, tuple[int, int, int]]], index: Mapping[str, int]) -> None:
        named = np.array([sources for _, sources in balls], dtype=np.intp)
        self.sources = np.unique(named[named >= 0])
        self._named = named.T[:, :, None, None].clip(min=0)  # (3, L, 1, 1)
        self._given = (named.T >= 0)[:, :, None, None].astype(np.float64)
        self._all_given = bool(self._given.all())
        self._axes = _Axes(np.array([[_cross(axis) for axis in ball.axes] for ball, _ in balls]).transpose(1, 0, 2, 3))
        self._rotations = BallRotations([ball for ball, _ in balls], index)

    def gather(self, values: np.ndarray) -> np.ndarray:
        """The incoming angles (3, L, 1, 1)."""
        angles = values[self._named]
        return angles if self._all_given else np.where(self._given, angles, 0.0)

    def targets_without(self, angles: np.ndarray) -> np.ndarray:
        """Which rig joints an angle that is not finite leaves undetermined: all of its ball joint."""
        lost = ~np.isfinite(angles).all(axis=(0, 2, 3))
        return self._rotations.targets[lost[self._rotations.owners]]

    def solve(self, angles: np.ndarray, positions: np.ndarray) -> None:
        """Write the rig's joints into `positions` (d,)."""
        first, second, third = self._axes.turn(angles)
        self._rotations.solve(first @ second @ third, positions)


class _Axes:
    """Rotations about fixed axes, by Rodrigues' formula. cross: (..., 3, 3) the axes' cross matrices."""

    def __init__(self, cross: np.ndarray) -> None:
        self._cross, self._twice = cross, cross @ cross
        self._constant = np.eye(3) + self._twice

    def turn(self, angles: np.ndarray) -> np.ndarray:
        """Rotations (..., 3, 3) by angles (..., 1, 1)."""
        return self._constant + np.sin(angles) * self._cross - np.cos(angles) * self._twice


OUTER_OVER, OUTER_UNDER = np.array([5, 1]), np.array([8, 0])  # elements of a rotation, row by row


def _three_angles(turn: np.ndarray, out: np.ndarray) -> None:
    """Write angles about X, Y and Z, composed in that order, of rotations (L, 3, 3) into out[:, :3].

    Where the middle angle is a right angle, the outer two turn about one axis: the first takes it all.
    """
    flat = turn.reshape(-1, 9)
    out[:, 0:3:2] = np.arctan2(-flat[:, OUTER_OVER], flat[:, OUTER_UNDER])
    middle = flat[:, 2]
    out[:, 1] = np.arcsin(np.minimum(np.maximum(middle, -1.0), 1.0))
    apart = np.hypot(flat[:, 0], flat[:, 1]) > UPRIGHT
    if not apart.all():
        one = ~apart
        out[one, 0] = np.arctan2(flat[one, 7], flat[one, 4])
        out[one, 2] = 0.0


def _cross(axis: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of the cross product with `axis`."""
    x, y, z = axis
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=np.float64)
