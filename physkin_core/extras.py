"""Extras of the pip package, and what they bring."""

from __future__ import annotations

import json
import shutil
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

__all__ = ["EXTRAS", "extra_of", "install_command"]

EXTRAS = {
    "compressed": ("DracoPy", "meshopt"),
    "ros": ("rclpy", "sensor_msgs", "diagnostic_msgs", "rcl_interfaces"),
    "replay": ("rosbags", "apsw", "tabulate"),
    "training": ("torch", "warp", "potpourri3d", "pydantic", "tensorboard", "physkin_training"),
    "cluster": ("ray", "zarr"),
    "usd": ("pxr",),
    "view": ("mitsuba", "PIL", "matplotlib", "av", "viser"),
    "completion": ("shtab",),
}
"""Extra -> import packages it brings; colcon leaves `physkin_training` out."""


def extra_of(module: str | None) -> str | None:
    """The extra that brings an import package or a module of it, None if none does."""
    package = (module or "").split(".")[0]
    return next((extra for extra, packages in EXTRAS.items() if package in packages), None)


def install_command(extra: str = "", *, options: str = "") -> str:
    """A command that installs the package with an extra: by the pip of this Python, and from where it was installed
    from, which may be the folder of a clone, a wheel or a repository. options: of pip, such as "--upgrade"."""
    pip = Path(shutil.which("pip") or "")
    program = "pip" if pip.parent == Path(sys.executable).parent else f"{_from_here(Path(sys.executable))} -m pip"
    return " ".join([program, "install", *options.split(), *_source(f"[{extra}]" if extra else "")])


def _source(extra: str) -> list[str]:
    """What pip is to install."""
    try:
        origin = json.loads(distribution("physkin").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        origin = {}
    url = origin.get("url", "")
    if "dir_info" in origin:
        editable = ["--editable"] if origin["dir_info"].get("editable") else []
        return [*editable, f"'{_from_here(Path(url2pathname(urlsplit(url).path)))}{extra}'"]
    if "vcs_info" in origin:
        url = f"{origin['vcs_info']['vcs']}+{url}"
    return [f"'physkin{extra} @ {url}'" if url else f"'physkin{extra}'"]


def _from_here(path: Path) -> Path:
    """A path within the folder that the command is run in as one from there."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
