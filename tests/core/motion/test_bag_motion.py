"""Bags as clips: what is recorded comes back at an even rate, whatever joints a message names."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from bag_messages import Time, gravity, joint_state  # noqa: E402

from physkin_core import load_motion  # noqa: E402
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE, ODOMETRY, BagError  # noqa: E402
from physkin_core.motion.motion import MotionError  # noqa: E402
from physkin_ros.replay.bags import BagWriter, RootMessages, write_motion  # noqa: E402

STEP = 20_000_000
"""[ns]"""


def write_states(path, states, *, gravities=()):
    """Joint states (time [ns], names, positions), stamped and recorded then, and gravity (time, vector)."""
    with BagWriter(path) as writer:
        for time_ns, vector in gravities:
            message = gravity(*vector)
            message.header.stamp = Time(*divmod(time_ns, 10**9))
            writer.write("/gravity", GRAVITY, message, time_ns)
        for time_ns, names, positions in states:
            message = joint_state(names, positions)
            message.header.stamp = Time(*divmod(time_ns, 10**9))
            writer.write("/joint_states", JOINT_STATE, message, time_ns)
    return path


@pytest.mark.parametrize("name", ["turn.mcap", "turn.db3", "turn"])
def test_a_clip_comes_back_from_a_bag(tmp_path, name):
    """Names, positions, gravity and rate; of a folder too. The root is turned no more than gravity tells."""
    clip = load_motion("cartwheel")
    with BagWriter(tmp_path / name) as writer:
        write_motion(writer, clip, frame_id="torso")
    read = load_motion(tmp_path / name)
    assert read.joint_names == clip.joint_names and read.name == "turn"
    assert read.rate_hz == pytest.approx(clip.rate_hz, rel=1e-6) and read.frame_count == clip.frame_count
    np.testing.assert_allclose(read.positions, clip.positions, atol=1e-6)
    np.testing.assert_allclose(read.gravity, clip.gravity, atol=1e-5)
    assert not read.root_position.any()


def test_the_root_comes_back_from_odometry(tmp_path):
    """Where it is and how it is turned, whatever the signs of quaternions."""
    clip = load_motion("cartwheel")
    signs = np.where(np.arange(clip.frame_count) % 3, 1.0, -1.0)[:, None]
    with BagWriter(tmp_path / "turn.mcap") as writer:
        write_motion(
            writer, replace(clip, root_orientation=signs * clip.root_orientation), frame_id="a", world_frame="b"
        )
    read = load_motion(tmp_path / "turn.mcap")
    np.testing.assert_allclose(read.root_position, clip.root_position, atol=1e-4)
    same = np.abs((read.root_orientation * clip.root_orientation).sum(axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-5)


def test_odometry_of_another_body_is_left_out(tmp_path, caplog):
    """A cart that stays level under somebody who turns over; gravity says so."""
    clip = load_motion("cartwheel")
    level = replace(clip, root_orientation=np.tile([0.0, 0.0, 0.0, 1.0], (clip.frame_count, 1)))
    cart = RootMessages(level, frame_id="cart", world_frame="map")
    with BagWriter(tmp_path / "cart.mcap") as writer:
        write_motion(writer, clip, frame_id="torso")
        for frame in range(clip.frame_count):
            time_ns = 10**9 + round(frame * 1e9 / clip.rate_hz)
            writer.write("/odom", ODOMETRY, cart.odometry(frame, time_ns), time_ns)
    read = load_motion(tmp_path / "cart.mcap")
    assert "odometry and gravity differ by" in caplog.text and not read.root_position.any()
    np.testing.assert_allclose(read.gravity, clip.gravity, atol=1e-5)


def test_joints_are_interpolated_between_the_messages_that_name_them(tmp_path):
    """One comes every time, one at first and last alone, one message is missing; there is no gravity."""
    states = [(k * STEP, ["hip"], [0.1 * k]) for k in (2, 3, 5, 6)]
    states[0], states[-1] = (2 * STEP, ["knee", "hip"], [0.0, 0.2]), (6 * STEP, ["hip", "knee"], [0.6, 0.8])
    read = load_motion(write_states(tmp_path / "bag.mcap", states))
    assert read.rate_hz == pytest.approx(50) and set(read.joint_names) == {"hip", "knee"}
    columns = dict(zip(read.joint_names, read.positions.T))
    np.testing.assert_allclose(columns["hip"], [0.2, 0.3, 0.4, 0.5, 0.6], atol=1e-6)
    np.testing.assert_allclose(columns["knee"], [0.0, 0.2, 0.4, 0.6, 0.8], atol=1e-6)
    np.testing.assert_allclose(read.gravity, [[0, 0, -1]] * 5, atol=1e-7)


def test_times_are_the_stamps_where_all_have_one(tmp_path):
    """Recording came late once; without stamps its times count."""
    for stamped, middle in ((True, 0.5), (False, 0.25)):
        path = tmp_path / f"{stamped}.mcap"
        with BagWriter(path) as writer:
            for k, recorded in ((1, 1), (2, 3), (3, 4), (4, 5)):
                message = joint_state(["hip"], [0.25 * (k - 1)])
                message.header.stamp = Time(0, k * STEP) if stamped else Time(0, 0)
                writer.write("/joint_states", JOINT_STATE, message, recorded * STEP)
        read = load_motion(path)
        assert read.frame_count == (4 if stamped else 5)
        assert read.positions[2, 0] == pytest.approx(middle)


def test_messages_that_cannot_be_used_are_left_out(tmp_path, caplog):
    """Too few positions, none finite, no direction, bytes that are no message."""
    states = [(k * STEP, ["hip"], [0.1 * k]) for k in (1, 2, 3)]
    states += [(4 * STEP, ["hip", "knee"], [1.0]), (5 * STEP, ["hip"], [np.nan]), (6 * STEP, [], [])]
    downs = [(STEP, (0, 0, -9.81)), (2 * STEP, (0, 0, 0)), (3 * STEP, (np.inf, 0, 0))]
    read = load_motion(write_states(tmp_path / "bag.mcap", states, gravities=downs))
    assert read.frame_count == 3 and "5 messages" in caplog.text
    np.testing.assert_allclose(read.gravity, [[0, 0, -1]] * 3, atol=1e-7)


def test_what_a_joint_state_lacks_is_interpolated(tmp_path, caplog):
    """A position that is not finite is left out alone, with a warning; joint states without any go without a word, and
    so does a joint that never has one."""
    states = [(k * STEP, ["hip", "knee", "tail"], [0.1 * k, 1.0 + k, np.nan]) for k in range(1, 6)]
    states[2][2][0], states[3][2][1] = np.nan, np.inf
    bare = [(round((k + 0.5) * STEP), ["hip", "knee"], []) for k in range(1, 5)]
    read = load_motion(write_states(tmp_path / "bag.mcap", states + bare))
    assert read.joint_names == ("hip", "knee") and caplog.messages == [
        f"bag {tmp_path / 'bag.mcap'}: positions of 5 joint states are not finite; these are interpolated"
    ]
    np.testing.assert_allclose(read.positions, [[0.1 * k, 1 + k] for k in range(1, 6)], atol=1e-6)
    with pytest.raises(BagError, match="needs joint states with positions at two times at least, /joint_states has 0"):
        load_motion(write_states(tmp_path / "bare.mcap", bare))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_folder_without_its_list_of_files(tmp_path, storage):
    """One recording is read all the same; of several the order is not known. Included motions go first."""
    clip = load_motion("walk")
    for name in ("turn", "more"):
        with BagWriter(tmp_path / name, storage=storage) as writer:
            write_motion(writer, clip, frame_id="torso")
        (tmp_path / name / "metadata.yaml").unlink()
    np.testing.assert_allclose(load_motion(tmp_path / "turn").positions, clip.positions, atol=1e-6)
    for file in (tmp_path / "more").iterdir():
        file.rename(tmp_path / "turn" / f"more{file.suffix}")
    for folder, count in (("turn", 2), ("more", 0)):
        with pytest.raises(
            BagError, match=f"has {count} .mcap or .db3 files and no metadata.yaml, which ros2 bag reind"
        ):
            load_motion(tmp_path / folder)


def test_a_folder_named_as_an_included_motion(tmp_path, monkeypatch):
    """The motion is meant."""
    (tmp_path / "walk").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_motion("walk").name == "walk"


def test_bags_that_are_no_clip_are_refused(tmp_path):
    one = write_states(tmp_path / "one.mcap", [(STEP, ["hip"], [0.0])] * 3)
    with pytest.raises(BagError, match="two times at least, /joint_states has 1"):
        load_motion(one)
    apart = write_states(tmp_path / "apart.mcap", [(k * STEP, ["hip"], [0.0]) for k in (1, 2, 3, 10_000)])
    with pytest.raises(BagError, match="4 joint states 20 ms apart span 200 s"):
        load_motion(apart)
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(MotionError, match="text.mcap"):
        load_motion(tmp_path / "text.mcap")
    with pytest.raises(MotionError, match="missing.db3"):
        load_motion(tmp_path / "missing.db3")


def test_what_bags_need_is_named(tmp_path, monkeypatch):
    """Where rosbags is not installed."""
    for name in [name for name in sys.modules if name.startswith("physkin_core.motion.bag_")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(MotionError, match=r"cannot read bag .*walk.mcap: .*rosbags.*pip install .*\[replay\]'"):
        load_motion(tmp_path / "walk.mcap")
