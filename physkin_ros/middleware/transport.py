"""The DDS transport settings PhySkin's processes run with, and ROS domains of their own for demo and tests."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import MutableMapping
from pathlib import Path

__all__ = [
    "DOMAINS",
    "FASTDDS_PROFILE",
    "PROFILE_VARIABLES",
    "free_domain_id",
    "private_environment",
    "use_shipped_profile",
]

FASTDDS_PROFILE = Path(__file__).parents[1] / "config" / "fastdds.xml"
DOMAINS = range(1, 102)
"""ROS domains that `free_domain_id` chooses from; tests that run side by side take some each."""
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""What Fast DDS 2 (ROS 2 Jazzy) and Fast DDS 3 read, in that order."""


def use_shipped_profile(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have Fast DDS read the shipped profile, unless the user has chosen one. Call before `rclpy.init`."""
    if not any(environment.get(variable) for variable in PROFILE_VARIABLES):
        environment.update({variable: str(FASTDDS_PROFILE) for variable in PROFILE_VARIABLES})


def free_domain_id() -> int:
    """A ROS domain nobody on this machine is in: the discovery port of its first participant is free.

    Raises RuntimeError when all of `DOMAINS` are taken.
    """
    for domain in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise RuntimeError(f"every ROS domain from {DOMAINS[0]} to {DOMAINS[-1]} is in use on this machine")


def private_environment() -> dict[str, str]:
    """The present environment with a ROS domain of its own that does not leave this machine."""
    environment = dict(os.environ, ROS_DOMAIN_ID=str(free_domain_id()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    use_shipped_profile(environment)
    return environment
