"""`physkin fit-garment` with a sewing pattern in place of a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from training.sewing.patterns import tube_skirt, written

from physkin_core.cli import main
from physkin_core.formats.obj_file import read_obj
from physkin_core.model.garment import load_garment


@pytest.mark.slow
def test_a_pattern_is_sewn_and_checked(tmp_path, capsys, no_pictures):
    path = written(tmp_path, tube_skirt(waist=43.0))
    output = ["-o", str(tmp_path / "own.safetensors"), "--device", "cpu"]
    assert main(["fit-garment", str(path), *output, "--edge-length", "0.04", "--check-only"]) == 0
    assert "flat rest shape" in capsys.readouterr().out
    garment = load_garment(tmp_path / "own" / "garment.obj")
    assert garment.panel_places is not None
    assert garment.face_areas.sum() == pytest.approx(0.515, rel=1e-3), "it rests as it was cut"
    file = read_obj(tmp_path / "own" / "garment.obj")
    assert {names.object for names in file.names} == {"front", "back"}
    for index, names in enumerate(file.names):
        side = garment.vertices[file.faces[file.face_names == index]][..., 0].mean()
        assert side > 0.02 if names.object == "front" else side < 0.02
    np.testing.assert_allclose(np.ptp(garment.panel_places, axis=0).max(), 1.22, atol=0.2)


@pytest.mark.parametrize(
    "name, arguments, message",
    [
        ("pattern.json", ["--edge-length", "0.2"], "edge length 0.2 m, allowed are 0.006 to 0.04 m"),
        (
            "skirt.obj",
            ["--edge-length", "0.02"],
            "--edge-length belongs to a sewing pattern (.json); skirt.obj is a mesh",
        ),
        ("pattern.json", ["--object", "front"], "--object belongs to a mesh; pattern.json is a sewing pattern"),
        ("broken.json", [], "broken.json"),
    ],
)
def test_errors(tmp_path, capsys, monkeypatch, name, arguments, message):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, tube_skirt())
    (tmp_path / "broken.json").write_text("{}")
    assert main(["fit-garment", name, "-o", "own.safetensors", "--device", "cpu", "--check-only", *arguments]) == 2
    assert message in capsys.readouterr().err
