"""Figures of outfits: what the command writes, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from physkin_core import load_motion
from physkin_core.cli import main
from physkin_core.motion.loading import save_motion
from physkin_training.evaluate.outfit_evaluation import parse_outfit

FIGURES = {
    *("shows_through_percent", "skin_shows_percent", "hole_percent", "added_strain_points", "added_jitter_ratio"),
    *("hidden_vertices_percent", "pairs", "garments"),
}


def test_names_of_outfits():
    assert [(g.model.name, g.tucked) for g in parse_outfit("tshirt:tucked,trousers")] == [
        ("tshirt", True),
        ("trousers", False),
    ]
    for text, message in {
        "tshirt": "at least two garments, got 1",
        "tshirt:in,trousers": "unknown fabric 'in'",
        "tshirt,": "",
    }.items():
        with pytest.raises(ValueError, match=message):
            parse_outfit(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give one of MODEL and --outfit"),
        (["tshirt", "--outfit", "trousers,tshirt"], "give one of MODEL and --outfit"),
        (["--outfit", "trousers,tshirt", "--minimum", "4"], "--minimum is an option of MODEL, not of --outfit"),
        (["--outfit", "trousers,tshirt", "--motion"], "at least one clip"),
        (["--outfit", "trousers,tshirt", "--motion", "dance", "--bodies", "0"], "bodies must be 1 to"),
        (["--outfit", "trousers,tshirt", "--outfit", "trousers,tshirt"], "is given twice"),
    ],
)
def test_the_command_refuses_what_does_not_go_together(arguments, message, capsys):
    assert main(["evaluate", *arguments, "--device", "cpu"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error


@pytest.mark.slow
def test_the_command_writes_all_figures(tmp_path, capsys):
    """Of an outfit in a moment of a shipped clip: order leaves next to nothing to see, at a small cost."""
    clip = load_motion("dance")
    arrays = ("positions", "root_orientation", "root_position")
    short = replace(clip, name="short", **{name: getattr(clip, name)[60:75] for name in arrays})
    save_motion(short, tmp_path / "short.safetensors")
    outfits = ["--outfit", "tshirt:tucked,trousers"]
    outputs = ["--motion", str(tmp_path / "short.safetensors"), "--json", str(tmp_path / "scores.json")]
    assert main(["evaluate", *outfits, *outputs, "--bodies", "1", "--device", "cpu"]) == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["counts"] == {"bodies": 1, "clips": 1, "frames": 1, "stride": 60, "run": 5}
    assert set(scores["outfit"]) == {"tshirt:tucked,trousers"}
    table = capsys.readouterr().out
    for name, figures in scores["outfit"].items():
        assert f"| {name} " in table
        assert set(figures) == FIGURES | {"clips"} and set(figures["clips"]) == {"short"}
        assert set(figures["pairs"]) == {name.replace(":tucked", "")}
        assert 0 <= figures["shows_through_percent"] < 2 and figures["hole_percent"] < 0.5
        assert 0 <= figures["skin_shows_percent"] < 10 and 0 < figures["hidden_vertices_percent"] < 30
        assert 0.9 < figures["added_jitter_ratio"] < 1.3
        assert -1 < figures["added_strain_points"] < 6  # a loose hem is taken in
