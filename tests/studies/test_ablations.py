"""The ablations' rows, their order over devices, and the report."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace

import pytest
import torch
import warp as wp
from training.small_runs import small_config

from physkin_core import load_garment_model
from physkin_studies import ablation_report, ablation_rows, ablations, supervised
from physkin_studies.ablation_report import write_report
from physkin_studies.ablation_rows import (
    BASE,
    ROWS,
    finished_figures,
    model_path,
    run_row,
)
from physkin_studies.ablations import main, run_rows
from physkin_studies.fantastical_bodies import fantastical_body_model
from physkin_training.config import TrainingConfig, load_config
from physkin_training.train.trainer import Trainer
from physkin_training.train.validation import Validation

CPU = torch.device("cpu")
MINUTES = 0.08


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Two rows of a small garment, trained for 30 steps whatever the time."""
    wp.config.quiet = True

    def choose_steps(trainer, seconds):
        assert seconds == pytest.approx(60 * MINUTES)
        trainer.config = replace(trainer.config, optimisation=replace(trainer.config.optimisation, steps=30))
        return 7.0

    folder = tmp_path_factory.mktemp("ablations")
    config = small_config(folder, full_encoding=1.0, validate_every=100000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "choose_steps", choose_steps)
        patch.setattr(supervised, "STAGES", 1)
        for constant, value in {"BODIES": 1, "POSES": 2, "DRAPES": 2, "DRAPE_BATCH": 2}.items():
            patch.setattr(ablation_rows, constant, value)
        patch.setattr(Validation, "energy", lambda *_, **__: 3.0)  # seconds a time on a CPU
        for name in ("nodes32-fixed", "supervised"):
            run_row(name, config, folder, CPU, MINUTES)
    return folder


def test_rows_change_what_they_are_named_after(tmp_path):
    base = TrainingConfig(name="shirt", garment=tmp_path / "shirt.obj")
    for name, row in ROWS.items():
        config = row.change(base)
        if name.startswith("nodes"):
            assert config.garment_nodes.count == int("".join(filter(str.isdigit, name)))
            assert (config.optimisation.skinning_rate == 0) == name.endswith("fixed")
    assert ROWS[BASE].change(base) == base == ROWS["supervised"].change(base)
    assert ROWS["detail"].change(base).detail.nodes == 1024
    recipe = load_config(ablation_rows.RECIPE, name=BASE, garment=ablation_rows.GARMENT)
    assert recipe.garment.is_file() and recipe.detail.nodes and ROWS[BASE].change(recipe).detail.nodes == 0
    assert ROWS["fantastical"].bodies is fantastical_body_model
    assert ROWS["fantastical"].change(base).train_bodies == 256


@pytest.mark.slow
def test_a_row_leaves_figures_and_a_model_and_nothing_large(finished):
    """What was trained is told; simulated drapes are gone."""
    figures = finished_figures(finished, "nodes32-fixed")
    assert figures["steps"] == 30 == figures["config"]["optimisation"]["steps"]
    assert figures["steps_a_second"] == 7.0 and figures["budget_minutes"] == MINUTES
    assert figures["curve"][-1]["step"] == figures["steps"] and figures["curve"][0]["step"] == 0
    assert figures["figures"]["model"]["pairs"] == 2 and "fantastical" not in figures
    model = load_garment_model(model_path(finished, "nodes32-fixed"))
    assert len(model.node_rest) == 32 and model.training["optimisation"]["skinning_rate"] == 0
    assert finished_figures(finished, "supervised")["simulated"]["drapes"] == 2
    for name in ("nodes32-fixed", "supervised"):
        left = {path.name for path in (finished / name).iterdir()}
        assert left == {"figures.json", f"{name}.safetensors"}


def test_finished_rows_are_skipped(tmp_path, monkeypatch):
    """Others are run, and one that fails does not stop the rest; a row of another budget is not mixed in."""
    (tmp_path / "nodes32-fixed").mkdir()
    (tmp_path / "nodes32-fixed" / "figures.json").write_text(json.dumps({"budget_minutes": MINUTES}))
    tried = []
    monkeypatch.setattr(ablations, "_run", lambda name, *_: tried.append(name) or name != "nodes256")
    names = ["nodes32-fixed", "nodes256", "nodes64"]
    failed = run_rows(names, tmp_path, MINUTES, devices=["0", "1"])
    assert sorted(tried) == ["nodes256", "nodes64"] and failed == ["nodes256"]
    with pytest.raises(ValueError, match="nodes32-fixed in .* was trained for 0.08 minutes, not 4"):
        run_rows(names, tmp_path, 4.0, devices=["cpu"])


def test_a_row_sees_one_device_alone(tmp_path, monkeypatch):
    """Every process has its GPU as the only one; what went wrong is told."""
    seen = []

    def run(command, *, env, stdout, **_):
        seen.append((env.get("CUDA_VISIBLE_DEVICES"), command[command.index("--device") + 1]))
        stdout.write("error: no luck\n")
        return subprocess.CompletedProcess(command, 1)

    monkeypatch.setattr(ablations.subprocess, "run", run)
    assert run_rows(["nodes256"], tmp_path, MINUTES, devices=["3"]) == ["nodes256"]
    assert seen == [("3", "cuda")]


@pytest.mark.slow
def test_the_report_holds_what_is_finished(finished, monkeypatch):
    """Tables of the rows there are, plots, and frame times of this machine; the base being absent is no error."""
    monkeypatch.setattr(ablation_report, "ROUNDS", 2)
    path = write_report(finished)
    text = path.read_text()
    figures = finished_figures(finished, "nodes32-fixed")["figures"]["model"]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    row = next(row for row in rows if row[:2] == ["32", "fixed"])
    assert row[2:4] == [f"{figures[key]:.2f}" for key in ("edge_strain_percent", "area_strain_percent")]
    assert row[-1] == "7.010 / 8.091 / 0.316"
    times = json.loads((path.parent / "times.json").read_text())
    assert times["nodes32-fixed"]["frame"] > times["nodes32-fixed"]["skinning"] > 0
    assert all((path.parent / name).is_file() for name in ("ablations_curves.svg", "ablations_figures.svg"))


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--minutes", "0"], "minutes must be above 0"),
        (["--devices", "gpu"], "gpu"),
        (["--report"], "no finished row"),
    ],
)
def test_impossible_requests_are_told(tmp_path, capsys, arguments, message):
    assert main(["--output", str(tmp_path), *arguments]) == 2
    assert message in capsys.readouterr().err
