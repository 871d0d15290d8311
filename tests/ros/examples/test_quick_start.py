"""What docs/node.md lets a newcomer try: its three lines, the example that reads clouds, and files for viewers."""

from __future__ import annotations

import json
import re
import select
import shlex
import subprocess
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import yaml

from physkin_core.model.model_file import shipped_models
from physkin_ros.messages.topics import GARMENT, MARKER

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

ROOT = Path(__file__).parents[3]
CONFIG, EXAMPLES = ROOT / "physkin_ros" / "config", ROOT / "physkin_ros" / "examples"
SAID = re.compile(r"base_link: (\d+) vertices, (-?\d\.\d{3}) to (-?\d\.\d{3}) m high")


@pytest.fixture
def start_reader(domain):
    """Starts the example on a topic; ended with the test."""
    readers = []

    def start(topic: str) -> subprocess.Popen:
        command = [sys.executable, EXAMPLES / "read_clouds.py", topic]
        readers.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        return readers[-1]

    yield start
    for reader in readers:
        reader.terminate()
        try:
            reader.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            reader.kill()
            reader.communicate()


def test_example_reads_clouds(peer, running_node, model_path, start_reader, draper):
    """The vertices that the node sent, by their fields' names and offsets."""
    names = draper.joint_names
    positions = np.zeros(len(names), dtype=np.float32)
    heights = draper.drape(positions)[:, 2]
    with running_node({"model": str(model_path)}):
        reader = start_reader("/drape_node/garment")
        stamps = ((1, nanosecond) for nanosecond in count())

        def has_spoken() -> bool:  # the first clouds may come before the node knows of its reader
            peer.cloud(names, positions, next(stamps))
            return bool(select.select([reader.stdout], [], [], 0.05)[0])

        peer.until(has_spoken, "line of the reader")
        vertices, lowest, highest = SAID.match(reader.stdout.readline()).groups()
    assert int(vertices) == len(heights)
    assert [float(lowest), float(highest)] == pytest.approx([heights.min(), heights.max()], abs=1e-3)


@pytest.mark.slow
def test_three_lines_show_an_outfit(start, start_reader, tmp_path, monkeypatch):
    """As they stand in the docs: while the last one plays, clouds of both garments come."""
    pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")
    section = (ROOT / "docs" / "node.md").read_text().split("## Try it")[1]
    lines = [shlex.split(line) for line in section.split("```")[1].strip().splitlines()]
    assert len(lines) == 3 and all(line[0] == "physkin" for line in lines)
    node, convert, replay = (line[1:] for line in lines)
    monkeypatch.chdir(tmp_path)
    start("physkin_core.cli", *node)
    assert start("physkin_core.cli", *convert).wait(60) == 0
    readers = [start_reader(f"/drape_node/{garment}/garment") for garment in node[-1].split(":=")[1].split(",")]
    player = start("physkin_core.cli", *replay)
    assert all(SAID.match(reader.stdout.readline()) for reader in readers)
    assert player.wait(90) == 0 and player.stdout.read().startswith("sent ")


def topics_in_rviz() -> set[str]:
    shown = yaml.safe_load((CONFIG / "drape.rviz").read_text())["Visualization Manager"]["Displays"]
    return {display["Topic"]["Value"] for display in shown if "Topic" in display}


def topics_in_foxglove() -> set[str]:
    return set(json.loads((CONFIG / "drape.foxglove.json").read_text())["configById"]["3D!garment"]["topics"])


@pytest.mark.parametrize("topics", [topics_in_rviz, topics_in_foxglove])
def test_viewers_show_one_garment_and_every_outfit(topics):
    """Cloud and marker, below the node's name or below that of each shipped model."""
    places = ["/drape_node", *(f"/drape_node/{model}" for model in shipped_models())]
    assert topics() == {topic.below(place) for place in places for topic in (GARMENT, MARKER)}
