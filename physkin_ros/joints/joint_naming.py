"""The namings of joints that the parameter `joint_map` chooses from."""

from __future__ import annotations

from pathlib import Path

from physkin_core import Rig
from physkin_ros.joints.joint_map import JointMapError, load_joint_map
from physkin_ros.joints.joint_states import JointNaming, MappedNames
from physkin_ros.joints.ros4hri import ROS4HRI, Ros4hriNaming
from physkin_ros.joints.vrm_naming import VRM, VrmNaming

__all__ = ["PRESETS", "load_naming"]

PRESETS = {ROS4HRI: Ros4hriNaming, VRM: VrmNaming}


def load_naming(joint_map: str | Path | None, rig: Rig) -> JointNaming:
    """The naming that `joint_map` asks for: a preset's name, a joint map file, or nothing for the rig's own names.

    Raises JointMapError for a file that cannot be read or does not fit the rig, ValueError for a preset that does not.
    """
    if not joint_map:
        return MappedNames(rig.joint_names)
    if joint_map in PRESETS:
        return PRESETS[joint_map](rig)
    if not Path(joint_map).is_file():
        allowed = ", ".join(["a JSON file", *PRESETS])
        raise JointMapError(f"cannot read joint map {joint_map}: no such file; allowed: {allowed}")
    return MappedNames(rig.joint_names, load_joint_map(joint_map, rig.joint_names))
