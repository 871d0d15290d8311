"""A motion at any time between its frames, for the rig and the size of who performs it.

Dimensions: `d` degrees of freedom. Radians, metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.motion import Motion
from physkin_core.rig.rig import Rig

__all__ = ["MotionPlayer", "Pose", "standing_pose"]


@dataclass(frozen=True)
class Pose:
    """positions: (d,) float32 [rad]. root_orientation: (4,) unit quaternion x, y, z, w, world <- root. root_position:
    (3,) [m], the root in a world whose floor is Z = 0."""

    positions: np.ndarray
    root_orientation: np.ndarray
    root_position: np.ndarray


def standing_pose(positions: np.ndarray, avatar: Avatar) -> Pose:
    """Upright at the world's origin, in joint positions (d,), as high as the avatar's soles at rest ask for."""
    return Pose(
        np.asarray(positions, dtype=np.float32), np.array([0.0, 0, 0, 1]), np.array([0, 0, _hip_height(avatar)])
    )


class MotionPlayer:
    """Plays `motion` for a rig; its ways are scaled by how high the avatar's root stands over its soles.

    Raises MotionError for a motion without any joint of the rig.
    """

    def __init__(self, motion: Motion, rig: Rig, avatar: Avatar) -> None:
        body = load_body_model()
        self.motion = motion
        self._positions = motion.positions_for(rig)
        self._scale = _hip_height(avatar) / -float(body.vertices(body.garment_body)[:, 2].min())

    @property
    def duration(self) -> float:
        """From the first frame to the last [s]."""
        return (self.motion.frame_count - 1) / self.motion.rate_hz

    def pose(self, seconds: float) -> Pose:
        """Between the two frames about that time; the first or last frame beyond the motion's ends."""
        last = self.motion.frame_count - 1
        place = min(max(seconds * self.motion.rate_hz, 0.0), float(last))
        before = min(int(place), max(last - 1, 0))
        after, share = min(before + 1, last), place - before

        def between(values: np.ndarray) -> np.ndarray:
            return (1 - share) * values[before] + share * values[after]

        start, end = self.motion.root_orientation[before], self.motion.root_orientation[after]
        turned = (1 - share) * start + share * (end if start @ end >= 0 else -end)
        return Pose(
            positions=between(self._positions).astype(np.float32),
            root_orientation=turned / np.linalg.norm(turned),
            root_position=self._scale * between(self.motion.root_position),
        )


def _hip_height(avatar: Avatar) -> float:
    """Of the root over the soles, in the canonical pose [m]."""
    return -float(avatar.vertices[:, 2].min())
