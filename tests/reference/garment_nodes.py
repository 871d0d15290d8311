"""Garment nodes: affine handles, carried by bones and corrected (paper: Node-based Skinning for Garments)."""

import numpy as np


def pose_nodes(bones, node_bone, node_positions):
    """chi_skin (m, 3, 4): the rotation of the bone that a garment node follows, and where that carries it."""
    rotation, translation = bones[node_bone, :, :3], bones[node_bone, :, 3]
    return np.concatenate([rotation, (rotation @ node_positions[..., None]) + translation[..., None]], axis=2)


def correct_nodes(posed, corrections):
    """chi = chi_skin delta-chi (m, 3, 4). corrections (12 m,): of each garment node a linear part relative to the
    identity, row by row, and a translation."""
    numbers = corrections.reshape(len(posed), 12)
    delta = np.eye(3) + numbers[:, :9].reshape(-1, 3, 3)
    shifted = posed[:, :, :3] @ numbers[:, 9:, None] + posed[:, :, 3:]
    return np.concatenate([posed[:, :, :3] @ delta, shifted], axis=2)
