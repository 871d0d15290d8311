"""What is published of messages that are filled in place."""

from types import SimpleNamespace

import pytest


@pytest.fixture
def published():
    """Gives the bytes that a message is published as, with a stamp."""

    def publish(message, sec: int, nanosec: int) -> bytes:
        found = []
        handle = SimpleNamespace(publish_raw=lambda data: found.append(bytes(data)))
        message.publish(SimpleNamespace(handle=handle), sec, nanosec)
        return found[0]

    return publish
