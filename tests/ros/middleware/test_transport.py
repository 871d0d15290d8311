"""Transport settings and private ROS domains."""

from __future__ import annotations

import socket

from physkin_ros.middleware.transport import FASTDDS_PROFILE, free_domain_id, use_shipped_profile


def test_shipped_profile_gives_way_to_the_users():
    """A user's own choice is left alone."""
    environment = {}
    use_shipped_profile(environment)
    assert environment["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(FASTDDS_PROFILE)
    own = {"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}
    use_shipped_profile(own)
    assert own == {"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}


def test_a_domain_in_use_is_not_free(monkeypatch):
    """Its first participant's discovery port is taken."""
    taken, free = free_domain_id(), free_domain_id()
    while free == taken:
        free = free_domain_id()
    monkeypatch.setattr("random.SystemRandom.sample", lambda *_: [taken, free])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * taken + 10))
        assert free_domain_id() == free
