"""Settings of a drape node's avatars and garments, as its parameters give them by default."""

from __future__ import annotations

from physkin_ros.node.settings import AVATAR_SETTINGS, GARMENT_SETTINGS, AvatarSettings, GarmentSettings


def garment_settings(**given) -> GarmentSettings:
    """Of the only garment."""
    defaults = {name: setting.default for name, setting in GARMENT_SETTINGS.items()}
    return GarmentSettings(**{**defaults, "prefix": "", "name": "", **given})


def avatar_settings(**given) -> AvatarSettings:
    """Of the only avatar, its root frame "root"."""
    defaults = {name: setting.default for name, setting in AVATAR_SETTINGS.items()}
    own = {"id": "", "prefix": "", "frame_id": "root", "garments": (garment_settings(),)}
    return AvatarSettings(**{**defaults, **own, **given})
