"""A node behind a rosbridge, played: the messages that it would publish, in the bridge's protocol, for tests."""

from __future__ import annotations

import json
import threading
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from physkin_core import Outfit
from physkin_ros.messages.conversions import garment_mesh

__all__ = ["PlayedNode", "played_bridge"]

MESH, NODES, JOINTS = "physkin_msgs/msg/GarmentMesh", "physkin_msgs/msg/GarmentNodes", "sensor_msgs/msg/JointState"
TAGS = {"f": 85, "I": 70, "d": 86}
"""Of CBOR's typed arrays, little endian (RFC 8746), as rosbridge sends arrays of numbers."""


class PlayedNode:
    """What a drape node publishes of an outfit, pose by pose: as dictionaries with arrays, by topic."""

    def __init__(self, outfit: Outfit, topics: Sequence[str]) -> None:
        self.outfit, self.topics = outfit, list(topics)
        self.meshes = [_plain(garment_mesh(outfit, k, "base_link", revision=3)) for k in range(len(self.topics))]

    def latched(self) -> dict[str, dict]:
        return {f"{topic}/mesh": mesh for topic, mesh in zip(self.topics, self.meshes)}

    def frame(self, positions: np.ndarray) -> dict[str, dict]:
        """Of one pose, which is draped."""
        self.outfit.drape(positions)
        positions = array("d", map(float, positions))
        messages = {"/joint_states": {"name": list(self.outfit.joint_names), "position": positions}}
        for topic, *values in zip(self.topics, self.outfit.node_transforms(), self.outfit.detail_offsets()):
            transforms, offsets = (array("f", each.tobytes()) for each in values)
            messages[f"{topic}/garment_nodes"] = {"revision": 3, "transforms": transforms, "detail_offsets": offsets}
        return messages


def _plain(message) -> dict:
    """Fields of a message, without its header."""
    return {name: getattr(message, name) for name in message.get_fields_and_field_types() if name != "header"}


def encoded(topic: str, message: dict, compression: str) -> str | bytes:
    """As rosbridge publishes it: JSON text, or, asked for, CBOR with typed arrays."""
    whole = {"op": "publish", "topic": topic, "msg": message}
    if compression == "none":
        return json.dumps(whole, default=list)
    from cbor2 import CBORTag, dumps

    def typed(values: array) -> bytes | CBORTag:
        tag = TAGS.get(values.typecode)
        return values.tobytes() if tag is None else CBORTag(tag, values.tobytes())

    whole["msg"] = {name: typed(value) if isinstance(value, array) else value for name, value in message.items()}
    return dumps(whole)


@contextmanager
def played_bridge(node: PlayedNode, poses: Sequence[np.ndarray], *, rate: float = 60.0) -> Iterator[str]:
    """The bridge's address while it is there: whoever subscribes gets poses over and over."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import serve

    stop = threading.Event()
    frames = [node.frame(pose) for pose in poses]

    def answer_one(said: dict, connection, asked: dict[str, str]) -> None:
        if said["op"] == "call_service":
            assert said["service"].lstrip("/") == "rosapi/topics_for_type", said
            kind = said["args"]["type"] if isinstance(said["args"], dict) else said["args"][0]
            values = {"topics": list(node.latched()) if kind == MESH else []}
            reply = {"op": "service_response", "service": said["service"], "id": said["id"], "values": values}
            connection.send(json.dumps(reply | {"result": True}))
        elif said["op"] == "subscribe":
            compression = said.get("compression", "none")
            if said["topic"] in node.latched():
                connection.send(encoded(said["topic"], node.latched()[said["topic"]], compression))
            asked[said["topic"]] = compression

    def answer(connection) -> None:
        asked: dict[str, str] = {}

        def publish() -> None:
            at = 0
            with suppress(ConnectionClosed):
                while not stop.wait(1 / rate):
                    for topic in asked.keys() & frames[at].keys():
                        connection.send(encoded(topic, frames[at][topic], asked[topic]))
                    at = (at + 1) % len(frames)

        threading.Thread(target=publish, daemon=True).start()
        with suppress(ConnectionClosed):
            for text in connection:
                answer_one(json.loads(text), connection, asked)

    with serve(answer, "127.0.0.1", 0, max_size=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            stop.set()
            server.shutdown()
