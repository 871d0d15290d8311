"""What `physkin doctor` looks at where ROS 2 is installed: rclpy, our messages, transports and shared memory."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from physkin_core.doctor.doctor import Finding
from physkin_core.extras import install_command
from physkin_ros.messages.interfaces import missing_interfaces, missing_tf
from physkin_ros.middleware.shared_memory import SHARED_MEMORY, leftovers
from physkin_ros.middleware.transport import FASTDDS_PROFILE, PROFILE_VARIABLES, use_shipped_profile

__all__ = ["look"]

FAST_DDS = "rmw_fastrtps_cpp"
SEGMENTS = 4  # the node and a few readers
SEGMENT_BYTES = 33_554_432  # of the profile


def look() -> Iterator[Finding]:
    """One finding after the other. Takes part in a ROS domain for a moment."""
    yield _profile()
    use_shipped_profile()
    yield _participant()
    yield _messages("physkin_msgs", missing_interfaces())
    yield _messages("tf2_msgs", missing_tf())
    yield from _shared_memory()


def _messages(package: str, missing: str) -> Finding:
    said, _, remedy = missing.partition(". ")
    return Finding(package, "note", said, remedy) if said else Finding(package, "good", "installed")


def _participant() -> Finding:
    import rclpy
    from rclpy.context import Context

    try:
        from rclpy.experimental import EventsExecutor  # noqa: F401
    except ImportError:
        remedy = f"update it: sudo apt upgrade, or {install_command('ros', options='--upgrade')}"
        return Finding("rclpy", "broken", "it is older than 7.1.4, which the node needs for its executor", remedy)
    context = Context()
    try:
        rclpy.init(args=[], context=context)
        node = rclpy.create_node("physkin_doctor", context=context)
        found = rclpy.utilities.get_rmw_implementation_identifier()
        node.destroy_node()
    except Exception as error:  # rcl's errors have no type of their own
        said = " ".join(str(error).split())
        return Finding("rclpy", "broken", said, "look at RMW_IMPLEMENTATION, ROS_DOMAIN_ID and ROS_SECURITY_*")
    finally:
        context.try_shutdown()
    said = f"takes part in domain {os.environ.get('ROS_DOMAIN_ID', 0)} by {found}"
    if found != FAST_DDS:
        return Finding("rclpy", "good", f"{said}; the shipped transport profile is for {FAST_DDS} only")
    return Finding("rclpy", "good", said)


def _profile() -> Finding:
    chosen = [os.environ[variable] for variable in PROFILE_VARIABLES if os.environ.get(variable)]
    if not chosen:
        return Finding("Fast DDS", "good", f"the shipped one; give it to readers too: {FASTDDS_PROFILE}")
    if lacking := [path for path in chosen if not Path(path).is_file()]:
        variables = " or ".join(PROFILE_VARIABLES)
        return Finding("Fast DDS", "broken", f"no such file: {lacking[0]}", f"mend or unset {variables}")
    if Path(chosen[0]).read_bytes() == FASTDDS_PROFILE.read_bytes():
        return Finding("Fast DDS", "good", f"the shipped one: {chosen[0]}")
    remedy = f"where clouds get lost, take over its segment_size: {FASTDDS_PROFILE}"
    return Finding("Fast DDS", "good", f"your own: {chosen[0]}", remedy)


def _shared_memory() -> Iterator[Finding]:
    try:
        free = shutil.disk_usage(SHARED_MEMORY).free
    except OSError:
        yield Finding("shared memory", "note", f"no {SHARED_MEMORY}: clouds go through the network stack")
        return
    said = f"{free / 1e6:.0f} MB free in {SHARED_MEMORY}"
    if free < SEGMENTS * SEGMENT_BYTES:
        remedy = f"give it {SEGMENTS * SEGMENT_BYTES / 1e6:.0f} MB or more (docker run --shm-size=256m)"
        yield Finding("shared memory", "broken", said, remedy)
    else:
        yield Finding("shared memory", "good", said)
    if names := leftovers():
        size = sum((SHARED_MEMORY / name).stat().st_size for name in names if (SHARED_MEMORY / name).exists())
        said = f"{size / 1e6:.0f} MB left by processes that were killed"
        yield Finding("shared memory", "note", said, "fastdds shm clean")
