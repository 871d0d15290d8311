"""Joint states that carry the humanoid bones of VRM: three angles a bone, `leftUpperArm_x`, `_y` and `_z`.

Angles [rad] are those of VRM 1.0's normalised bones: zero is the T-pose, every bone's axes are the model's own there
(X to its left, Y up, Z forward), and a bone turns about its X, then Y, then Z (intrinsic), three.js's default order.
`hips` is not read: it places the root, whose tilt is the orientation source's to give.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from physkin_core import Rig
from physkin_core.file_reading import shown
from physkin_core.rig.vrm_bones import vrm_ball_joints
from physkin_ros.joints.joint_states import JointStateError, NamedJoints

__all__ = ["VRM", "VrmNaming"]

VRM = "vrm"
"""What the parameter `joint_map` calls this naming."""


class VrmNaming:
    """Names `BONE_x`, `BONE_y`, `BONE_z` of VRM humanoid bones; the rig's own names mean themselves.

    Of a bone, angles that are not named count as zero. Raises ValueError for a rig that lacks a default rig's joint.
    """

    def __init__(self, rig: Rig) -> None:
        self._own = frozenset(rig.joint_names)
        try:
            self._bones = vrm_ball_joints(rig)
        except ValueError as error:
            raise ValueError(f"joint_map {VRM} is for the default rig: {error}") from error
        self._pattern = re.compile(rf"({'|'.join(self._bones)})[_.]([xyz])")

    def look_up(self, names: Sequence[str]) -> NamedJoints:
        """See `JointNaming`. Raises JointStateError for an angle named twice."""
        found = NamedJoints()
        angles: dict[str, list[int]] = {}
        for index, name in enumerate(names):
            if match := self._pattern.fullmatch(name):
                slots = angles.setdefault(match[1], [-1, -1, -1])
                slot = "xyz".index(match[2])
                if slots[slot] >= 0:
                    raise JointStateError(f"joints {shown(names[slots[slot]])} and {shown(name)} are the same angle")
                slots[slot] = index
            elif name in self._own:
                found.scaled.append((index, name, 1.0, 0.0))
            else:
                found.unknown.append(index)
        found.balls = [(self._bones[bone], tuple(slots)) for bone, slots in angles.items()]
        return found
