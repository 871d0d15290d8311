"""The settings as parameters of a ROS node: declared with descriptions, ranges and read-only flags."""

from __future__ import annotations

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from physkin_ros.node.settings import (
    AVATAR_SETTINGS,
    GARMENT_SETTINGS,
    NODE_SETTINGS,
    Setting,
)
from physkin_ros.node.settings_reading import avatar_prefixes

__all__ = ["declare_settings"]


def declare_settings(node: Node) -> dict[str, Setting]:
    """Declare every parameter of the node and of the avatars that its overrides name.

    Returns those that may change while it runs, by full name. Raises SettingsError for an override of an unknown name.
    """
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    settings = dict(NODE_SETTINGS)
    for avatar, garments in avatar_prefixes(given).items():
        for garment in garments:
            settings |= {garment + key: setting for key, setting in GARMENT_SETTINGS.items()}
        # after them: without avatars a key of both is the avatar's
        settings |= {avatar + key: setting for key, setting in AVATAR_SETTINGS.items()}
    for name, setting in settings.items():
        node.declare_parameter(name, setting.declared, _descriptor(setting))
    return {name: setting for name, setting in settings.items() if setting.changes}


def _descriptor(setting: Setting) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=setting.description, read_only=not setting.changes)
    default = setting.default
    if setting.choices:
        descriptor.additional_constraints = f"one of: {', '.join(choice or 'empty' for choice in setting.choices)}"
    if default is None or isinstance(default, float):
        descriptor.dynamic_typing = True  # 60 on a command line is an integer
        limits = FloatingPointRange(from_value=float(setting.low), to_value=float(setting.high))
        descriptor.floating_point_range = [limits]
    elif isinstance(default, int) and not isinstance(default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(setting.low), to_value=int(setting.high), step=1)]
    elif isinstance(default, list) and isinstance(default[0], float):
        descriptor.dynamic_typing = True  # so is [0, 0, -1]
    return descriptor
