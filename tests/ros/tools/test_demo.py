"""The demo: a table and a picture; its whole runs, also interrupted."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path
from unittest.mock import patch

import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_core import BUNDLED_AVATAR, Outfit, WornGarment, cli, load_avatar, load_garment_model  # noqa: E402
from physkin_ros.tools import demo  # noqa: E402


@pytest.fixture(autouse=True)
def environment():
    """The demo chooses a ROS domain for itself and its processes."""
    with patch.dict(os.environ):
        yield


def test_the_demo_of_the_readme_ends_well(tmp_path, monkeypatch, capfd):
    """What it wears unless told otherwise, for three seconds, with a small picture."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    monkeypatch.setattr(demo, "PICTURE_SIZE", (42, 44))
    picture = tmp_path / "demo.png"
    assert cli.main(["demo", "--seconds", "3", "--output", str(picture)]) == 0
    assert _table(capfd.readouterr().out)["clouds received"] == "360 of 360"
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_interrupted_demo_leaves_nothing_running(start, model_path, tmp_path):
    """Ctrl-C while the motion plays ends the node and the player too."""
    demo = start("physkin_core.cli", "demo", "--garment", str(model_path), "--output", str(tmp_path / "demo.png"))
    for line in demo.stdout:
        if "playing" in line:
            break
    folder = next(Path(word).parent for word in _processes_naming("avatars.yaml")[0].split("\0") if "avatars" in word)
    time.sleep(1)
    assert _processes_naming(str(folder))
    demo.send_signal(signal.SIGINT)
    assert demo.wait(20) == 130
    assert not _processes_naming(str(folder)) and not folder.exists()
    assert not (tmp_path / "demo.png").exists()


@pytest.mark.parametrize(
    ("trouble", "lost", "late", "status"),
    [
        ({}, "0", "median 1.00 ms, 99 % within 1.95 ms, worst 2.00 ms", 0),
        ({"delays_ms": [1] * 5 + [None]}, "1", "median 1.00 ms, 99 % within 1.00 ms, worst 1.00 ms", 1),
        ({"repeated": [2]}, "0", "median 1.00 ms, 99 % within 1.95 ms, worst 2.00 ms", 1),
        ({"strangers": 1}, "0", "median 1.00 ms, 99 % within 1.95 ms, worst 2.00 ms", 1),
        ({"not_finite": 1}, "0", "median 1.00 ms, 99 % within 1.95 ms, worst 2.00 ms", 1),
        ({"delays_ms": [None] * 6}, "6", "none came", 1),
    ],
)
def test_exit_status_tells_what_was_lost(trouble, lost, late, status, made_records, model_path, monkeypatch, capsys):
    """A missing cloud, one that came twice and one of another stamp all make the demo fail, as does a bad value."""
    monkeypatch.setattr(demo, "_play", lambda *_, **__: made_records(**{"delays_ms": [1, 1, 2, 1, 1, 1]} | trouble))
    assert cli.main(["demo", "--seconds", "0.1", "--garment", str(model_path)]) == status
    table = _table(capsys.readouterr().out)
    assert (table["clouds lost"], table["joint state to cloud"]) == (lost, late)
    assert table["joint states sent"].startswith("6, ")


def test_what_clouds_cost_is_told(made_records, model_path):
    """Of joint states all of whose clouds came, once; two are lost here, and one comes twice."""
    model = load_garment_model(model_path)
    outfit = Outfit([WornGarment(model)], load_avatar(BUNDLED_AVATAR, model.rig))
    records = made_records([9, None] + [8] * 8 + [1] * 18 + [3, None], avatars=2, repeated=[12])
    table = _table(demo.report(records, outfit))
    assert (table["avatars"], table["joint states sent"]) == ("2", "30, 90.00 % of them draped")
    assert table["evaluation"] == "median 52 µs, 99 % within 80 µs, as the node says"
    assert table["processor time a joint state"] == "133 µs of the thread that drapes, 200 of all"
    nothing = _table(demo.report(made_records([None] * 20, avatars=2, reports=[], measured=()), outfit))
    assert nothing["joint states sent"].endswith(" 0.00 % of them draped")
    assert not {"evaluation", "processor time a joint state"} & nothing.keys()


@pytest.mark.slow
def test_many_avatars_are_measured_without_a_picture(start, model_path, tmp_path):
    """Every cloud comes back; what the evaluator takes is a part of what the thread does, and that of all threads."""
    options = ["--avatars", "2", "--rate", "30", "--seconds", "2", "--no-picture", "-o", str(tmp_path / "demo.png")]
    process = start("physkin_core.cli", "demo", "-g", str(model_path), *options)
    output, _ = process.communicate(timeout=180)
    assert process.returncode == 0, output
    table = _table(output)
    assert (table["clouds received"], table["joint states sent"]) == ("120 of 120", "120, 100.00 % of them draped")
    first, whole = re.findall(r"\d+", table["processor time a joint state"])
    evaluation = re.findall(r"\d+", table["evaluation"])[0]
    assert 0 < int(evaluation) < int(first) <= int(whole)
    assert not (tmp_path / "demo.png").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--output", "no/demo.png"],
        ["--motion", "nosuch"],
        ["--garment", "nosuch"],
        ["--seconds", "nan"],
        ["--avatars", "0"],
        ["--rate", "-5"],
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
    return {line[:33].strip(): line[33:].strip() for line in output.splitlines() if line.startswith("  ")}


def _processes_naming(text: str) -> list[str]:
    """Command lines of the processes that have `text` in theirs."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().decode(errors="replace"))
        except OSError:
            continue
    return [line for line in lines if text in line]
