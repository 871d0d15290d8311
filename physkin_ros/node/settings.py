"""What can be set about the drape node: every parameter's meaning, default and allowed values, in one place.

How they are read: `settings_reading.py`. Nothing here needs ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import Any

from physkin_core import UPRIGHT_GRAVITY
from physkin_core.loader.asset_loader import LOAD_MEMORY_LIMIT, LOAD_TIMEOUT
from physkin_core.model.model_file import split_fabric
from physkin_core.runtime.evaluator import PRECISIONS
from physkin_core.runtime.frame_input import LARGEST_WIND, checked_wind
from physkin_ros.messages.conversions import gravity_direction

__all__ = [
    "AVATAR_SETTINGS",
    "GARMENT_SETTINGS",
    "NODE_SETTINGS",
    "AvatarSettings",
    "GarmentSettings",
    "NodeSettings",
    "Setting",
    "SettingsError",
    "check_setting",
]


class SettingsError(ValueError):
    """A parameter or a configuration file asks for something that there is not."""


@dataclass(frozen=True)
class Setting:
    """One parameter: default, what it does, whether it may change while the node runs, and what is allowed.

    default: None for a number that may be left out, which ROS knows as an empty text. choices: allowed texts. low,
    high: bounds of a number. may_be_empty: of a text. vector: of three numbers, checks them by raising ValueError;
    allowed: what it lets pass.
    """

    default: object
    description: str
    changes: bool = False
    choices: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    may_be_empty: bool = True
    vector: Callable[[Any], Iterable[float]] | None = None
    allowed: str = ""

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
        "garment to wear: a shipped name or a .safetensors file, also with fabric and colour (skirt:denim:navy). A "
        "single avatar can wear up to four, joined by commas, from the skin outwards",
        changes=True,
        may_be_empty=False,
    )
    tucked: bool = _key(False, "tuck the hem into the next garment further out that is not tucked itself")
    fit: float | None = _key(
        None,
        "0: one size, 1: made to measure. Empty: 1, or 0 for a model with a rig of its own, which allows no other",
        low=0,
        high=1,
    )
    sway: float | None = _key(None, "sway of this garment alone. Empty: the avatar's", changes=True, low=0, high=1)
    splats: str = _key(
        "",
        "PLY file of Gaussian splats that lie on this garment; they are published on ~/splats. Only if the avatar "
        "wears no other",
    )

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
    body_mesh: str = _key(
        "",
        "avatar to dress: a GLB, glTF, VRM, FBX, OBJ, PLY or STL file. A mesh without a skin may have a rig file "
        "beside it, NAME.rig.json. Empty: the bundled avatar",
        changes=True,
    )
    joint_map: str = _key(
        "",
        "names of joints in messages: ros4hri (REP-155), vrm, or a JSON file. Empty: the rig's own",
    )
    joint_prefix: str = _key(
        "",
        "what names of joints and bones in messages begin with, such as robot1_; it is left out",
    )
    precision: str = _key(
        "",
        "of the network weights: fp32, bf16 or int8, from most exact to fastest. Empty: int8",
        choices=("", *PRECISIONS),
    )
    frame_id: str = _key(
        "",
        "frame of the body's root, and of clouds. Empty: base_link; with several avatars the ID; for a discovered body "
        "body_ID",
    )
    gravity: tuple[float, ...] = _key(
        UPRIGHT_GRAVITY.tolist(),
        "direction of gravity in the root frame, until a message gives one",
        changes=True,
        vector=gravity_direction,
        allowed="three finite numbers, not all zero, such as [0.0, 0.0, -1.0]",
    )
    orientation: str = _key(
        "gravity",
        "what says which way is down: gravity (the topic and, until a message comes, the parameter), odometry, tf or "
        "imu. These three also say how the root moves, so that cloth sways with it",
        choices=("gravity", "odometry", "tf", "imu"),
    )
    sway: float = _key(
        1.0,
        "how much cloth lags, swings and settles, from 0 to 1. At 0 each joint state is draped by itself",
        changes=True,
        low=0,
        high=1,
    )
    wind: tuple[float, ...] = _key(
        [0.0, 0.0, 0.0],
        "velocity of the air in the world, at most 13 m/s, until a message on ~/wind. If the node knows only "
        "gravity, the velocity is in a level frame that faces the way the body faces",
        changes=True,
        vector=checked_wind,
        allowed=f"three finite numbers, a velocity of at most {LARGEST_WIND:g} m/s",
    )
    world_frame: str = _key(
        "world",
        "frame whose Z is up, for orientation: tf",
        may_be_empty=False,
    )
    cloud_rate: float = _key(
        0.0,
        "rate of clouds [Hz], from poses interpolated between joint states. Clouds then come one joint state late. 0: "
        "a cloud for each joint state",
        low=0,
        high=1000,
    )
    separate_limbs: bool = _key(
        False,
        "move arms and legs out of the trunk and of each other before draping",
    )
    hide_covered: bool = _key(
        True,
        "leave out of the clouds what outer garments cover in everyday poses",
    )
    discover: str = _key(
        "",
        "ros4hri: dress every body on /humans/bodies/ID/joint_states, as they come and go. Empty: one body",
        choices=("", "ros4hri"),
    )

    @property
    def worn(self) -> tuple[str, ...]:
        """What is swapped while the node runs: the body, and each garment's model."""
        return self.body_mesh, *(garment.model for garment in self.garments)

    @property
    def sways(self) -> tuple[float, ...]:
        """Of each garment."""
        return tuple(self.sway if garment.sway is None else garment.sway for garment in self.garments)


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """The node and its avatars."""

    avatars: tuple[AvatarSettings, ...]
    autostart: bool = _key(True, "configure and activate at once; false: wait for lifecycle transitions")
    asset_roots: tuple[str, ...] = _key(
        [""],
        "folders from which a running node may load bodies and garments, besides shipped ones. Empty: the "
        "folders of the files that the node started with",
    )
    load_timeout: float = _key(
        LOAD_TIMEOUT,
        "time [s] that loading a body or a garment may take. After that the avatar keeps what it wears",
        low=1,
        high=3600,
    )
    load_memory_limit: int = _key(
        LOAD_MEMORY_LIMIT,
        "memory [MiB] that loading may take",
        low=64,
        high=1 << 20,
    )
    max_bodies: int = _key(8, "number of discovered bodies that are dressed at once; others wait", low=1, high=64)


def _settings_of(kind: type) -> dict[str, Setting]:
    return {each.name: each.metadata["setting"] for each in fields(kind) if each.metadata}


NODE_SETTINGS, AVATAR_SETTINGS, GARMENT_SETTINGS = map(_settings_of, (NodeSettings, AvatarSettings, GarmentSettings))
"""Name -> setting. Those whose `changes` is false are fixed once the node is configured."""


def check_setting(name: str, setting: Setting, value: object) -> object:
    """The value in its setting's type. Raises SettingsError naming parameter, value and what is allowed."""

    def refuse(allowed: str) -> SettingsError:
        return SettingsError(f"parameter {name} is {value!r}; allowed: {allowed}")

    if setting.vector is not None:
        try:
            return tuple(map(float, setting.vector(value)))
        except (TypeError, ValueError):
            raise refuse(setting.allowed) from None
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
            raise refuse("a list of strings")
        return tuple(value)
    else:
        if not isinstance(value, str):
            raise refuse("a string")
        if setting.choices and value not in setting.choices:
            raise refuse(", ".join(choice or "''" for choice in setting.choices))
        if not value and not setting.may_be_empty:
            raise SettingsError(f"parameter {name} must not be empty")
    return value
