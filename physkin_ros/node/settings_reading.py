"""Parameters by their full names, as settings of avatars and garments: unknown ones and what does not go together told.

Without `avatars` the node dresses one avatar in one garment, and the parameters of both stand at the top. With
`avatars.ID.KEY` and `avatars.ID.garments.NAME.KEY` it dresses many. Nothing here needs ROS.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from physkin_core.model.model_file import split_fabric
from physkin_core.renamed import PARAMETERS
from physkin_ros.joints.nearest_names import nearest_names
from physkin_ros.node.settings import (
    AVATAR_SETTINGS,
    GARMENT_SETTINGS,
    NODE_SETTINGS,
    POSE_SOURCES,
    AvatarSettings,
    GarmentSettings,
    NodeSettings,
    Setting,
    SettingsError,
    check_setting,
)

__all__ = ["avatar_prefixes", "check_names", "model_names", "read_settings"]

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
    if name in PARAMETERS:
        return SettingsError(f"parameter {parameter or name}: {name} is now called {PARAMETERS[name]}")
    near = nearest_names(name, known, most=1)
    allowed = f"did you mean {near}?" if near else f"allowed{where}: {', '.join(sorted(known))}"
    return SettingsError(f"parameter {parameter or name}: unknown key {name!r}; {allowed}")


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
        if values["publish_tf"] and values["orientation"] not in POSE_SOURCES:
            raise SettingsError(
                f"parameter {prefix}publish_tf is true and {prefix}orientation {values['orientation']!r}; allowed with "
                f"{' or '.join(POSE_SOURCES)}, which say where the root is"
            )
        for key in ("frame_id", "world_frame"):
            values[key] = values[key].lstrip("/")  # as in messages of ROS 1's time
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
        raise SettingsError("parameter layers is only for avatars; otherwise garments are worn in the order of model")
    if not all(models):
        raise SettingsError(f"parameter model is {garment.model!r}; allowed: models joined by commas")
    if len(models) == 1:
        return [garment]
    if garment.splats:
        raise SettingsError(
            f"parameter splats is {garment.splats!r} and model names {len(models)} garments; splats lie on one: "
            "avatars.ID.garments.NAME.splats"
        )
    below, names = garment.namespace or "~", []
    for model in models:
        name = re.sub(r"\W", "_", Path(split_fabric(model)[0]).stem, flags=re.ASCII)
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
    if with_splats := [garment.prefix for garment in garments if garment.splats]:
        raise SettingsError(
            f"parameter {with_splats[0]}splats: splats follow one garment, not the layers of an outfit; allowed with "
            f"{prefix}outfit false"
        )
    for other in others:
        if other.precision != first.precision:
            raise SettingsError(
                f"parameter {other.prefix}precision is {other.precision!r} and {first.prefix}precision "
                f"{first.precision!r}; the garments of an outfit share it, unless {prefix}outfit is false"
            )


def _check_topic(name: str, value: object) -> None:
    if value and not (isinstance(value, str) and TOPIC.fullmatch(value)):
        raise SettingsError(f"parameter {name} is {value!r}; allowed: a ROS name, such as /alice/joint_states")
