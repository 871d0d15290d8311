"""What can be set about the drape node: every parameter's meaning, default and allowed values, in one place.

How they are read: `settings_reading.py`. Nothing here needs ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from physkin_core import NORMALS, UPRIGHT_GRAVITY
from physkin_core.loader.asset_loader import LOAD_MEMORY, LOAD_SECONDS
from physkin_core.model.model_file import split_fabric
from physkin_core.runtime.evaluator import PRECISIONS
from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.root.imu_acceleration import USUAL_DELAY

__all__ = [
    "AVATAR_SETTINGS",
    "GARMENT_SETTINGS",
    "NODE_SETTINGS",
    "POSE_SOURCES",
    "AvatarSettings",
    "GarmentSettings",
    "NodeSettings",
    "Setting",
    "SettingsError",
    "check_setting",
]


POSE_SOURCES = ("pose", "odometry")
"""Values of `orientation` that are a topic of where the root is."""


class SettingsError(ValueError):
    """A parameter or a configuration file asks for something that there is not."""


@dataclass(frozen=True)
class Setting:
    """One parameter: default, what it does, whether it may change while the node runs, and what is allowed.

    default: None for a number that may be left out, which ROS knows as an empty text. choices: allowed texts. low,
    high: bounds of a number. may_be_empty: of a text.
    """

    default: object
    description: str
    changes: bool = False
    choices: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    may_be_empty: bool = True

    @property
    def declared(self) -> object:
        """The default as ROS knows it."""
        return "" if self.default is None else self.default


def _key(default: object, description: str, **more: Any) -> Any:
    """A parameter, as the field of a settings class that bears its name."""
    return field(metadata={"setting": Setting(default, description, **more)})


@dataclass(frozen=True, kw_only=True)
class GarmentSettings:
    """One garment. prefix: of its parameters. name: empty for the only one."""

    prefix: str
    name: str
    model: str = _key(
        "tshirt",
        "garment model: a .safetensors file, or the name of a shipped one, with a fabric behind it as skirt:denim or "
        "skirt:bend=2e-5+density=0.18; without avatars also several, joined by commas, from the skin outwards",
        changes=True,
        may_be_empty=False,
    )
    tucked: bool = _key(False, "wear its hem under the waistband of the next garment outwards that is not tucked")
    precision: str = _key(
        "",
        "of the network weights: fp32, bf16 or int8, each faster and coarser than the last; default int8",
        choices=("", *PRECISIONS),
    )
    fit: float | None = _key(
        None,
        "1: made to measure for this body; 0: the garment's one size; or between. Above 0 only for models with the "
        "body model's rig. Empty: 1 for those, 0 for others",
        low=0,
        high=1,
    )
    sway: float | None = _key(
        None, "of this garment, in place of that of its avatar (above). Empty: as that", changes=True, low=0, high=1
    )
    normals: str = _key(
        "skinned",
        "skinned: carried along with the cloth; faces: of the draped mesh, truer, for some 2 ns a vertex",
        choices=NORMALS,
    )
    namespace: str = _key("", "what the garment's topics are below; default ~, with avatars ~/ID/NAME")
    points: str = _key(
        "",
        "PLY file of Gaussian splats that lie on this garment, as physkin bind-points takes it: ~/splats carries them "
        "draped; for one garment, or with avatars and outfit false",
    )
    marker: bool = _key(False, "publish a visualization_msgs/Marker TRIANGLE_LIST too, for RViz")

    @property
    def file(self) -> str:
        """Of the model, or a shipped name, without the fabric."""
        return split_fabric(self.model)[0]


@dataclass(frozen=True, kw_only=True)
class AvatarSettings:
    """One avatar. prefix: of its parameters. id: empty for the only one."""

    prefix: str
    id: str
    garments: tuple[GarmentSettings, ...]
    joint_states: str = _key("", "topic of sensor_msgs/JointState; default: joint_states, with avatars ID/joint_states")
    bone_rotations: str = _key(
        "",
        "topic of sensor_msgs/MultiDOFJointState, rotations of bones instead of joint states; default: bone_rotations, "
        "with avatars ID/bone_rotations",
    )
    body_mesh: str = _key(
        "", "avatar to dress: a GLB, glTF, VRM, OBJ, PLY or STL file; empty: the bundled avatar", changes=True
    )
    body_rig: str = _key(
        "",
        "rig file of a body_mesh that has no skin of its own; empty: NAME.rig.json beside it, if there",
        changes=True,
    )
    joint_map: str = _key(
        "",
        "JSON file from incoming joint names to those of the rig; ros4hri for bodies of REP-155, vrm for VRM humanoid "
        "bones (both: default rig only); empty: the names are the rig's",
    )
    missing_joints: str = _key(
        "last",
        "joints that a message does not name keep their last position, or go back to the neutral one",
        choices=("last", "neutral"),
    )
    frame_id: str = _key(
        "",
        "TF frame the clouds are given in: the body's root, X forward, Y left, Z up; default base_link, with avatars "
        "ID, with discover body_ID",
    )
    gravity: tuple[float, ...] = _key(
        UPRIGHT_GRAVITY.tolist(),
        "direction of gravity in the body's root frame until the orientation source gives one",
        changes=True,
    )
    orientation: str = _key(
        "gravity",
        "what tells the direction of gravity: gravity (topic, Vector3Stamped), joints (of the joint states) or fixed; "
        "and what also tells how the root moves: pose (topic, PoseStamped of the root in an upright frame), odometry "
        "(topic, Odometry of the root in one), imu (topic, Imu in the root frame) or tf",
        choices=("gravity", *POSE_SOURCES, "imu", "joints", "tf", "fixed"),
    )
    orientation_topic: str = _key(
        "", "topic of orientation gravity, pose, odometry or imu; default: its name, with avatars ID/gravity and so on"
    )
    orientation_joints: tuple[str, ...] = _key(
        ["root_roll", "root_pitch"], "names of roll and pitch [rad] in the joint states, for orientation joints"
    )
    effective_gravity_topic: str = _key(
        "",
        "topic of what an accelerated root feels: gravity less the root's acceleration, root frame [m/s2]. While it "
        "comes it takes the place of the direction; default ~/effective_gravity, with avatars ~/ID/effective_gravity",
    )
    sway: float = _key(
        1.0,
        "how much cloth lags, swings and settles as pose, odometry or tf move the root, or leans as an IMU says: 1 "
        "all, 0 not at all, each joint state draped by itself",
        changes=True,
        low=0,
        high=1,
    )
    imu_delay: float = _key(
        USUAL_DELAY,
        "[s] time constant of the first-order low pass that the acceleration of an IMU goes through; cloth follows "
        "slow changes late by as much. 0: none",
        low=0,
        high=5,
    )
    world_frame: str = _key(
        "world",
        "upright TF frame, for orientation tf; and for publish_tf, where a pose names no frame",
        may_be_empty=False,
    )
    publish_tf: bool = _key(
        False,
        "publish TF from the frame of each pose (orientation pose or odometry) to frame_id; only where nobody else "
        "does, as a frame has one parent",
    )
    cloud_rate: float = _key(
        0.0,
        "[Hz] clouds interpolated between joint states, one joint state late; 0: one cloud a joint state",
        low=0,
        high=1000,
    )
    separate_limbs: bool = _key(
        False,
        "move arms and legs out of the trunk and of each other, on this body, before draping; ~/joint_states, with "
        "avatars ~/ID/joint_states, carries the positions that were draped",
    )
    outfit: bool = _key(
        True,
        "wear several garments over each other, in their order from the skin outwards; false: drape each by itself",
    )
    layers: tuple[str, ...] = _key(
        [""], "names of the garments from the skin outwards; default: in the order they are given in"
    )
    hide: bool = _key(
        True, "of an outfit, leave out of the clouds what its outer layers cover in everyday poses; false: give all"
    )
    discover: str = _key(
        "",
        "ros4hri: an avatar for every body on /humans/bodies/ID/joint_states, as they come and go",
        choices=("", "ros4hri"),
    )

    @property
    def sways(self) -> tuple[float, ...]:
        """Of each garment."""
        return tuple(self.sway if garment.sway is None else garment.sway for garment in self.garments)


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """The node and its avatars."""

    avatars: tuple[AvatarSettings, ...]
    executor: str = _key("events", "rclpy executor: events (least overhead) or single", choices=("events", "single"))
    autostart: bool = _key(True, "configure and activate at once; false: wait for lifecycle transitions")
    asset_roots: tuple[str, ...] = _key(
        [""],
        "folders that bodies and garments may be swapped for while running; default: those of the files the node "
        "started with. Shipped garments and the bundled avatar are always allowed",
    )
    load_seconds: float = _key(
        LOAD_SECONDS,
        "[s] that loading a body with its garments may take; then it is refused, and what is worn stays",
        low=1,
        high=3600,
    )
    load_memory: int = _key(
        LOAD_MEMORY,
        "[MiB] that loading may take beyond what the process that loads has at its start",
        low=64,
        high=1 << 20,
    )
    deadline: float = _key(
        0.0,
        "[s] from a joint state's arrival to its last cloud; what takes longer is counted. 0: none",
        changes=True,
        low=0,
        high=60,
    )
    most_bodies: int = _key(8, "bodies dressed at a time by an avatar with discover; later ones wait", low=1, high=64)
    clear_shared_memory: bool = _key(
        False, "at the start, delete what killed Fast DDS processes of this user left in /dev/shm"
    )


def _settings_of(kind: type) -> dict[str, Setting]:
    return {each.name: each.metadata["setting"] for each in fields(kind) if each.metadata}


NODE_SETTINGS, AVATAR_SETTINGS, GARMENT_SETTINGS = map(_settings_of, (NodeSettings, AvatarSettings, GarmentSettings))
"""Name -> setting. Those whose `changes` is false are fixed once the node is configured."""


def check_setting(name: str, setting: Setting, value: object) -> object:
    """The value in its setting's type. Raises SettingsError naming parameter, value and what is allowed."""

    def refuse(allowed: str) -> SettingsError:
        return SettingsError(f"parameter {name} is {value!r}; allowed: {allowed}")

    if name.rsplit(".", 1)[-1] == "gravity":
        try:
            gravity_direction(value)
        except ValueError as error:
            raise SettingsError(f"parameter {name.removesuffix('gravity')}{error}") from None
        return tuple(float(number) for number in value)
    default = setting.default
    if default is None and value in (None, ""):
        return None
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise refuse("true or false")
    elif default is None or isinstance(default, (int, float)):
        whole = isinstance(default, int)
        kinds = int if whole else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds) or not setting.low <= value <= setting.high:
            raise refuse(f"{'a whole number' if whole else 'a number'} from {setting.low:g} to {setting.high:g}")
        return int(value) if whole else float(value)
    elif isinstance(default, list):
        if isinstance(value, str) or not all(isinstance(item, str) for item in value):
            raise refuse("a list of texts")
        return tuple(value)
    else:
        if not isinstance(value, str):
            raise refuse("a text")
        if setting.choices and value not in setting.choices:
            raise refuse(", ".join(choice or "''" for choice in setting.choices))
        if not value and not setting.may_be_empty:
            raise SettingsError(f"parameter {name} must not be empty")
    return value
