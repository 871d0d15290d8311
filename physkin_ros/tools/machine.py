"""What ran a measurement: processor, system, load and versions, and how much processor time a process has used."""

from __future__ import annotations

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["cpu_seconds", "machine_line", "versions_line"]

CPU_LIST = Path("/proc/cpuinfo")
PACKAGES = ("physkin", "ros-jazzy-rclpy", "numpy")


def machine_line() -> str:
    """Processor, cores and system."""
    listed = CPU_LIST.read_text() if CPU_LIST.exists() else ""
    found = re.search(r"^model name\s*: (.*)$", listed, re.MULTILINE)
    processor = found[1] if found else platform.machine()
    return f"{processor}, {os.cpu_count()} cores, {platform.system()} {platform.release()}"


def versions_line() -> str:
    """Python and the packages that matter."""
    return ", ".join([f"Python {platform.python_version()}", *map(_version, PACKAGES)])


def cpu_seconds(pid: int) -> tuple[float, float]:
    """Processor time [s] of a process's first thread and of all its living threads. Linux only: raises OSError."""
    total = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            total += int((task / "schedstat").read_text().split()[0]) / 1e9
        except FileNotFoundError:  # the thread has ended meanwhile
            continue
    first = int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[0]) / 1e9
    return first, total


def _version(package: str) -> str:
    """Name and version of an installed package."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} (version unknown)"
