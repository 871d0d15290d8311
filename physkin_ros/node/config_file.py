"""The file that `physkin node --config` takes: a ROS 2 parameter file, read and checked without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from physkin_ros.node.settings import NodeSettings, SettingsError
from physkin_ros.node.settings_reading import check_names, read_settings

__all__ = ["load_config"]

NODE_NAMES = ("drape_node", "/drape_node", "/**", "/**/drape_node", "**")


def load_config(path: str | Path) -> NodeSettings:
    """What a ROS 2 parameter file asks of the node. Raises SettingsError naming file, key and what is allowed."""
    import yaml  # rclpy brings it

    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"cannot read config {path}: {' '.join(str(error).split())}") from error
    example = "drape_node: {ros__parameters: {avatars: {...}}}"
    if not isinstance(document, dict):
        raise SettingsError(f"config {path} must be a ROS 2 parameter file, {example}; got {document!r:.60}")
    parts = [document[name] for name in document if name in NODE_NAMES]
    if not parts:
        raise SettingsError(
            f"config {path} names {', '.join(map(repr, document))}; expected {example}, or /** for the name"
        )
    flat: dict[str, object] = {}
    try:
        for part in parts:
            if not isinstance(part, dict) or not isinstance(part.get("ros__parameters"), dict) or len(part) > 1:
                raise SettingsError(f"expected {example}; got {part!r:.60}")
            flat |= _flatten(part["ros__parameters"])
        check_names(flat)
        return read_settings(flat)
    except SettingsError as error:
        raise SettingsError(f"config {path}: {error}") from None


def _flatten(tree: Mapping, prefix: str = "") -> dict[str, object]:
    """Nested mappings as one, keys joined by dots. Raises SettingsError for what rcl would refuse less clearly."""
    flat: dict[str, object] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if not isinstance(key, str):
            raise SettingsError(f"key {name!r} is a {type(key).__name__}; write it in quotes, starting with a letter")
        if isinstance(value, dict):
            if not value:
                raise SettingsError(f"{name} is empty; leave it out, or give it keys")
            flat |= _flatten(value, f"{name}.")
        elif value is None:
            raise SettingsError(f"{name} has no value")
        elif isinstance(value, list) and len({type(item) for item in value}) != 1:
            raise SettingsError(
                f"{name} is {value!r}; the items of a list must be of one type, such as [0.0, 0.0, -1.0]"
            )
        else:
            flat[name] = value
    return flat
