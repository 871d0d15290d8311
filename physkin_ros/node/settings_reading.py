"""Parameters by their full names, as settings of avatars and garments. Unknown ones are refused.

Without `avatars` the node dresses one avatar in one garment, and the parameters of both stand at the top. With
`avatars.ID.KEY` and `avatars.ID.garments.NAME.KEY` it dresses many. Nothing here needs ROS.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from physkin_core.model.model_file import split_fabric
from physkin_core.rig.nearest_names import nearest_names
from physkin_ros.messages.topics import TOPICS
from physkin_ros.node.settings import (
    AVATAR_SETTINGS,
    GARMENT_SETTINGS,
    NODE_SETTINGS,
    AvatarSettings,
    GarmentSettings,
    NodeSettings,
    Setting,
    SettingsError,
    check_setting,
)

__all__ = ["avatar_prefixes", "model_names", "read_settings"]

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides", "service_introspection")


def avatar_prefixes(given: Mapping[str, object]) -> dict[str, tuple[str, ...]]:
    """Prefix of each avatar's parameters -> prefixes of its garments', from given parameters by their full names.

    Without any `avatars.` these are the empty prefix twice. Raises SettingsError for a parameter that there is not,
    naming the nearest that there is, an id that is no identifier, and an avatar without garments.
    """
    many = any(name.startswith("avatars.") for name in given)
    avatars: dict[str, dict[str, None]] = {}  # the garments in order
    for name, value in given.items():
        match name.split("."):
            case ["avatars", identity, "garments", garment, key]:
                where, identifiers, known = (
                    f"avatars.{identity}.garments.{garment}.",
                    (identity, garment),
                    GARMENT_SETTINGS,
                )
                avatars.setdefault(f"avatars.{identity}.", {})[where] = None
            case ["avatars", identity, key] if key != "garments":
                where, identifiers, known = f"avatars.{identity}.", (identity,), AVATAR_SETTINGS
                avatars.setdefault(where, {})
            case ["avatars", *_]:
                expected = "avatars.ID.KEY or avatars.ID.garments.NAME.KEY, with ID and NAME of your choice"
                raise SettingsError(f"parameter {name} is {value!r}; expected {expected}")
            case [first, *_]:
                if name not in NODE_SETTINGS and first not in BUILT_IN:
                    _check_alone(name, many)
                continue
        for text in identifiers:
            if not IDENTIFIER.fullmatch(text):
                raise SettingsError(f"parameter {name}: {text!r}; allowed: letters, digits and _, a letter first")
        if key not in known:
            raise _unknown(key, known, name, f" in {where[:-1]}")
    for avatar, garments in avatars.items():
        if not garments:
            raise SettingsError(f"{avatar[:-1]} has no garments; give it one: {avatar}garments.NAME.model")
    return {avatar: tuple(garments) for avatar, garments in avatars.items()} or {"": ("",)}


def _check_alone(name: str, many: bool) -> None:
    """Raises SettingsError unless this is a parameter of a node without avatars. many: whether the node has avatars."""
    single = {*AVATAR_SETTINGS, *GARMENT_SETTINGS}
    if name not in single:
        raise _unknown(name, [*NODE_SETTINGS, *([] if many else single), "avatars"])
    if many:
        below = "avatars.ID." if name in AVATAR_SETTINGS else "avatars.ID.garments.NAME."
        raise SettingsError(f"parameter {name}: beside avatars it is given to each of them, as {below}{name}")


def _unknown(name: str, known: Iterable[str], parameter: str = "", where: str = "") -> SettingsError:
    if name in {topic.name for topic in TOPICS}:
        renaming = f"--ros-args -r {name}:=/OTHER_NAME, with several avatars -r ID/{name}:=/OTHER_NAME"
        return SettingsError(f"parameter {parameter or name}: {name} is a topic; to rename it: {renaming}")
    near = nearest_names(name, known, most=1)
    allowed = f"did you mean {near}?" if near else f"allowed{where}: {', '.join(sorted(known))}"
    return SettingsError(f"parameter {parameter or name}: unknown key {name!r}; {allowed}")


def read_settings(given: Mapping[str, object]) -> NodeSettings:
    """The settings that parameters give, by their full names; the others at their defaults.

    Raises SettingsError naming parameter, value and what is allowed.
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
        garments = [
            GarmentSettings(prefix=each, name=each.split(".")[3] if each else "", **read(each, GARMENT_SETTINGS))
            for each in garment_prefixes
        ]
        if not prefix:
            garments = _one_or_several(garments[0])
        _check_layers(prefix, garments)
        for key in ("frame_id", "world_frame"):
            values[key] = values[key].lstrip("/")  # as in messages of ROS 1's time
        values["frame_id"] = values["frame_id"] or identity or "base_link"
        if values["discover"] and not prefix:
            raise SettingsError("parameter discover is for avatars: avatars.ID.discover")
        avatars.append(AvatarSettings(prefix=prefix, id=identity, garments=tuple(garments), **values))
    return NodeSettings(avatars=tuple(avatars), **read("", NODE_SETTINGS))


def model_names(model: str) -> list[str]:
    """What the parameter `model` without avatars names: one model, or several joined by commas."""
    return [name.strip() for name in model.split(",")]


def _one_or_several(garment: GarmentSettings) -> list[GarmentSettings]:
    """The garments of a node without avatars: one, or several, named after the models it starts with."""
    models = model_names(garment.model)
    if not all(models):
        raise SettingsError(f"parameter model is {garment.model!r}; allowed: models joined by commas")
    if len(models) == 1:
        return [garment]
    names: list[str] = []
    for model in models:
        name = re.sub(r"\W", "_", Path(split_fabric(model)[0]).stem, flags=re.ASCII)
        name = name if IDENTIFIER.fullmatch(name) else f"garment_{name}"
        names.append(name if name not in names else f"{name}_{len(names) + 1}")
    return [replace(garment, name=name, model=model) for name, model in zip(names, models)]


def _check_layers(prefix: str, garments: list[GarmentSettings]) -> None:
    """Raises SettingsError for what one garment cannot have, or one of several. What can be worn, the core knows."""
    if len(garments) == 1 and garments[0].tucked:
        raise SettingsError(f"parameter {garments[0].prefix}tucked is true; allowed in an outfit of several garments")
    if len(garments) > 1 and not prefix and garments[0].tucked:
        raise SettingsError("parameter tucked is for one of several garments: avatars.ID.garments.NAME.tucked")
    if len(garments) > 1 and (with_splats := [garment for garment in garments if garment.splats]):
        raise SettingsError(
            f"parameter {with_splats[0].prefix}splats is {with_splats[0].splats!r}; splats lie on a garment that is "
            f"worn alone, not on one of {len(garments)}"
        )
