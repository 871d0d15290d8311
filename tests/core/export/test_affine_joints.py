"""Affine transforms as chains of two joints."""

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.export.affine_joints import as_joint_chains

RANDOM = np.random.default_rng(3)


def moving(frames, joints, *, mirrored=False):
    """(T, j, 3, 4) affine transforms that change a little from frame to frame."""
    start = np.eye(3) + 0.3 * RANDOM.normal(size=(joints, 3, 3))
    start[np.linalg.det(start) < 0, :, 0] *= -1
    if mirrored:
        start[:, :, 1] *= -1
    linear = start + np.cumsum(0.02 * RANDOM.normal(size=(frames, joints, 3, 3)), axis=0)
    return np.concatenate([linear, RANDOM.normal(size=(frames, joints, 3, 1))], axis=-1)


def composed(chains):
    """(T, j, 3, 4) what the joints make up, as a reader of the file computes it."""

    def matrices(quaternions):
        return Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix().reshape(*quaternions.shape[:2], 3, 3)

    linear = matrices(chains.rotation) * chains.scale[..., None, :] @ matrices(chains.inner_rotation)
    return np.concatenate([linear, chains.translation[..., None]], axis=-1)


def test_chains_make_up_the_transforms():
    """To rounding, mirrored ones and singular ones too."""
    for transforms in (moving(6, 9), moving(6, 9, mirrored=True), np.zeros((2, 3, 3, 4))):
        np.testing.assert_allclose(composed(as_joint_chains(transforms)), transforms, atol=1e-12)


def test_chains_turn_no_more_than_the_transforms_do():
    """Axes of stretch keep their names and quaternions their sign, so that a reader may interpolate between frames."""
    transforms = moving(40, 20)
    chains = as_joint_chains(transforms)
    apart = np.abs(np.linalg.svd(transforms[..., :3], compute_uv=False) @ [[1, 0], [-1, 1], [0, -1]]).min(axis=(0, 2))
    clear = apart > 0.1  # where two stretches are alike, their axes may turn at will
    assert clear.sum() > 3
    for quaternions in (chains.rotation, chains.inner_rotation):
        assert np.abs(np.diff(quaternions[:, clear], axis=0)).max() < 0.3
