"""Bags that are compressed, too long or damaged: read, or refused in a sentence."""

from __future__ import annotations

import re
import shutil
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

import apsw  # noqa: E402
from bag_messages import write_bag  # noqa: E402
from fuzzing import check_refusals  # noqa: E402
from rosbags.rosbag2.storage_mcap import zstd  # noqa: E402

from physkin_core import load_motion  # noqa: E402
from physkin_core.file_reading import LONGEST_SENTENCE  # noqa: E402
from physkin_core.motion import bag_motion  # noqa: E402
from physkin_core.motion.bag_reader import BagError  # noqa: E402


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


def test_frames_without_end(tmp_path, monkeypatch):
    """A pause after many messages, and a few frames of very many joints."""
    bag = write_bag(tmp_path / "pause.mcap", count=10, pause=900)
    assert load_motion(bag).frame_count == 910
    monkeypatch.setattr(bag_motion, "LARGEST_CLIP", 7279)
    refused(bag, "910 frames of 1 joints take 7280 bytes, allowed are 7279")
    monkeypatch.setattr(bag_motion, "MOST_FRAMES", 900)
    refused(bag, "allowed are 100 frames for each of them, and 900 in all")


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
