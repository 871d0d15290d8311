"""Ball joints: three angles of another skeleton's joint to the degrees of freedom that the rig has there.

The incoming angles compose to a rotation. Seen in the rig's own axes it is taken apart anew, into rotations about those
axes in the rig's order; where the rig shares a limb's twist among two bones, the second gets half. All ball joints of a
message are computed at once. Dimensions: `L` ball joints. Radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["BallJoint", "BallJoints"]

UPRIGHT = 1e-7  # cosine of the middle angle below which the outer two are one


@dataclass(frozen=True)
class BallJoint:
    """One ball joint.

    axes: (3, 3) rows are the unit axes the incoming angles turn about, outermost first, root frame.
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
        cross = np.array([[_cross(axis) for axis in ball.axes] for ball, _ in balls]).transpose(1, 0, 2, 3)
        self._cross, self._cross_twice = cross, cross @ cross  # (3, L, 3, 3)
        self._before = np.array([ball.frame.T @ ball.before for ball, _ in balls])
        self._after = np.array([ball.after @ ball.frame for ball, _ in balls])
        signs = np.array([np.sign(np.linalg.det(ball.frame)) for ball, _ in balls])
        twist = np.zeros((len(balls), 3))
        for row, (ball, _) in enumerate(balls):
            if ball.twist is not None:
                twist[row, ball.twist] = 0.5
        self._twist = twist if twist.any() else None
        self._twist_axis = np.array([_cross(2 * row) for row in twist])
        self._twist_axis_twice = self._twist_axis @ self._twist_axis
        slots = [(row, slot, joint) for row, (ball, _) in enumerate(balls) for slot, joint in enumerate(ball.joints)]
        slots = [(4 * row + slot, index[joint], signs[row]) for row, slot, joint in slots if joint]
        self._slot = np.array([slot for slot, _, _ in slots])
        self._target = np.array([target for _, target, _ in slots])
        self._sign = np.array([sign for _, _, sign in slots])

    def gather(self, values: np.ndarray) -> np.ndarray:
        """The incoming angles (3, L, 1, 1)."""
        return np.where(self._given, values[self._named], 0.0)

    def solve(self, angles: np.ndarray, positions: np.ndarray) -> None:
        """Write the rig's joints into `positions` (d,)."""
        first, second, third = _turn(self._cross, self._cross_twice, angles)
        turn = self._before @ first @ second @ third @ self._after
        found = np.zeros((len(turn), 4))
        found[:, :3] = _three_angles(turn)
        if self._twist is not None:
            half = (found[:, :3] * self._twist).sum(axis=1)
            turn = turn @ _turn(self._twist_axis, self._twist_axis_twice, -half[:, None, None])
            found[:, :3] = _three_angles(turn)
            found[:, 3] = half
        positions[self._target] = self._sign * found.ravel()[self._slot]


def _turn(cross: np.ndarray, cross_twice: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: rotations (..., 3, 3) by angles (..., 1, 1) about axes given by their cross matrices."""
    return np.eye(3) + np.sin(angles) * cross + (1 - np.cos(angles)) * cross_twice


def _three_angles(turn: np.ndarray) -> np.ndarray:
    """Angles (L, 3) about X, Y and Z, composed in that order, of rotations (L, 3, 3).

    Where the middle angle is a right angle, the outer two turn about one axis: the first takes it all.
    """
    middle = np.arcsin(np.clip(turn[:, 0, 2], -1, 1))
    apart = np.hypot(turn[:, 0, 0], turn[:, 0, 1]) > UPRIGHT
    first = np.where(apart, np.arctan2(-turn[:, 1, 2], turn[:, 2, 2]), np.arctan2(turn[:, 2, 1], turn[:, 1, 1]))
    third = np.where(apart, np.arctan2(-turn[:, 0, 1], turn[:, 0, 0]), 0.0)
    return np.stack([first, middle, third], axis=1)


def _cross(axis: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of the cross product with `axis`."""
    x, y, z = axis
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=np.float64)
