"""The demo: three processes, a table and a picture; and what it does when something goes wrong."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_motion  # noqa: E402
from physkin_ros.tools.children import ChildFailedError, Children  # noqa: E402
from physkin_ros.tools.demo import ERROR_ALLOWED  # noqa: E402
from physkin_ros.tools.demo_report import DemoReport  # noqa: E402


def test_demo_ends_well(start, leaning_model_path, tmp_path):
    """Every joint state comes back as a cloud; figures and picture are there."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    picture = tmp_path / "demo.png"
    arguments = ("--seconds", "2", "--garment", str(leaning_model_path), "--output", str(picture), "--motion", "crawl")
    demo = start("physkin_core.cli", "demo", *arguments)
    output, _ = demo.communicate(timeout=120)
    assert demo.returncode == 0, output
    table = {line[:32].strip(): line[32:].strip() for line in output.splitlines() if line.startswith("  ")}
    assert table["joint states sent"] == table["clouds received"] == "120"
    assert table["clouds lost"] == table["clouds with values not finite"] == "0"
    assert float(table["largest error [mm]"].split()[0]) < 1
    assert table["evaluator [us]"].startswith("median of each second's p50 ")
    assert table["end to end [ms]"].startswith("p50 ")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_interrupted_demo_leaves_nothing_running(start, model_path, tmp_path):
    """Ctrl-C while the motion plays ends the other three processes too."""
    demo = start("physkin_core.cli", "demo", "--garment", str(model_path), "--output", str(tmp_path / "demo.png"))
    for line in demo.stdout:
        if "playing" in line:
            break
    time.sleep(1)
    # The demo and its node; and for a moment the player, which until it has begun goes by its parent's command line.
    deadline = time.monotonic() + 10
    while len(running := _processes_naming(str(model_path))) != 2:
        assert time.monotonic() < deadline, running
        time.sleep(0.05)
    demo.send_signal(signal.SIGINT)
    assert demo.wait(20) == 130
    assert not _processes_naming(str(model_path))
    assert not (tmp_path / "demo.png").exists()


def test_child_that_fails_is_heard(tmp_path):
    """Waiting ends at once, with what the child wrote."""
    with Children(os.environ, tmp_path) as children:
        children.start("player", "physkin_ros.tools.demo_player", "nosuchmotion", "1", tmp_path / "sent.npz")
        with pytest.raises(
            ChildFailedError, match="player ended with status 2:\nerror: no bundled motion 'nosuchmotion'"
        ):
            children.wait(lambda: False, "a miracle", seconds=30)


def test_killed_child_leaves_no_shared_memory(domain, model_path, tmp_path):
    """A node that must be killed cannot tidy up, so its parent does."""
    with Children(os.environ, tmp_path) as children:
        children.start("node", "physkin_ros", "--ros-args", "-p", f"model:={model_path}")
        children.wait(lambda: "garment" in children.log("node"), "the node", seconds=60)
        node = children._processes["node"]
        opened = _shared_memory_of(node.pid)
        assert opened
        node.send_signal(signal.SIGSTOP)  # deaf to SIGINT, so that it is killed
    assert node.returncode == -signal.SIGKILL
    assert not [path for path in opened if path.exists()]


def test_report_counts_what_was_lost():
    """A missing cloud, one that came twice and one of another stamp all make the demo fail, as does a bad value."""
    sent = np.arange(5) * 1_000_000
    assert _report(sent, sent, [True] * 5).complete
    assert not _report(sent, sent, [True, True, False, True, True]).complete
    for received, lost in ((sent[:4], 1), (sent[[0, 1, 2, 3, 3]], 2), ([*sent[:4], 99], 1), ([], 5)):
        report = _report(sent, received, [True] * len(received))
        assert report.lost == lost and not report.complete


def test_report_measures_latency():
    """Receipt minus sending of the same stamp, whatever order the clouds come in."""
    report = _report(np.array([10, 20, 30]), [30, 10, 99], [True] * 3, received=[5_000_030, 2_000_010, 0])
    np.testing.assert_allclose(report.latencies_ms(), [5.0, 2.0])


def test_report_compares_with_the_core(leaning_model):
    """A cloud draped as if the body stood upright is far from right when it crawls, as is one that is not finite."""
    draper, motion = Draper(leaning_model, load_avatar(BUNDLED_AVATAR, leaning_model.rig)), load_motion("crawl")
    order = [motion.joint_names.index(name) for name in draper.joint_names]
    positions = motion.positions[3][order]
    right, upright = draper.drape(positions, motion.gravity[3]), draper.drape(positions)
    stamps = np.arange(motion.frame_count)
    report = replace(_report(stamps, stamps, [True]), kept_stamps=stamps[3:4], kept=right[None])
    assert report.largest_error(draper, motion) < 1e-7
    assert replace(report, kept=upright[None]).largest_error(draper, motion) > ERROR_ALLOWED
    assert replace(report, kept=right[None] * np.nan).largest_error(draper, motion) == np.inf


def _report(sent, stamps, finite, received=None) -> DemoReport:
    stamps = np.array(stamps, dtype=np.int64)
    return DemoReport(
        stamps=sent,
        sent=sent,
        received_stamps=stamps,
        received=stamps if received is None else np.array(received),
        finite=np.array(finite, dtype=bool),
        kept_stamps=stamps[:0],
        kept=np.zeros((0, 1, 6)),
        reports=[],
    )


def _processes_naming(text: str) -> list[str]:
    """Command lines of the processes that have `text` in theirs."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().decode(errors="replace"))
        except OSError:
            continue
    return [line for line in lines if text in line]


def _shared_memory_of(pid: int) -> set[Path]:
    """The process's own segments, not the ports it may share."""
    words = Path(f"/proc/{pid}/maps").read_text().split()
    return {Path(word) for word in words if word.startswith("/dev/shm/fastrtps_") and "_port" not in word}
