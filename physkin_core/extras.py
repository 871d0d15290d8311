"""Extras of the pip package, and what they bring."""

from __future__ import annotations

__all__ = ["EXTRAS", "extra_of"]

EXTRAS = {
    "compressed": ("DracoPy", "meshopt"),
    "ros": ("rclpy", "sensor_msgs", "diagnostic_msgs", "rcl_interfaces"),
    "replay": ("rosbags", "apsw", "tabulate"),
    "training": ("torch", "warp", "potpourri3d", "pydantic", "tensorboard", "physkin_training"),
    "catalogue": ("ray",),
    "usd": ("pxr",),
    "view": ("mitsuba", "PIL", "matplotlib", "av", "viser"),
    "completion": ("shtab",),
}
"""Extra -> import packages it brings; colcon leaves `physkin_training` out."""


def extra_of(module: str | None) -> str | None:
    """The extra that brings an import package or a module of it, None if none does."""
    package = (module or "").split(".")[0]
    return next((extra for extra, packages in EXTRAS.items() if package in packages), None)
