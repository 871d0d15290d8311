"""One drape node's process under everything a network and a disk can throw at it: each is survived and reported."""

from __future__ import annotations

import base64
import json
import os
import signal
import struct
import subprocess
import sys
import time
from array import array

import numpy as np
import pytest
import yaml

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar

rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from physkin_ros.middleware.transport import private_environment  # noqa: E402

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import Site, glb_joined, glb_parts  # noqa: E402
from physkin_msgs.srv import SetBody  # noqa: E402

TOP = "alice/top"
TOPIC = "/alice/joint_states"


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """The folder that bodies may come from."""
    return tmp_path_factory.mktemp("site") / "bodies"


@pytest.fixture(scope="module")
def site(bodies, model_path):
    """A node with one avatar; at the end it must still be there, end well and have logged no traceback."""
    bodies.mkdir()
    config, log = bodies.parent / "avatars.yaml", bodies.parent / "log"
    avatars = {"alice": {"garments": {"top": {"model": str(model_path)}}}}
    parameters = {"asset_roots": [str(bodies)], "avatars": avatars}
    config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": parameters}}))
    with pytest.MonkeyPatch.context() as patch, open(log, "w") as output:
        for name, value in private_environment().items():
            if os.environ.get(name) != value:
                patch.setenv(name, value)
        command = [sys.executable, "-m", "physkin_core.cli", "node", "--config", str(config)]
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        site = Site(int(os.environ["ROS_DOMAIN_ID"]), process, [TOP])
        try:
            site.publisher(TOPIC)
            yield site
            process.send_signal(signal.SIGINT)
            assert process.wait(10) == 0, log.read_text()
            assert "Traceback" not in log.read_text()
        finally:
            process.kill()
            process.wait()
            site.close()


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


def test_each_bad_joint_state_is_reported(site, drapes, garment_model):
    """With the joint, the value or the number at fault."""
    names = list(garment_model.rig.joint_names)
    good = serialize_message(site.state(names, garment_model.rig.rest))
    many = [f"joint{index}" for index in range(1_000_000)]
    for message, reason in (
        (site.state(many, array("d", bytes(8 * len(many)))), "names 1000000 joints; at most 4096"),
        (site.state(names, [1e308] * len(names)), f"{names[0]!r} is 1e+308"),
        (site.state(names + names[:1], [0.0] * (len(names) + 1)), "are the same joint"),
        (site.state(names, []), f"{len(names)} names but 0 positions"),
        (site.state(["\u202e" * 9, "x" * 100_000], [0.0, 0.0]), "no joint is known"),
        (good[: len(good) // 2], "is cut off"),
        (b"\0\1\0\0" + b"\xff" * 64, "is cut off"),
        (b"\0\7\0\0" + good[4:], "the message is no joint state"),
    ):
        site.publisher(TOPIC).publish(message)
        reported(site, "last rejection", reason)
        drapes()


def test_another_type_on_the_topic_is_reported(site, drapes):
    """DDS delivers nothing of it; the diagnostics name type and node while it is there, and warn of the silence."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    stranger = rclpy.create_node("stranger", context=context)
    try:
        publisher = stranger.create_publisher(String, TOPIC, 5)
        publisher.publish(String(data="arms up"))
        reported(site, "publishers of another type", "std_msgs/msg/String of stranger")
        reported(site, "summary", "no joint states, but other messages on their topic")
        drapes()
    finally:
        stranger.destroy_node()
        rclpy.shutdown(context=context)
    reported(site, "publishers of another type", "none")


def test_a_storm_is_reported_and_costs_no_memory(site, drapes, garment_model):
    """Five thousand joint states a second, every other one bad, for three seconds."""
    rig = garment_model.rig
    positions = rig.rest.tolist()
    data = [serialize_message(site.state(rig.joint_names, [*positions[:-1], last])) for last in (0.1, np.nan)]
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
    """Sizes that are not there, indices out of range, buffers elsewhere: refused, reported; the old body goes on."""
    bundled = BUNDLED_AVATAR.read_bytes()
    secret = bodies.parent / "secret.bin"
    secret.write_bytes(bundled)
    (bodies / "link.bin").symlink_to(secret)
    with open(bodies / "sparse.glb", "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 2**31 - 1))
        file.truncate(2**31)
    with open(bodies / "sparse.bin", "wb") as file:
        file.truncate(2**31)
    (bodies / "huge.ply").write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    (bodies / "index.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n")
    before = resident(site)
    for name, change, reason in (
        ("faces.glb", lambda document: accessor(document, "indices").update(byteOffset=2**31), "an accessor of"),
        ("count.glb", lambda document: accessor(document, "POSITION").update(count=2**31), "an accessor of"),
        (
            "view.glb",
            lambda document: accessor(document, "POSITION").update(bufferView=-5),
            "view -5, allowed 0 to",
        ),
        (
            "none.glb",
            lambda document: accessor(document, "JOINTS_0").update(bufferView=10**9),
            "view 1000000000,",
        ),
        ("empty.glb", nothing_but_a_count, "2147483647 elements without data"),
        ("outside.gltf", lambda document: buffer(document, "../secret.bin"), "outside the avatar's folder"),
        ("coded.gltf", lambda document: buffer(document, "%2e%2e/secret.bin"), "outside the avatar's folder"),
        ("absolute.gltf", lambda document: buffer(document, str(secret)), "outside the avatar's folder"),
        ("linked.gltf", lambda document: buffer(document, "link.bin"), "outside the avatar's folder"),
        ("remote.gltf", lambda document: buffer(document, "http://127.0.0.1/a.bin"), "only files beside the avatar"),
        ("sparse.gltf", lambda document: buffer(document, "sparse.bin", 2**31), "has 2147483648 bytes"),
        ("sparse.glb", None, "has 2147483648 bytes; at most"),
        ("huge.ply", None, "huge.ply"),
        ("index.obj", None, "index.obj"),
        ("x" * 5000 + ".glb", None, "File name too long"),
    ):
        path = bodies / name
        if change is not None:
            document, rest = glb_parts(bundled)
            change(document)
            path.write_bytes(json.dumps(document).encode() if path.suffix == ".gltf" else glb_joined(document, rest))
        answer = site.call(SetBody, "set_body", avatar="alice", body_mesh=str(path))
        assert not answer.success and reason in answer.message, (name, answer.message)
        drapes()
    reported(site, "last error", "File name too long")
    assert resident(site) - before < 200e6
    embedded = base64.b64encode(glb_parts(bundled)[1][8:]).decode()
    document, _ = glb_parts(bundled)
    buffer(document, f"data:application/octet-stream;base64,{embedded}")
    (bodies / "good.gltf").write_text(json.dumps(document))
    answer = site.call(SetBody, "set_body", avatar="alice", body_mesh=str(bodies / "good.gltf"))
    assert answer.success, answer.message
    drapes()


def accessor(document: dict, name: str) -> dict:
    primitive = document["meshes"][0]["primitives"][0]
    return document["accessors"][primitive["indices"] if name == "indices" else primitive["attributes"][name]]


def nothing_but_a_count(document: dict) -> None:
    positions = accessor(document, "POSITION")
    del positions["bufferView"]
    positions["count"] = 2**31 - 1


def buffer(document: dict, uri: str, length: int | None = None) -> None:
    document["buffers"][0]["uri"] = uri
    if length is not None:
        document["buffers"][0]["byteLength"] = length


def resident(site) -> int:
    """Bytes of the node's memory."""
    with open(f"/proc/{site.process.pid}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
