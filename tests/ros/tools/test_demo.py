"""The demo: a table and a picture; its whole runs, also interrupted."""

from __future__ import annotations

import math
import signal
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_core import BUNDLED_AVATAR, Outfit, cli, load_avatar, load_garment_model, load_motion  # noqa: E402
from physkin_ros.tools import demo, demo_report  # noqa: E402
from physkin_ros.tools.demo_report import complete, largest_error  # noqa: E402


@pytest.fixture(scope="module")
def alone(leaning_model):
    """An outfit of one garment."""
    return Outfit([leaning_model], load_avatar(BUNDLED_AVATAR, leaning_model.rig))


@pytest.fixture(scope="module")
def outfit():
    """What the demo wears unless told otherwise."""
    models = [load_garment_model(name) for name in demo.WORN]
    return Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig))


@pytest.mark.slow
def test_demo_ends_well(start, leaning_model_path, tmp_path):
    """Every joint state comes back as a cloud; figures and picture are there."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    picture = tmp_path / "demo.png"
    arguments = ("--seconds", "2", "--garment", str(leaning_model_path), "--output", str(picture), "--motion", "crawl")
    demo = start("physkin_core.cli", "demo", *arguments)
    output, _ = demo.communicate(timeout=180)
    assert demo.returncode == 0, output
    table = _table(output)
    assert table["joint states sent"] == table["clouds received"] == "120"
    assert table["clouds lost"] == table["clouds with values not finite"] == "0"
    assert float(table["largest error [mm]"].split()[0]) < 1
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_demo_of_the_readme_ends_well(tmp_path, monkeypatch, capsys):
    """What it wears unless told otherwise, for three seconds, with a small picture."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    monkeypatch.setattr(demo_report, "PICTURE_SIZE", (42, 44))
    picture = tmp_path / "demo.png"
    assert cli.main(["demo", "--seconds", "3", "--output", str(picture)]) == 0
    assert float(_table(capsys.readouterr().out)["largest error [mm]"].split()[0]) < 1
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_interrupted_demo_leaves_nothing_running(start, model_path, tmp_path):
    """Ctrl-C while the motion plays ends the other three processes too."""
    demo = start("physkin_core.cli", "demo", "--garment", str(model_path), "--output", str(tmp_path / "demo.png"))
    for line in demo.stdout:
        if "playing" in line:
            break
    folder = next(Path(word).parent for word in _processes_naming("avatars.yaml")[0].split("\0") if "avatars" in word)
    time.sleep(1)
    assert len(_processes_naming(str(folder))) == 3
    demo.send_signal(signal.SIGINT)
    assert demo.wait(20) == 130
    assert not _processes_naming(str(folder)) and not folder.exists()
    assert not (tmp_path / "demo.png").exists()


@pytest.mark.parametrize(
    ("trouble", "lost", "status"),
    [
        ({}, "0", 0),
        ({"delays_ms": [1] * 5 + [None]}, "1", 1),
        ({"repeated": [2]}, "1", 1),
        ({"strangers": 1}, "0", 1),
        ({"not_finite": 1}, "0", 1),
        ({"delays_ms": [None] * 6}, "6", 1),
    ],
)
def test_exit_status_tells_what_was_lost(
    trouble, lost, status, made_records, leaning_model_path, alone, monkeypatch, capsys
):
    """A missing cloud, one that came twice and one of another stamp all make the demo fail, as does a bad value."""
    records = made_records(**{"delays_ms": [1, 1, 2, 1, 1, 1]} | trouble)
    monkeypatch.setattr(demo, "load_avatar", lambda *_: alone.avatar)
    monkeypatch.setattr(demo, "_play", lambda *_: records)
    assert cli.main(["demo", "--seconds", "0.1", "--garment", str(leaning_model_path)]) == status
    assert complete(records) == (status == 0)
    table = _table(capsys.readouterr().out)
    assert table["clouds lost"] == lost and table["joint states sent"] == "6"
    assert table["evaluator [µs]"] == "median of each second's p50 52.0, worst of each second's p99 90.0"
    assert table["end to end [ms]"].startswith("none" if lost == "6" else "p50 1.00, p99 ")


def test_clouds_are_compared_with_the_core(made_records, alone):
    """A cloud draped as if the body stood upright is far from right when it crawls, as is one that is not finite."""
    motion = load_motion("crawl")
    positions = motion.positions_for(alone.rig)[3]
    (right,), (upright,) = alone.drape(positions, motion.gravity[3]), alone.drape(positions)
    for cloud, least, most in ((right, 0, 1e-7), (upright, demo.ERROR_ALLOWED, 9), (right * np.nan, np.inf, np.inf)):
        records = made_records([1] * 6, kept=cloud[None], kept_stamps=np.array([15_000_000]))
        assert least <= largest_error(records, alone, motion) <= most


def test_outfits_are_compared_frame_after_frame(made_records, outfit):
    """However often the node was asked for a first cloud; layers that are not kept in order are far from right."""
    motion = load_motion("dance")
    positions = motion.positions_for(outfit.rig)
    node = outfit.twin()
    for _ in range(5):
        node.drape(positions[0])
    for frame in range(4):
        cloud = np.concatenate(node.drape(positions[frame], motion.gravity[frame], time=0.005 * frame))
    unkept = [Outfit([layer.model], outfit.avatar) for layer in outfit.layers]
    drapes = [each.drape(positions[3], motion.gravity[3])[0] for each in unkept]
    wrong = np.concatenate([drape[layer.visible] for drape, layer in zip(drapes, outfit.layers)])
    for points, least, most in ((cloud, 0, 1e-7), (wrong, demo.ERROR_ALLOWED, 9)):
        records = made_records([1] * 6, kept=points[None], kept_stamps=np.array([15_000_000]))
        assert least <= largest_error(records, outfit, motion) <= most


def test_what_swings_on_from_before_the_first_frame_does_not_count(made_records, outfit):
    """Its first second, where cloth sways; a cloud after that counts."""
    motion = load_motion("dance")
    positions, node, clouds = motion.positions_for(outfit.rig), outfit.twin(), []
    late = math.ceil(motion.rate_hz) + 1
    node.drape(positions[0])
    for frame in range(late + 1):
        drapes = node.drape(positions[frame], motion.gravity[frame], time=0.005 * frame)
        if frame in (0, late):
            clouds.append(np.concatenate(drapes))
    stamps = np.array([0, 5_000_000 * late])
    for moved, least, most in ((0, 0, 1e-7), (1, 0.009, 0.011)):
        kept = np.array(clouds)
        kept[moved, :, 0] += 0.01
        records = made_records([1] * (late + 1), kept=kept, kept_stamps=stamps)
        assert least <= largest_error(records, outfit, motion) <= most


def test_every_garment_must_answer(made_records):
    """A garment of an outfit without clouds is not complete."""
    records = made_records([1] * 6)
    assert complete(records) and not complete(records, 2)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--output", "no/demo.png"],
        ["--motion", "nosuch"],
        ["--garment", "nosuch"],
        ["--seconds", "nan"],
        ["--tucked", "nosuch"],
    ],
)
def test_wrong_arguments(arguments, capsys):
    """Told before anything is started, by their value."""
    try:
        assert cli.main(["demo", *arguments]) == 2
    except SystemExit as error:
        assert error.code == 2
    assert arguments[1] in capsys.readouterr().err


def _table(output: str) -> dict[str, str]:
    return {line[:31].strip(): line[31:].strip() for line in output.splitlines() if line.startswith("  ")}


def _processes_naming(text: str) -> list[str]:
    """Command lines of the processes that have `text` in theirs."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().decode(errors="replace"))
        except OSError:
            continue
    return [line for line in lines if text in line]
