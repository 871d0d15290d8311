"""What can be set about the drape node: every parameter's meaning, default and allowed values, in one place.

Without `avatars` the node dresses one avatar in one garment, and the parameters of both stand at the top. With
`avatars.ID.KEY` and `avatars.ID.garments.NAME.KEY` it dresses many. Nothing here needs ROS.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from physkin_core import BACKENDS, NORMALS, UPRIGHT_GRAVITY
from physkin_core.runtime.native_evaluator import PRECISIONS
from physkin_ros.joints.nearest_names import nearest_names
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
    "avatar_prefixes",
    "check_names",
    "check_setting",
    "model_names",
    "read_settings",
]


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
        "garment model: a .safetensors file, or the name of a shipped one; without avatars also several, joined by "
        "commas, from the skin outwards",
        changes=True,
        may_be_empty=False,
    )
    tucked: bool = _key(False, "wear its hem under the waistband of the next garment outwards that is not tucked")
    precision: str = _key(
        "",
        "of the network weights: fp32, bf16 or int8, each faster and coarser than the last; default bf16, and with the "
        "numpy backend fp32, the only one it knows",
        choices=("", *PRECISIONS),
    )
    fit: float | None = _key(
        None,
        "1: made to measure for this body; 0: the garment's one size; or between. Above 0 only for models that have "
        "learnt it. Empty: 1 for those, 0 for others",
        low=0,
        high=1,
    )
    normals: str = _key(
        "skinned",
        "skinned: carried along with the cloth; faces: of the draped mesh, truer, for some 5 ns a vertex",
        choices=NORMALS,
    )
    namespace: str = _key("", "what the garment's topics are below; default ~, with avatars ~/ID/NAME")
    marker: bool = _key(False, "publish a visualization_msgs/Marker TRIANGLE_LIST too, for RViz")


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
        "what tells the direction of gravity: gravity (topic, Vector3Stamped), pose (topic, PoseStamped of the root in "
        "an upright frame), imu (topic, Imu in the root frame), joints (of the joint states), tf, or fixed",
        choices=("gravity", "pose", "imu", "joints", "tf", "fixed"),
    )
    orientation_topic: str = _key(
        "", "topic of orientation gravity, pose or imu; default: its name, with avatars ID/gravity and so on"
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
        "how much cloth lags, swings and settles as the poses of orientation pose move the root: 0 not at all, 1 all",
        low=0,
        high=1,
    )
    world_frame: str = _key("world", "upright TF frame, for orientation tf", may_be_empty=False)
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


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """The node and its avatars."""

    avatars: tuple[AvatarSettings, ...]
    executor: str = _key("events", "rclpy executor: events (least overhead) or single", choices=("events", "single"))
    backend: str = _key("native", "evaluator: native (C++) or numpy (readable reference, slow)", choices=BACKENDS)
    autostart: bool = _key(True, "configure and activate at once; false: wait for lifecycle transitions")
    asset_roots: tuple[str, ...] = _key(
        [""],
        "folders that bodies and garments may be swapped for while running; default: those of the files the node "
        "started with. Shipped garments and the bundled avatar are always allowed",
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

REMOVED = {
    "push_out": "push_out was removed, and garments are draped as without it: delete the key",
    "serialised": "serialised was removed, clouds are always filled in place as bytes: delete the key",
}
"""Keys of earlier versions -> what became of them and what to do."""
IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
TOPIC = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides", "service_introspection")


def avatar_prefixes(names: Mapping[str, object]) -> dict[str, tuple[str, ...]]:
    """Prefix of each avatar's parameters -> prefixes of its garments', from the names of given parameters.

    Without any `avatars.` these are the empty prefix twice. Raises SettingsError for an unknown key below `avatars`, an
    id that is no identifier, and an avatar without garments.
    """
    avatars: dict[str, list[str]] = {}
    for name in names:
        if name != "avatars" and not name.startswith("avatars."):
            continue
        parts = name.split(".")
        if len(parts) < 3:
            raise SettingsError(
                f"parameter {name} is {names[name]!r}; expected avatars.ID.KEY, ID being a name you choose"
            )
        avatar = ".".join(parts[:2]) + "."
        garments = avatars.setdefault(avatar, [])
        identifiers = [("avatar id", parts[1])]
        if parts[2] != "garments":
            key, known, where = ".".join(parts[2:]), [*AVATAR_SETTINGS, "garments"], avatar
        elif len(parts) < 5:
            raise SettingsError(
                f"parameter {name} is {names[name]!r}; expected {avatar}garments.NAME.KEY, you choose NAME, "
                f"KEY is one of {', '.join(GARMENT_SETTINGS)}"
            )
        else:
            garment = ".".join(parts[:4]) + "."
            if garment not in garments:
                garments.append(garment)
            identifiers.append(("garment name", parts[3]))
            key, known, where = ".".join(parts[4:]), list(GARMENT_SETTINGS), garment
        for kind, text in identifiers:
            if not IDENTIFIER.fullmatch(text):
                raise SettingsError(
                    f"parameter {name}: {kind} {text!r}; allowed: letters, digits and _, a letter first"
                )
        if key not in known:
            raise _unknown(key, known, name, f" in {where[:-1]}")
    for avatar, garments in avatars.items():
        if not garments:
            raise SettingsError(f"{avatar[:-1]} has no garments; give it one: {avatar}garments.NAME.model")
    return {avatar: tuple(garments) for avatar, garments in avatars.items()} or {"": ("",)}


def check_names(names: Iterable[str]) -> None:
    """Raises SettingsError for the first parameter that there is not, naming the nearest that there is.

    names: full names, of which those below `avatars` are left to `avatar_prefixes`.
    """
    names = list(names)
    single = {*AVATAR_SETTINGS, *GARMENT_SETTINGS}
    many = any(name.startswith("avatars.") for name in names)
    for name in names:
        if name in NODE_SETTINGS or name.split(".")[0] in (*BUILT_IN, "avatars") or (name in single and not many):
            continue
        if name in single:
            below = "avatars.ID." if name in AVATAR_SETTINGS else "avatars.ID.garments.NAME."
            raise SettingsError(f"parameter {name}: beside avatars it is given to each of them, as {below}{name}")
        raise _unknown(name, [*NODE_SETTINGS, *([] if many else single), "avatars"])


def _unknown(name: str, known: Iterable[str], parameter: str = "", where: str = "") -> SettingsError:
    if name in REMOVED:
        return SettingsError(f"parameter {parameter or name}: {REMOVED[name]}")
    near = nearest_names(name, known, most=1)
    allowed = f"did you mean {near}?" if near else f"allowed{where}: {', '.join(sorted(known))}"
    return SettingsError(f"parameter {parameter or name}: unknown key {name!r}; {allowed}")


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


def read_settings(given: Mapping[str, object]) -> NodeSettings:
    """The settings that parameters give, by their full names; the others at their defaults.

    Raises SettingsError naming parameter, value and what is allowed. Names: see `check_names`.
    """

    def read(prefix: str, settings: Mapping[str, Setting]) -> dict[str, object]:
        return {
            key: check_setting(prefix + key, setting, given.get(prefix + key, setting.default))
            for key, setting in settings.items()
        }

    avatars = []
    for prefix, garment_prefixes in avatar_prefixes(given).items():
        values = read(prefix, AVATAR_SETTINGS)
        identity = prefix.split(".")[1] if prefix else ""
        garments = []
        for garment_prefix in garment_prefixes:
            garment = read(garment_prefix, GARMENT_SETTINGS)
            name = garment_prefix.split(".")[3] if garment_prefix else ""
            _check_topic(f"{garment_prefix}namespace", garment["namespace"])
            garments.append(GarmentSettings(prefix=garment_prefix, name=name, **garment))
        for key in ("joint_states", "bone_rotations", "orientation_topic", "effective_gravity_topic"):
            _check_topic(prefix + key, values[key])
        if len(values["orientation_joints"]) != 2:
            raise SettingsError(
                f"parameter {prefix}orientation_joints is {list(values['orientation_joints'])!r}; allowed: two "
                "names, of roll and of pitch"
            )
        if values["discover"] and not prefix:
            raise SettingsError("parameter discover is for avatars: avatars.ID.discover")
        if prefix:
            garments = _in_order(prefix, garments, values["layers"])
        else:
            garments = _one_or_several(garments[0], values["layers"])
        if values["outfit"] and len(garments) > 1:
            _check_outfit(prefix, garments)
        elif tucked := [garment.prefix for garment in garments if garment.tucked]:
            raise SettingsError(f"parameter {tucked[0]}tucked is true; allowed in an outfit of several garments")
        values["frame_id"] = values["frame_id"] or identity or "base_link"
        avatars.append(AvatarSettings(prefix=prefix, id=identity, garments=tuple(garments), **values))
    namespaces = [garment.namespace for avatar in avatars for garment in avatar.garments if garment.namespace]
    if twice := sorted({name for name in namespaces if namespaces.count(name) > 1}):
        raise SettingsError(f"namespace {twice[0]!r} is given to two garments; each needs its own")
    return NodeSettings(avatars=tuple(avatars), **read("", NODE_SETTINGS))


def model_names(model: str) -> list[str]:
    """What the parameter `model` without avatars names: one model, or several joined by commas."""
    return [name.strip() for name in model.split(",")]


def _one_or_several(garment: GarmentSettings, layers: tuple[str, ...]) -> list[GarmentSettings]:
    """The garments of a node without avatars: one, or several, with topics named after the models it starts with."""
    models = model_names(garment.model)
    if any(layers):
        raise SettingsError("parameter layers is for avatars; without, garments are worn in the order of model")
    if not all(models):
        raise SettingsError(f"parameter model is {garment.model!r}; allowed: models joined by commas")
    if len(models) == 1:
        return [garment]
    below, names = garment.namespace or "~", []
    for model in models:
        name = re.sub(r"\W", "_", Path(model).stem, flags=re.ASCII)
        name = name if IDENTIFIER.fullmatch(name) else f"garment_{name}"
        names.append(name if name not in names else f"{name}_{len(names) + 1}")
    return [replace(garment, name=name, model=model, namespace=f"{below}/{name}") for name, model in zip(names, models)]


def _in_order(prefix: str, garments: list[GarmentSettings], layers: tuple[str, ...]) -> list[GarmentSettings]:
    """An avatar's garments from the skin outwards. Raises SettingsError where `layers` are not their names."""
    if not any(layers):
        return garments
    by_name = {garment.name: garment for garment in garments}
    if sorted(layers) != sorted(by_name):
        raise SettingsError(f"parameter {prefix}layers is {list(layers)!r}; allowed: {', '.join(by_name)}, each once")
    return [by_name[name] for name in layers]


def _check_outfit(prefix: str, garments: list[GarmentSettings]) -> None:
    """Raises SettingsError where garments cannot be computed in one pass. What can be worn, the core knows."""
    first, *others = garments
    if not prefix and first.tucked:
        raise SettingsError("parameter tucked is for one of several garments: avatars.ID.garments.NAME.tucked")
    for other in others:
        for key in ("precision", "normals"):
            ours, theirs = getattr(first, key), getattr(other, key)
            if ours != theirs:
                raise SettingsError(
                    f"parameter {other.prefix}{key} is {theirs!r} and {first.prefix}{key} {ours!r}; the garments of an "
                    f"outfit share it, unless {prefix}outfit is false"
                )


def _check_topic(name: str, value: object) -> None:
    if value and not (isinstance(value, str) and TOPIC.fullmatch(value)):
        raise SettingsError(f"parameter {name} is {value!r}; allowed: a ROS name, such as /alice/joint_states")
