"""The node serves DDS participants that know nothing of ROS."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

PARTICIPANT = Path(__file__).parents[1] / "dds_participant.py"
LOCAL = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="needs cyclonedds: pip install cyclonedds")
def test_another_dds_without_ros(start, domain, garment_model, model_path, tmp_path):
    """Joint states from Cyclone DDS are answered there with the core's clouds, laid out as a PointCloud2."""
    rig = garment_model.rig
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, rig))
    poses = np.random.default_rng(8).uniform(rig.lower, rig.upper, size=(5, len(rig.joint_names)))
    stamps = np.array([(0, 0), (7, 999_999_999), (8, 5), (2_000_000_000, 1), (9, 9)])
    states, output = tmp_path / "states.npz", tmp_path / "clouds.npz"
    np.savez(states, names=np.array(rig.joint_names), positions=poses, stamps=stamps)
    start("physkin_ros", "--ros-args", "-p", f"model:={model_path}", "-p", "frame_id:=torso")
    participant = subprocess.run(
        [sys.executable, str(PARTICIPANT), str(domain), str(states), str(output)],
        env=dict(os.environ, CYCLONEDDS_URI=LOCAL),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=90,
    )
    assert participant.returncode == 0, participant.stdout
    with np.load(output) as received:
        np.testing.assert_array_equal(received["stamps"], stamps)
        for cloud, pose in zip(received["clouds"], poses):
            np.testing.assert_array_equal(cloud, draper.drape(pose.astype(np.float32)))
        fields = "x:0:7:1,y:4:7:1,z:8:7:1,normal_x:12:7:1,normal_y:16:7:1,normal_z:20:7:1"
        assert set(received["layouts"].tolist()) == {f"torso 1 False True {fields}"}
