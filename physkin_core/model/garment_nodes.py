"""Garment nodes: affine handles on the garment, posed by the body's bones and corrected by the node deformer.

Paper: Node-based Skinning for Garments. Dimensions: `m` garment nodes, `b` bones. Metres, root frame.
"""

from __future__ import annotations

import numpy as np

__all__ = ["closest_bones", "node_positions_on_body", "pose_nodes"]


def closest_bones(points: np.ndarray, heads: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """Index of the bone (segment head to tail) closest to each point (m, 3). Returns (m,) int32."""
    axis = tails - heads
    length_squared = np.maximum((axis * axis).sum(axis=1), 1e-12)
    along = np.einsum("mbi,bi->mb", points[:, None] - heads, axis) / length_squared
    nearest = heads + np.clip(along, 0, 1)[..., None] * axis
    return np.linalg.norm(points[:, None] - nearest, axis=-1).argmin(axis=1).astype(np.int32)


def node_positions_on_body(
    node_rest: np.ndarray,
    node_bone: np.ndarray,
    garment_bones: tuple[np.ndarray, np.ndarray],
    body_bones: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Carry garment nodes from the garment maker's body to another body, both at the canonical pose.

    Each node keeps its offset from its bone's head, scaled by the ratio of bone lengths.
    node_rest: (m, 3). node_bone: (m,). garment_bones, body_bones: heads (b, 3) and tails (b, 3). Returns (m, 3).
    """
    (garment_heads, garment_tails), (heads, tails) = garment_bones, body_bones
    garment_length = np.linalg.norm(garment_tails - garment_heads, axis=1)
    ratio = np.linalg.norm(tails - heads, axis=1) / np.maximum(garment_length, 1e-6)
    return heads[node_bone] + ratio[node_bone, None] * (node_rest - garment_heads[node_bone])


def pose_nodes(bone_transforms: np.ndarray, node_bone: np.ndarray, node_positions: np.ndarray) -> np.ndarray:
    """chi_skin: garment nodes carried by their bones.

    bone_transforms: (..., b, 3, 4). node_positions: (m, 3) at the canonical pose of this body.
    Returns (..., m, 3, 4): rotation of the bone, posed position of the node.
    """
    transforms = bone_transforms[..., node_bone, :, :]
    position = np.einsum("...mij,mj->...mi", transforms[..., :3], node_positions) + transforms[..., 3]
    return np.concatenate([transforms[..., :3], position[..., None]], axis=-1)
