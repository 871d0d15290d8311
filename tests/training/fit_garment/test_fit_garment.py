"""`physkin fit-garment`: checks, training and report of a small band on the CPU, and its errors."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
pytest.importorskip("warp", reason="needs the [training] extra")

from training.small_runs import as_toml as small_toml  # noqa: E402
from training.small_runs import small_config, write_belly_band  # noqa: E402

from physkin_core import load_garment, load_garment_model  # noqa: E402
from physkin_core.cli import main  # noqa: E402
from physkin_training.config import TrainingConfig, load_config  # noqa: E402
from physkin_training.fit_garment.fit_garment import StepTime, as_toml, measure_step, steps_in  # noqa: E402
from physkin_training.fit_garment.fit_report import html_table, loss_curve  # noqa: E402


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(small_toml(small_config(tmp_path)))
    return path


@pytest.fixture
def band(tmp_path):
    """A belly band in centimetres, its edges of 4 cm coarser than training wants, half its faces turned."""
    path = tmp_path / "my band.obj"
    write_belly_band(path)
    garment = load_garment(path)
    faces = np.where((np.arange(len(garment.faces)) % 2)[:, None], garment.faces[:, ::-1], garment.faces) + 1
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in (100 * garment.vertices).tolist()]
    path.write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in faces.tolist()]) + "\n")
    return path


def test_from_mesh_to_report(band, recipe, tmp_path, capsys):
    """A model that loads, made of the repaired mesh, and a page that holds verdicts, figures and no other file."""
    output = tmp_path / "band.safetensors"
    arguments = ["--recipe", str(recipe), "--steps", "12", "--device", "cpu", "--bodies", "1", "--poses", "2"]
    assert main(["fit-garment", str(band), "-o", str(output), "--no-pictures", *arguments]) == 0
    model = load_garment_model(output)
    assert model.name == "band" and model.training["optimisation"]["steps"] == 12
    repaired = load_garment(tmp_path / "band" / "garment.obj")
    np.testing.assert_array_equal(model.garment.faces, repaired.faces)
    assert np.ptp(repaired.vertices[:, 2]) == pytest.approx(0.3, abs=0.02)
    page = (tmp_path / "band.html").read_text()
    for words in ("centimetres", "faces turned", ">repaired</span>", "the model", "plain skinning", "12 steps"):
        assert words in page
    assert "<img" not in page and not re.search(r'(src|href)="(?!data:)', page)
    printed = capsys.readouterr().out
    assert "| units | repaired |" in printed and "band.html" in printed
    assert load_config(tmp_path / "band" / "config.toml").optimisation.steps == 12, "the run can be resumed"


def test_the_report_embeds_its_pictures(garment_model, tmp_path):
    """Two PNGs inside the page: the garment as trained, and the sheet of drapes, which also lies beside it."""
    pytest.importorskip("mitsuba", reason="needs the [view] extra")
    from physkin_core import load_body_model
    from physkin_core.avatar.avatar import avatar_from_body
    from physkin_training.fit_garment import fit_report
    from physkin_training.fit_garment.garment_checks import CheckedGarment
    from physkin_training.fit_garment.verdicts import Verdict

    body_model = load_body_model()
    template = avatar_from_body(body_model, body_model.garment_body)
    garment = garment_model.garment
    verdicts = (Verdict("units", "warning", "a < b", "c & d"),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_report, "SHEET_WIDTH", 16)
        patch.setattr(fit_report, "SHEET_POSES", 1)
        patch.setattr(fit_report, "VIEWS", (0,))
        fit_report.write_report(
            tmp_path / "vest.html",
            replace(garment_model, training={"optimisation": {"steps": 5, "samples": 2}}),
            CheckedGarment(garment.vertices, garment.faces, verdicts),
            template,
            torch.device("cpu"),
            losses=tmp_path / "none.jsonl",
            seconds=90.0,
            bodies=1,
            poses=1,
            pictures=True,
        )
    page = (tmp_path / "vest.html").read_text()
    images = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert len(images) == 2
    assert all(base64.b64decode(image).startswith(b"\x89PNG") for image in images)
    assert base64.b64decode(images[1]) == (tmp_path / "vest.png").read_bytes()
    assert "a &lt; b" in page and "c &amp; d" in page and "trained for 1.5 minutes" in page


def test_check_only_writes_the_repaired_mesh_and_trains_nothing(band, tmp_path, capsys):
    output = tmp_path / "band.safetensors"
    assert main(["fit-garment", str(band), "-o", str(output), "--check-only", "--device", "cpu"]) == 0
    assert sorted(path.name for path in (tmp_path / "band").iterdir()) == ["garment.obj"]
    assert not output.exists()
    assert "| winding | repaired |" in capsys.readouterr().out
    again = ["fit-garment", str(tmp_path / "band" / "garment.obj"), "-o", str(tmp_path / "again.safetensors")]
    assert main([*again, "--check-only", "--device", "cpu"]) == 0
    table = capsys.readouterr().out
    assert table.count("| ok |") == 14 and "| scale | warning |" in table, "all but its loose cut"


def test_a_refused_mesh_is_told_in_one_line(tmp_path, capsys):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.25)
    ball.export(tmp_path / "ball.obj")
    output = tmp_path / "ball.safetensors"
    assert main(["fit-garment", str(tmp_path / "ball.obj"), "-o", str(output), "--device", "cpu"]) == 1
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "cannot be trained: openings: it is closed" in captured.err
    assert not (tmp_path / "ball").exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["-o", "{tmp}/band.glb"], "must be a plain one that ends in .safetensors"),
        (["-o", "{tmp}/band.safetensors", "--minutes", "0"], "--minutes 0.0 must be above 0"),
        (["-o", "{tmp}/band.safetensors", "--steps", "0"], "--steps 0 must be at least 1"),
        (["-o", "{tmp}/band.safetensors", "--avatar", "{tmp}/nosuch.glb"], "no such file"),
        (["-o", "{tmp}/band.safetensors", "--device", "tpu"], "tpu"),
    ],
)
def test_errors(arguments, reason, band, tmp_path, capsys):
    arguments = [argument.format(tmp=tmp_path) for argument in arguments]
    assert main(["fit-garment", str(band), "--device", "cpu", *arguments]) == 2
    assert reason in capsys.readouterr().err


def test_steps_are_what_fits_into_the_time():
    """Nine tenths of the run at 0.1 s a step, one at 0.6: 0.15 s a step on average."""
    assert steps_in(5.0, StepTime(0.1, 0.6), 0.9) == 2000
    with pytest.raises(ValueError, match="only 60 steps of 1.00 s here, at least 100 are needed: give --minutes 2 or"):
        steps_in(1.0, StepTime(1.0, 1.0), 0.5)


def test_a_step_with_all_body_points_takes_longer(tmp_path):
    step = measure_step(small_config(tmp_path), torch.device("cpu"), seconds=0.2)
    assert 0 < step.early < step.late


def test_a_configuration_survives_its_file(tmp_path):
    config = TrainingConfig("a-b c", tmp_path / "cloth.obj", seed=3)
    config = replace(config, optimisation=replace(config.optimisation, steps=77, learning_rate=1e-5))
    (tmp_path / "config.toml").write_text(as_toml(config))
    assert load_config(tmp_path / "config.toml") == config


def test_parts_of_the_page():
    assert html_table("| a | b | c |\n|---|---|---|\n| 1 < 2 | | 3 |\n\nNote") == (
        "<table><tr><th>a</th><th>c</th></tr>\n<tr><td>1 &lt; 2</td><td>3</td></tr></table><p>Note</p>"
    )
    rows = [{"step": step, "median_stretch_and_collision": 1 / step} for step in (1, 10, 100)]
    (points,) = re.findall(r'points="([^"]+)"', loss_curve(json.loads(json.dumps(rows))))
    heights = [float(point.split(",")[1]) for point in points.split()]
    assert heights[0] == 10 and heights[1] == pytest.approx(100) and heights[2] == 190
    assert "Too short" in loss_curve(rows[:1])
