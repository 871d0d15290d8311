"""Affine transforms as chains of two joints, each with a translation, a rotation and a scale, as files of animation
have them.

A linear part is rotation times stretch, L = R P (polar decomposition), and the stretch P = Q diag(s) Q^T: so a joint
turned by R Q and scaled by s, and in it a joint turned by Q^T, make up L exactly.
Dimensions: `T` frames, `j` joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

__all__ = ["JointChains", "as_joint_chains"]

TURNS = Rotation.create_group("O").as_matrix().round()
"""(24, 3, 3) rotations that carry the axes to axes: other names of the same stretch."""


@dataclass(frozen=True)
class JointChains:
    """Outer joints: translation (T, j, 3), rotation (T, j, 4) and scale (T, j, 3); inner joints: inner_rotation
    (T, j, 4). Unit quaternions x, y, z, w, of one sign from frame to frame."""

    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    inner_rotation: np.ndarray


def as_joint_chains(transforms: np.ndarray) -> JointChains:
    """Chains of two joints that make up affine transforms (T, j, 3, 4). Where one mirrors, its smallest stretch is
    negative.

    Axes of stretch are named so that they turn as little as possible from frame to frame: between frames, too, the
    chain is then close to the transforms.
    """
    left, stretch, right = np.linalg.svd(transforms[..., :3].astype(np.float64))
    turned = np.linalg.det(right) < 0
    right[turned] *= -1
    left[turned] *= -1
    mirrors = np.linalg.det(left) < 0
    left[mirrors, :, 2] *= -1
    stretch[mirrors, 2] *= -1
    axes = np.swapaxes(right, -1, -2).copy()
    rotation = left @ right
    for frame in range(1, len(axes)):
        match = np.einsum("jab,kbc,jac->jk", axes[frame], TURNS, axes[frame - 1])
        best = TURNS[match.argmax(axis=1)]
        axes[frame] = axes[frame] @ best
        stretch[frame] = np.einsum("jb,jbc->jc", stretch[frame], np.abs(best))
    return JointChains(
        translation=transforms[..., 3],
        rotation=_quaternions(rotation @ axes),
        scale=stretch,
        inner_rotation=_quaternions(np.swapaxes(axes, -1, -2)),
    )


def _quaternions(matrices: np.ndarray) -> np.ndarray:
    """Of rotations (T, j, 3, 3); the shorter way from each frame to the next."""
    quaternions = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat().reshape(*matrices.shape[:2], 4)
    agree = np.einsum("tjq,tjq->tj", quaternions[1:], quaternions[:-1]) >= 0
    flips = np.cumprod(np.where(agree, 1.0, -1.0), axis=0)
    quaternions[1:] *= flips[..., None]
    return quaternions
