"""Bags that unpack, follow or repeat without end: each is refused in a sentence that names the limit."""

from __future__ import annotations

import os
import re
import shutil
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

import apsw  # noqa: E402
import lz4.frame  # noqa: E402
from bag_messages import joint_state  # noqa: E402
from fuzzing import check_refusals  # noqa: E402
from rosbags.rosbag2.storage_mcap import zstd  # noqa: E402

from physkin_core import load_motion  # noqa: E402
from physkin_core.file_reading import LONGEST_SENTENCE  # noqa: E402
from physkin_core.motion import bag_limits, bag_motion  # noqa: E402
from physkin_core.motion.bag_reader import JOINT_STATE, BagError  # noqa: E402
from physkin_ros.replay.bags import BagWriter, Time  # noqa: E402

STEP = 20_000_000
"""[ns]"""


def write_bag(path, *, storage="mcap", names=lambda k: ["hip"], count=5, pause=0):
    """Joint states, the last after a pause [steps]."""
    with BagWriter(path, storage=storage) as writer:
        for k in range(count):
            time_ns = 10**9 + k * STEP + (k == count - 1) * pause * STEP
            message = joint_state(names(k), np.full(len(names(k)), 0.1 * k))
            message.header.stamp = Time(*divmod(time_ns, 10**9))
            writer.write("/joint_states", JOINT_STATE, message, time_ns)
    return path


@pytest.fixture
def folder(tmp_path):
    return write_bag(tmp_path / "bag", storage="sqlite3")


def change_metadata(folder, pattern, text):
    metadata = folder / "metadata.yaml"
    changed, times = re.subn(pattern, text, metadata.read_text())
    assert times
    metadata.write_text(changed)


def compress(folder, mode, unpacked):
    """As a recorder does it: the file, or each message. unpacked: the bytes -> what is compressed in their place."""
    (database,) = folder.glob("*.db3")
    if mode == "file":
        (folder / f"{database.name}.zstd").write_bytes(zstd.compress(unpacked(database.read_bytes())))
        database.unlink()
        change_metadata(folder, re.escape(database.name), f"{database.name}.zstd")
    else:
        with closing(apsw.Connection(str(database))) as connection:
            for key, data in list(connection.execute("SELECT id, data FROM messages")):
                connection.execute("UPDATE messages SET data = ? WHERE id = ?", (zstd.compress(unpacked(data)), key))
    change_metadata(folder, "compression_format:.*", "compression_format: zstd")
    change_metadata(folder, "compression_mode:.*", f"compression_mode: {mode}")


def refused(path, match):
    with pytest.raises(BagError, match=match) as error:
        load_motion(path)
    assert len(str(error.value)) <= LONGEST_SENTENCE


@pytest.mark.parametrize("mode", ["file", "message"])
def test_compressed_bags_are_read(mode, folder):
    whole = load_motion(folder)
    compress(folder, mode, lambda data: data)
    np.testing.assert_array_equal(load_motion(folder).positions, whole.positions)


def test_files_that_unpack_without_end(folder, monkeypatch):
    """Nothing is written to the disk before."""
    monkeypatch.setattr(bag_limits, "ALWAYS_UNPACKED", 1 << 20)
    compress(folder, "file", lambda data: data + bytes(1 << 22))
    refused(folder, "bag.db3.zstd unpacks to more than the 1048576 bytes that are allowed")


def test_messages_that_unpack_without_end(folder):
    compress(folder, "message", lambda data: data + bytes(bag_limits.LARGEST_MESSAGE))
    refused(folder, "one of its messages has more than the 16777216 bytes that are allowed")


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_chunks_that_unpack_without_end(kind):
    """To more than they claim, and what they claim."""
    unpack, pack = bag_limits.DECOMPRESSORS[kind], {"zstd": zstd.compress, "lz4": lz4.frame.compress}[kind]
    assert unpack(pack(bytes(100)), 100) == bytes(100)
    assert len(unpack(pack(bytes(1 << 22)), 100)) == 101
    for size, most in ((100, 1 << 24), (1 << 20, 100 << 20), (1 << 23, 1 << 28)):
        with pytest.raises(bag_limits.ReaderError, match=f"a chunk of {size} bytes claims .* allowed are {most}"):
            unpack(bytes(size), most + 1)


def test_chunks_that_unpack_too_often(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_limits, "ALWAYS_UNPACKED", 100)
    monkeypatch.setattr(bag_limits, "MOST_UNPACKED", 0.01)
    refused(write_bag(tmp_path / "bag.mcap"), "the chunks of bag.mcap unpack to [0-9]+ bytes, allowed are 100")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("storage_identifier: &a mcap\n  x: *a", "it has an alias"),
        (f"storage_identifier: {'[' * 30}{']' * 30}", "it is nested more than 20 deep"),
        (f"storage_identifier: {'x' * (1 << 20)}", "'metadata.yaml' has [0-9]+ bytes, allowed are 1048576"),
    ],
)
def test_descriptions_without_end(text, reason, folder):
    change_metadata(folder, "storage_identifier:.*", text)
    refused(folder, reason)


@pytest.mark.parametrize("mode", ["none", "file"])
def test_a_view_in_the_place_of_a_table(mode, folder):
    """It has rows without end."""
    (database,) = folder.glob("*.db3")
    with closing(apsw.Connection(str(database))) as connection:
        connection.execute("DROP TABLE message_definitions")
        endless = "WITH RECURSIVE k(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM k) SELECT n AS id"
        columns = ("topic_type", "encoding", "encoded_message_definition", "type_description_hash")
        row = ", ".join(f"'' AS {column}" for column in columns)
        connection.execute(f"CREATE VIEW message_definitions AS {endless}, {row} FROM k")
    if mode == "file":
        compress(folder, "file", lambda data: data)
    refused(folder, "Cannot open database .*: no such table: main.k")


def test_topics_without_end(folder, monkeypatch):
    monkeypatch.setattr(bag_limits, "MOST_TOPICS", 0)
    refused(folder, "it has 1 topics, allowed are 0")


def test_pipes_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    refused(tmp_path / "pipe.mcap", "pipe.mcap is not a regular file")


def test_new_names_in_each_message(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_motion, "LARGEST_NAMES", 10_000)
    bag = write_bag(tmp_path / "bag.mcap", names=lambda k: [f"{k} {j}" for j in range(100)])
    refused(bag, "all different joint names takes [0-9]+ bytes after [0-9]+, allowed are 10000")
    assert load_motion(write_bag(tmp_path / "same.mcap", names=lambda k: [f"{j}" for j in range(100)])).frame_count == 5


def test_frames_without_end(tmp_path, monkeypatch):
    """A pause after many messages, and a few frames of very many joints."""
    bag = write_bag(tmp_path / "pause.mcap", count=10, pause=900)
    assert load_motion(bag).frame_count == 910
    monkeypatch.setattr(bag_motion, "LARGEST_CLIP", 7279)
    refused(bag, "910 frames of 1 joints take 7280 bytes, allowed are 7279")
    monkeypatch.setattr(bag_motion, "MOST_FRAMES", 900)
    refused(bag, "allowed are 100 frames for each of them, and 900 in all")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run.mcap", "run.db3"])
def test_a_thousand_damages(name, tmp_path):
    """Each file is read, or refused in one sentence."""
    whole = write_bag(tmp_path / name)
    assert check_refusals(load_motion, whole, BagError, range(1000)) > 300


@pytest.mark.slow
@pytest.mark.parametrize("file", ["metadata.yaml", "run.db3.zstd"])
def test_a_thousand_damages_of_folders(file, tmp_path):
    """Their description, and what they have compressed."""
    folder = write_bag(tmp_path / "run", storage="sqlite3")
    if file.endswith(".zstd"):
        compress(folder, "file", lambda data: data)

    def read(path):
        bag = tmp_path / "bag"
        shutil.rmtree(bag, ignore_errors=True)
        shutil.copytree(folder, bag, ignore=shutil.ignore_patterns("damaged_*"))
        shutil.copy(path, bag / file)
        load_motion(bag)

    assert check_refusals(read, folder / file, BagError, range(1000)) > 300
