"""What ran a measurement: processor, system, load and versions, and how much processor time a process has used."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["cpu_seconds", "machine_line", "versions_line"]

PACKAGES = ("physkin", "ros-jazzy-rclpy", "numpy")


def machine_line() -> str:
    """Processor, cores and system."""
    return f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}"


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


def _processor() -> str:
    """Name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(package: str) -> str:
    """Name and version of an installed package."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} (version unknown)"
