"""Contact mesh of one avatar in several poses at once, for the physics losses (training bodies have `posed_bodies`).

Dimensions: `B` poses, `V` body vertices, `d` degrees of freedom. Metres, root frame.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import warp as wp

from physkin_core.avatar.avatar import Avatar
from physkin_core.rig.rig import Rig
from physkin_training.sampling.posed_bodies import GRID_SPACING

__all__ = ["PosedAvatar"]


class PosedAvatar:
    """One Warp mesh of B copies of the avatar, copy s displaced by `offset[s]` (B, 3); `mesh` is that of the last
    `pose`, `vertices` (B, V, 3) are without the offsets."""

    def __init__(self, avatar: Avatar, rig: Rig, samples: int, device: torch.device) -> None:
        wp.init()
        self._avatar, self._rig = avatar, rig
        self._device = wp.device_from_torch(device)
        side = math.ceil(samples ** (1 / 3))
        cell = np.arange(samples)
        grid = np.stack([cell % side, cell // side % side, cell // side**2], axis=1)
        self._offset = ((grid - (side - 1) / 2) * GRID_SPACING).astype(np.float32)
        self.offset = torch.as_tensor(self._offset, device=device)
        first = np.arange(samples)[:, None, None] * len(avatar.vertices)
        self._faces = wp.array((avatar.faces + first).reshape(-1), dtype=wp.int32, device=self._device)
        self.mesh: wp.Mesh
        self.vertices: np.ndarray

    def pose(self, joint_positions: np.ndarray) -> None:
        """joint_positions: (B, d) [rad]."""
        bones = self._rig.bone_transforms(joint_positions, heads=self._avatar.bone_heads)
        self.vertices = np.stack([self._avatar.posed_vertices(bone) for bone in bones]).astype(np.float32)
        points = (self.vertices + self._offset[:, None]).reshape(-1, 3)
        self.mesh = wp.Mesh(wp.array(points, dtype=wp.vec3, device=self._device), self._faces)
