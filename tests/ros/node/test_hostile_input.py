"""One drape node's process under everything a network and a disk can throw at it: each is survived and reported."""

from __future__ import annotations

import json
import os
import struct
import time
from array import array
from contextlib import contextmanager

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar

rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from geometry_msgs.msg import Vector3Stamped  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402
from std_msgs.msg import String  # noqa: E402

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import glb_joined, glb_parts  # noqa: E402
from physkin_msgs.srv import SetBody  # noqa: E402

TOP = "alice/top"
TOPIC = "/alice/joint_states"


@pytest.fixture(scope="module")
def bodies(other_body):
    """A folder that bodies may come from."""
    folder = other_body.parent / "hostile"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def drapes(site, garment_model):
    """Fails unless the node answers a good joint state with the right cloud."""
    rig = garment_model.rig
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, rig))

    def check() -> None:
        pose = np.random.default_rng(site.stamp).uniform(rig.lower, rig.upper).astype(np.float32)
        np.testing.assert_array_equal(site.cloud(TOP, rig.joint_names, pose), draper.drape(pose))

    return check


def reported(site, key: str, reason: str) -> None:
    """Wait until the diagnostics say so."""
    site.until(lambda: reason in site.statuses.get(TOP, {}).get(key, ""), f"{reason!r} as {key}; has {site.statuses}")


def test_hostile_messages(site, drapes, garment_model):
    """Each is counted, and the next good joint state is answered."""
    names = list(garment_model.rig.joint_names)
    good, random = serialize_message(site.state(names, garment_model.rig.rest)), np.random.default_rng(6)
    many = [f"joint{index}" for index in range(1_000_000)]
    states = [
        site.state(many, array("d", bytes(8 * len(many)))),
        site.state(names, [1e308] * len(names)),
        site.state(names, [np.nan] * len(names)),
        site.state(names + names[:1], [0.0] * (len(names) + 1)),
        site.state(names, []),
        site.state([], []),
        site.state(["\u202e" * 9, "x" * 100_000], [0.0, 0.0]),
        good[: len(good) // 2],
        b"\0\1\0\0" + b"\xff" * 64,
        b"\0\7\0\0" + good[4:],
    ]
    noise = [good[: int(random.integers(4, len(good)))] for _ in range(20)]
    noise += [b"\0\1\0\0" + random.bytes(int(random.integers(0, 3000))) for _ in range(20)]
    tilt = Vector3Stamped()
    tilt.vector.z = float("nan")
    for message in (tilt, b"\0\1\0\0" + b"\xff" * 20):
        site.publisher("/alice/gravity", Vector3Stamped).publish(message)
    for message in noise + states:
        site.publisher(TOPIC).publish(message)
        site.spin(0.005)
    drapes()
    site.until(lambda: int(site.statuses[TOP]["joint states rejected"]) >= len(states), "rejections to be counted")
    site.until(lambda: int(site.statuses[TOP]["gravity messages rejected"]) >= 1, "bad gravity to be counted")
    reported(site, "last rejection", "the message is not a joint state")


@contextmanager
def stranger():
    """Another node in the domain, while the block runs."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("stranger", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_another_type_on_the_topic_is_reported(site, drapes):
    """DDS delivers nothing of it; the diagnostics name type and node while it is there, and warn of the silence."""
    with stranger() as node:
        publisher = node.create_publisher(String, TOPIC, 5)
        publisher.publish(String(data="arms up"))
        reported(site, "publishers of another type", "std_msgs/msg/String of stranger")
        reported(site, "summary", "no joint states, but other messages on their topic")
        drapes()
    reported(site, "publishers of another type", "none")


def test_clouds_of_somebody_else_are_reported(site, drapes):
    """As a second node of the same name sends them: diagnostics say so while it lasts, the log says what to do."""
    cloud = "/drape_node/alice/top/garment"
    with stranger() as node:
        node.create_publisher(PointCloud2, cloud, 5)
        reported(site, "summary", f"somebody else publishes on {cloud}")
        drapes()
    site.until(lambda: "somebody" not in site.statuses[TOP]["summary"], "the diagnostics to be silent again")
    assert site.log.read_text().count(f"somebody else publishes on {cloud}, too: readers get both") == 1


@pytest.mark.slow
def test_a_storm_is_reported_and_costs_no_memory(site, drapes, garment_model):
    """Five thousand joint states a second, every other one bad, for three seconds."""
    rig = garment_model.rig
    positions = rig.rest.tolist()
    data = [serialize_message(site.state(rig.joint_names, each)) for each in (positions, [np.nan] * len(positions))]
    publisher = site.publisher(TOPIC)
    drapes()
    before, rejected = resident(site), int(site.statuses[TOP]["joint states rejected"])
    start = time.monotonic()
    for index in range(15_000):
        publisher.publish(data[index % 2])
        if index % 50 == 0:
            time.sleep(max(0.0, start + index / 5000 - time.monotonic()))
    drapes()
    site.until(lambda: int(site.statuses[TOP]["joint states rejected"]) > rejected + 500, "rejections")
    assert resident(site) - before < 30e6


def test_hostile_body_files(site, drapes, bodies):
    """Sizes that are not there, files elsewhere: refused, reported; the old body goes on. More of them: tests/core."""
    bundled = BUNDLED_AVATAR.read_bytes()
    (bodies.parent.parent / "secret.bin").write_bytes(bundled)
    with open(bodies / "sparse.glb", "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 2**31 - 1))
        file.truncate(2**31)
    (bodies / "huge.ply").write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    (bodies / "cut.glb").write_bytes(bundled[:5000])
    (bodies / "binary.stl").write_bytes(b"\0" * 80 + struct.pack("<I", 2**31))
    document, rest = glb_parts(bundled)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    document["accessors"][attributes["POSITION"]].update(count=2**31)
    (bodies / "count.glb").write_bytes(glb_joined(document, rest))
    document["buffers"][0]["uri"] = "../../secret.bin"
    (bodies / "outside.gltf").write_text(json.dumps(document))
    before = resident(site)
    for name, reason in (
        ("count.glb", "accessors[0] of 2147483648 elements"),
        ("outside.gltf", "outside the folder that it is in"),
        ("sparse.glb", "has 2147483648 bytes; at most"),
        ("huge.ply", "huge.ply"),
        ("cut.glb", "cut.glb"),
        ("binary.stl", "binary.stl"),
        ("x" * 5000 + ".glb", "File name too long"),
    ):
        answer = site.call(SetBody, "set_body", avatar="alice", body_mesh=str(bodies / name))
        assert not answer.success and reason in answer.message, (name, answer.message)
        drapes()
    reported(site, "last error", "File name too long")
    assert resident(site) - before < 200e6


def resident(site) -> int:
    """Bytes of the node's memory."""
    with open(f"/proc/{site.process.pid}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
