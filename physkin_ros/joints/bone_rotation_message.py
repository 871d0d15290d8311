"""`sensor_msgs/MultiDOFJointState` as joint positions of the rig: rotations of bones instead of angles of joints.

Needs no ROS: a message is names and quaternions here. Dimensions: `d` degrees of freedom. Radians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from physkin_core import BoneRotations, Rig
from physkin_core.file_reading import shown
from physkin_ros.joints.joint_state_wire import MOST_NAMES
from physkin_ros.joints.joint_states import JointStateError, JointStateReader

__all__ = ["BoneRotationReader"]


class BoneRotationReader:
    """Reads rotations of bones for a `JointStateReader`. Bones that are left out keep their last rotation.

    skeleton: whose bones they are (see `BoneRotations`). on_unknown: called with the names that are no bones.
    Raises JointStateError for a rig that bone rotations are not for.
    """

    def __init__(
        self,
        rig: Rig,
        reader: JointStateReader,
        *,
        skeleton: str = "rig",
        on_unknown: Callable[[list[str]], None] = lambda names: None,
    ) -> None:
        self._reader, self._on_unknown = reader, on_unknown
        try:
            self._bones = BoneRotations(rig, skeleton=skeleton)
        except ValueError as error:
            raise JointStateError(str(error)) from error

    def read(self, names: Sequence[str], rotations: Sequence[Sequence[float]], out: np.ndarray) -> None:
        """Write the joint positions (d,) float32 [rad] after a message into `out`.

        names, rotations: bone and unit quaternion (x, y, z, w), of equal number.
        Raises JointStateError when there are none or too many, names and rotations differ in number, a bone comes
        twice, none is known, or a known bone's quaternion is not of length 1; `out` is then unchanged.
        """
        if not 0 < len(names) <= MOST_NAMES or len(rotations) != len(names):
            raise JointStateError(
                f"bone rotations have {len(names)} names and {len(rotations)} transforms; allowed are equal numbers "
                f"from 1 to {MOST_NAMES}"
            )
        names = [name.removeprefix(self._reader.prefix) for name in names]
        given = dict(zip(names, rotations))
        if len(given) != len(names):
            raise JointStateError("bone rotations name a bone twice")
        if unknown := self._bones.unknown_bones(names):
            if len(unknown) == len(names):
                some, known = (", ".join(map(shown, each[:4])) for each in (unknown, self._bones.bone_names))
                raise JointStateError(f"no bone is known among {some}; there are {known}, ...")
            self._on_unknown(unknown)
            given = {name: given[name] for name in given.keys() - set(unknown)}
        try:
            out[:] = self._bones.joint_positions(given, start=self._reader.positions)
        except ValueError as error:
            raise JointStateError(str(error)) from error
