"""A clip of any skeleton, as its file has it: what every reader of motion gives, and what is retargeted to the rig.

Dimensions: `T` frames, `J` joints. Lengths in the file's own unit, along the file's own axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError
from physkin_core.motion.motion import MOST_FRAMES

__all__ = ["MOST_JOINTS", "RATE_HZ", "SourceClip", "check_clip_size", "posed_clip"]

RATE_HZ = 60.0
"""Rate of motion once it is retargeted; no reader needs to sample a clip faster."""
MOST_JOINTS = 1000
"""A skeleton with fingers and a face has a hundred or two."""
MOST_PLACES = 1 << 24
"""Frames times joints: half an hour of 75 joints at 120 Hz, 0.9 GB."""


@dataclass(frozen=True)
class SourceClip:
    """A clip before it is retargeted.

    Attributes:
        names: of the joints.
        parents: (J,) int, -1 for none, a parent before its children.
        rest: (J, 3) places at rest: in the bind pose, or whichever pose has no rotation.
        rotations: (T, J, 4) quaternions xyzw of unit length: turns from rest, in the world.
        places: (T, J, 3) in the world.
        rate_hz: frames a second.
        humanoid: joint by VRM humanoid bone, where the file tells; replaces the names. None: it does not.
        by_hand: joint by rig bone, of a bones file.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    rest: np.ndarray
    rotations: np.ndarray
    places: np.ndarray
    rate_hz: float
    humanoid: Mapping[str, int] | None = None
    by_hand: Mapping[str, int] | None = None

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return len(self.places)

    def turned(self, joint: int) -> Rotation:
        """Rotations (T) of a joint from rest, in the world."""
        return Rotation.from_quat(self.rotations[:, joint])

    def at(self, frames: slice) -> SourceClip:
        """With some of the frames only; the rate follows the step between them."""
        rate_hz = self.rate_hz / (frames.step or 1)
        return replace(self, rotations=self.rotations[frames], places=self.places[frames], rate_hz=rate_hz)


def check_clip_size(frame_count: int, joint_count: int, rate_hz: float) -> None:
    """Readers call it before they allocate a clip. Raises ContentError for one that is too long or too large."""
    if joint_count > MOST_JOINTS:
        raise ContentError(f"it has {joint_count} joints, allowed are {MOST_JOINTS}")
    seconds = frame_count / rate_hz
    if seconds * RATE_HZ > MOST_FRAMES:
        raise ContentError(f"it lasts {seconds:.3g} s, allowed are {MOST_FRAMES / RATE_HZ:.0f} s; cut it")
    if frame_count * joint_count > MOST_PLACES:
        raise ContentError(
            f"it has {frame_count} frames of {joint_count} joints, allowed are {MOST_PLACES // joint_count}; cut it"
        )


def posed_clip(
    names: Sequence[str],
    parents: Sequence[int],
    offsets: np.ndarray,
    turns: Iterable[Rotation],
    places: Mapping[int, np.ndarray],
    frame_count: int,
    rate_hz: float,
) -> SourceClip:
    """The clip of joints that rest without rotation, by how each turns (T) on its parent.

    offsets: (J, 3) from the parent at rest. places: by joint (T, 3) from the parent, where that moves, and from the
    origin for roots.
    """
    rest, quaternions = np.zeros((len(names), 3)), np.empty((frame_count, len(names), 4))
    heads = np.empty((frame_count, len(names), 3))
    for joint, (parent, turn) in enumerate(zip(parents, turns)):
        step = places[joint] if joint in places else np.tile(offsets[joint], (frame_count, 1))
        if parent < 0:
            quaternions[:, joint], heads[:, joint] = turn.as_quat(), step
        else:
            above = Rotation.from_quat(quaternions[:, parent])
            rest[joint] = rest[parent] + offsets[joint]
            quaternions[:, joint] = (above * turn).as_quat()
            heads[:, joint] = heads[:, parent] + above.apply(step)
    return SourceClip(tuple(names), np.array(parents), rest, quaternions, heads, rate_hz)
