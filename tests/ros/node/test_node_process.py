"""The drape node as a process, as users start it."""

from __future__ import annotations

import gc
import json
import signal
import time

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_motion

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")


@pytest.fixture
def run_main(domain, monkeypatch):
    """Runs the process's `main` here, which is a second faster than a process. A node that starts ends at once."""
    from physkin_ros.node import node_process

    monkeypatch.setattr(node_process, "spin", lambda node: None)
    handler = signal.getsignal(signal.SIGINT)
    yield lambda *arguments: node_process.main(list(arguments))
    signal.signal(signal.SIGINT, handler)
    gc.collect()  # a lifecycle node leaves its domain when nothing holds it any more


def test_clouds_equal_the_core(start, peer, garment_model, model_path):
    """Every cloud is what `Draper.drape` gives for its joint state; topics follow remapping, and SIGTERM ends the node
    with status 0."""
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    values = {"model": model_path, "frame_id": "body_7", "gravity": "[0, 0, -1]"}
    parameters = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    node = start("physkin_core.cli", "node", "--ros-args", *parameters, "-r", "gravity:=/down")
    peer.connect(gravity=False)
    assert peer.node.count_subscribers("/down") and not peer.node.count_subscribers("/gravity")
    motion = load_motion("walk")
    index = [list(motion.joint_names).index(name) for name in draper.joint_names]
    for frame in range(0, motion.frame_count, 7):
        cloud = peer.cloud(motion.joint_names, motion.positions[frame], (100 + frame, frame))
        np.testing.assert_allclose(cloud, draper.drape(motion.positions[frame][index]), atol=1e-6)
    assert peer.frame_ids == {"body_7"}
    node.send_signal(signal.SIGTERM)
    status, output = node.wait(60), node.stdout.read()
    assert status == 0, output
    assert "Traceback" not in output and "nanobind" not in output and "encoded body" in output and " ms" in output


def test_interrupted_in_a_callback(start, model_path):
    """SIGINT ends the node without a word though a timer of a kilohertz keeps it in callbacks."""
    parameters = {"model": model_path, "cloud_rate": 1000.0, "orientation": "odometry"}
    set_all = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    node = start("physkin_ros", "--ros-args", *set_all)
    lines = iter(node.stdout.readline, "")
    assert any("->" in line for line in lines), "the node did not start"
    time.sleep(0.3)
    node.send_signal(signal.SIGINT)
    assert node.wait(60) == 0
    assert list(lines) == []


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"model": "nosuch"}, "no garment model 'nosuch'"),
        ({"model": "{tmp}/truncated.safetensors"}, "it cannot be read as safetensors"),
        ({"model": 3}, "expecting type 'STRING'"),
        ({"body_mesh": "{tmp}/nosuch.glb"}, "nosuch.glb: no such file"),
        ({"body_mesh": "{tmp}/odd.txt"}, "the extension '.txt' is unknown"),
        ({"joint_map": "{tmp}/map.json"}, "unknown key 'gain'"),
        ({"modell": "dress"}, "unknown key 'modell'; did you mean 'model'"),
        ({"fit": 1.5}, "Parameter fit out of range Min: 0.0, Max: 1.0, value: 1.5"),
    ],
)
def test_start_up_errors_are_one_line(run_main, capfd, garment_model, model_path, tmp_path, parameters, reason):
    """Exit status 2 and a sentence, no traceback."""
    (tmp_path / "truncated.safetensors").write_bytes(model_path.read_bytes()[:5000])
    (tmp_path / "map.json").write_text(json.dumps({"a": {"joint": garment_model.rig.joint_names[0], "gain": 2}}))
    values = {"model": model_path} | parameters
    assignments = [f"{name}:={value}".format(tmp=tmp_path) for name, value in values.items()]
    assert run_main("--ros-args", *(word for text in assignments for word in ("-p", text))) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("[INFO]")]
    assert len(lines) == 1 and lines[0].startswith("error: ") and reason in lines[0]


def test_arguments_that_are_none(run_main, capfd, tmp_path):
    """An unknown one shows the usage, with every parameter; a wrong configuration is one line."""
    assert run_main("--model", "tshirt") == 2
    output = capfd.readouterr().err
    assert "--model tshirt" in output and "body_mesh" in output and "geometry_msgs/Vector3Stamped" in output
    assert run_main("model:=dress", "--ros-args", "-p", "fit:=0.0") == 2
    assert "model:=dress is a parameter; parameters are given as --ros-args -p model:=dress" in capfd.readouterr().err
    assert run_main("--config") == 2
    path = tmp_path / "avatars.yaml"
    path.write_text("drape_node: " + "{a: " * 3000 + "}" * 3000)
    assert run_main("--config", str(path)) == 2
    assert f"error: config {path} is nested too deeply" in capfd.readouterr().err
    path.write_text("drape_node: {ros__parameters: {avatars: {ann: {garments: {top: {modl: tshirt}}}}}}")
    assert run_main("--config", str(path)) == 2
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith(f"error: config {path}: ") and "'modl'" in lines[0]


def test_status_0_needs_a_signal(run_main, monkeypatch):
    """What nobody thought of ends the process before there is a node, but not as if all had been well."""
    from physkin_ros.node import node_process

    def trip(path) -> None:
        raise RecursionError("odd")

    monkeypatch.setattr(node_process, "load_config", trip)
    with pytest.raises(RecursionError, match="odd"):
        run_main("--config", "avatars.yaml")
