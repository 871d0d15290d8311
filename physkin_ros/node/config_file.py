"""The file that `physkin node --config` takes: a ROS 2 parameter file, read and checked without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from pathlib import Path

from physkin_core.file_reading import ContentError, read_text, reading, shown
from physkin_ros.node.settings import NodeSettings, SettingsError
from physkin_ros.node.settings_reading import read_settings

__all__ = ["load_config"]

LARGEST = 1 << 20  # [bytes]
NODE_NAMES = ("drape_node", "/drape_node", "/**", "/**/drape_node", "**")


def load_config(path: str | Path) -> NodeSettings:
    """What a ROS 2 parameter file asks of the node. Raises SettingsError naming file, key and what is allowed."""
    with reading(f"config {path}", SettingsError):
        try:
            return _read(_parsed(read_text(Path(path), most=LARGEST)))
        except SettingsError as error:
            raise SettingsError(f"config {path}: {error}") from None


def _parsed(text: str) -> object:
    import yaml  # rclpy brings it

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ContentError(str(error)) from error


def _read(document: object) -> NodeSettings:
    example = "drape_node: {ros__parameters: {avatars: {...}}}"
    if not isinstance(document, dict):
        raise SettingsError(f"expected a ROS 2 parameter file, {example}; got {shown(document)}")
    parts = [document[name] for name in document if name in NODE_NAMES]
    if not parts:
        names = ", ".join(map(shown, islice(document, 4)))
        raise SettingsError(f"it names {names}; expected {example}, or /** for the name")
    flat: dict[str, object] = {}
    for part in parts:
        if not isinstance(part, dict) or not isinstance(part.get("ros__parameters"), dict) or len(part) > 1:
            raise SettingsError(f"expected {example}; got {shown(part)}")
        flat |= _flatten(part["ros__parameters"])
    return read_settings(flat)


def _flatten(tree: Mapping, prefix: str = "") -> dict[str, object]:
    """Nested mappings as one, keys joined by dots. Raises SettingsError for an empty one, which rcl would pass over."""
    flat: dict[str, object] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            if not value:
                raise SettingsError(f"{name} is empty; leave it out, or give it keys")
            flat |= _flatten(value, f"{name}.")
        else:
            flat[name] = value
    return flat
