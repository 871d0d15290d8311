"""`physkin fit-garment`: checks, training and report of a small band on the CPU, its time, and its errors."""

from __future__ import annotations

import base64
import json
import re
import signal
import time
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from training.small_runs import SIZES, small_config, write_belly_band

from physkin_core import load_garment, load_garment_model
from physkin_core.cli import main
from physkin_core.mesh.look import Look
from physkin_core.model.garment import vertex_normals
from physkin_training.config import TrainingConfig, as_toml, load_config
from physkin_training.evaluate import contact_sheet
from physkin_training.fit_garment import fit_garment as command
from physkin_training.fit_garment import pictures, report, training_time
from physkin_training.fit_garment.checks import CheckedGarment
from physkin_training.fit_garment.fit_garment import fit_garment
from physkin_training.fit_garment.settings import FitSettings
from physkin_training.fit_garment.training_record import TrainingRecord, learnt, taken_over
from physkin_training.fit_garment.verdicts import Verdict
from physkin_training.time_budget import TimeBudget
from physkin_training.train import run, run_reports, trainer
from physkin_training.train.run import trained_model
from physkin_training.train.trainer import Trainer

CPU = torch.device("cpu")


@pytest.fixture
def recipe(tmp_path):
    """Of a small training; that it names its own length must not matter."""
    path, config = tmp_path / "recipe.toml", small_config(tmp_path, validate_every=1000, full_encoding=1.0)
    path.write_text(as_toml(config).replace("steps = 12", "steps = 900"))
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


class Watch:
    """A clock that goes on only when told to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_from_mesh_to_report(band, recipe, tmp_path, capsys, no_pictures, monkeypatch):
    """A run that Ctrl-C ends in the eighth of twelve steps, and that --resume takes on: a model made of the repaired
    mesh, and a page that holds verdicts, figures and no other file. What learns to sway is the trained model, and its
    page says how. The mesh is read from no file but the user's."""
    output, sways = tmp_path / "band.safetensors", "Its own sway network was learnt: by a test."
    monkeypatch.setattr(command, "learns_sway", lambda *_, seconds: seconds == np.inf)
    monkeypatch.setattr(
        command,
        "with_own_sway",
        lambda model, *_, within: (replace(model, training=model.training | {"sways": within == np.inf}), sways),
    )
    monkeypatch.setattr(trainer, "load_garment", None)
    take_steps = Trainer.run

    def interrupted(trainer, steps):
        for step in take_steps(trainer, steps):
            if step == 8:
                signal.raise_signal(signal.SIGINT)
            yield step

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "run", interrupted)
        arguments = ["--device", "cpu", "--steps", "12", "--recipe", str(recipe)]
        assert main(["fit-garment", str(band), "-o", str(output), *arguments]) == 130
    printed = capsys.readouterr().out
    assert "repaired: units: centimetres" in printed and "to be worn while it trains" in printed
    assert "optimisation" not in load_garment_model(output).training, "what is there is from before training"
    assert load_config(tmp_path / "band" / "config.toml").optimisation.steps == 12
    fitted = fit_garment(band, output, FitSettings(steps=12, device="cpu", bodies=1, poses=2, resume=True))
    model = load_garment_model(output)
    assert model.training["networks"] == asdict(SIZES), "of the recipe that was chosen at first"
    assert model.name == "band" and model.training["optimisation"]["steps"] == 12 and model.training["sways"] is True
    record = TrainingRecord(tmp_path / "band" / "losses.jsonl")
    steps = [row["step"] for row in record.rows]
    assert steps == [1, 2, 3, 4, 5, 6, 7, *range(9, 13)], "the step of Ctrl-C is saved, not reported"
    assert fitted.seconds > record.seconds > 0
    assert fitted.undertrained.startswith("After 12 steps") and fitted.undertrained in fitted.advice
    assert fitted.figures["counts"]["bodies"] == 1 and fitted.model.training == model.training
    repaired = load_garment(tmp_path / "band" / "garment.obj")
    np.testing.assert_array_equal(model.garment.faces, repaired.faces)
    assert np.ptp(repaired.vertices[:, 2]) == pytest.approx(0.3, abs=0.02)
    page = (tmp_path / "band.html").read_text()
    for words in (
        "centimetres",
        "faces turned",
        ">repaired</span>",
        "the model",
        "plain skinning",
        "to step 12 of 12",
        "<svg",
        sways,
    ):
        assert words in page
    assert "<img" not in page and not re.search(r'(src|href)="(?!data:|#)', page)
    assert "band.html" in capsys.readouterr().out


def test_lost_steps_count_once_in_the_curve_and_in_full_in_the_time(tmp_path):
    record = TrainingRecord(tmp_path / "losses.jsonl")
    assert record.seconds == record.steps == 0 and record.rows == []
    rows = [(10, 4.0), (20, 8.0), (30, 12.0), (20, 3.0), (30, 6.0), (40, 9.0)]
    record.path.write_text("".join(json.dumps({"step": step, "seconds": seconds}) + "\n" for step, seconds in rows))
    last = [(row["step"], row["seconds"]) for row in record.rows]
    assert last == [(10, 4.0), (20, 3.0), (30, 6.0), (40, 9.0)]
    assert record.seconds == 12 + 9 and record.steps == 40


@pytest.mark.slow
def test_all_is_done_in_the_minutes_given(band, recipe, tmp_path):
    """Set-up, measuring, training, export, figures and pictures."""
    began = time.monotonic()
    arguments = ["-o", str(tmp_path / "band.safetensors"), "--recipe", str(recipe), "--minutes", "1", "--device", "cpu"]
    assert main(["fit-garment", str(band), *arguments]) == 0
    assert 30 < time.monotonic() - began < 63


def test_training_gets_what_the_rest_leaves(monkeypatch):
    """Of 10 minutes 80 s are gone, and a quarter, at most 150 s, is for the report."""
    watch, asked = Watch(), []
    config = TrainingConfig("band", Path("band.obj"))

    def trainer(**optimisation):
        of_run = replace(config, optimisation=replace(config.optimisation, **optimisation))
        choose = {"choose_steps": lambda seconds: asked.append(seconds) or 10.0}
        return SimpleNamespace(config=of_run, device=CPU, **choose)

    budget = TimeBudget(10, clock=watch)
    watch.now = 80.0
    training_time.plan_steps(trainer(), budget)
    assert asked == [600 - 80 - 150]
    late = TimeBudget(2, clock=watch)
    watch.now += 95.0
    with pytest.raises(ValueError, match="2 minutes .* too few: 95 s went by .* 30 s are kept .* --minutes about 3"):
        training_time.plan_steps(trainer(), late)
    with pytest.raises(ValueError, match="only 12 steps of 0.10 s here, at least 100 are needed: .* about 11"):
        training_time.plan_steps(trainer(steps=12), TimeBudget(10, clock=watch))


def test_compiling_kernels_takes_nothing_of_the_minutes(band, recipe, tmp_path, monkeypatch):
    """40 s, on a machine whose cache is empty: the mesh is read with the whole minute left."""
    watch, budgets = Watch(), []

    def watched(minutes):
        budgets.append(TimeBudget(minutes, clock=watch))
        return budgets[0]

    def passing(seconds, *_):
        watch.now += seconds

    def read(path):
        passing(1.0)
        raise ValueError(path)

    monkeypatch.setattr(command, "TimeBudget", watched)
    monkeypatch.setattr(command, "compile_kernels", partial(passing, 40.0))
    monkeypatch.setattr(command, "read_mesh", read)
    with pytest.raises(ValueError, match="my band"):
        fit_garment(band, tmp_path / "band.safetensors", FitSettings(minutes=1, device="cpu", recipe=recipe))
    assert (watch.now, budgets[0].spent, budgets[0].left) == (41.0, 1.0, 59.0)
    with pytest.raises(ValueError, match="my band"):
        fit_garment(band, tmp_path / "band.safetensors", FitSettings(device="cpu", check_only=True))
    assert watch.now == 42.0, "a mesh that is only checked needs few of them"


@pytest.mark.parametrize(("spent", "steps"), [(35.0, 600), (58.0, 100)])
def test_a_command_in_a_hurry_times_no_steps(spent, steps):
    """On a GPU with a minute for all, a quarter of it for the report. A hundred steps are taken all the same."""
    watch = Watch()
    chosen = []
    trainer = SimpleNamespace(device=torch.device("cuda"), set_steps=chosen.append)
    budget = TimeBudget(1, clock=watch)
    watch.now = spent
    training_time.plan_steps(trainer, budget)
    assert chosen == [steps]


@pytest.fixture
def write_vest(garment_model, template, tmp_path, monkeypatch):
    """Writes the report on a small model with tiny pictures; returns the page."""
    monkeypatch.setattr(contact_sheet, "WIDTH", 16)
    monkeypatch.setattr(report, "SHEET_POSES", 1)
    monkeypatch.setattr(pictures, "VIEWS", (0,))
    garment = garment_model.garment
    verdicts = (Verdict("units", "warning", "a < b", "c & d"),)
    look = Look.plain(len(garment.faces))
    checked = CheckedGarment(
        garment.vertices, garment.faces, verdicts, garment.vertices, False, look, garment.edges[:0]
    )
    model = replace(garment_model, training={"optimisation": {"steps": 5, "samples": 2}})

    def write(budget, poses=1):
        record = TrainingRecord(tmp_path / "losses.jsonl")
        record.path.write_text(json.dumps({"step": 5, "median_stretch_and_collision": 1.0}))
        paths = {"output": tmp_path / "vest.safetensors", "record": record}
        numbers = {"seconds": 90.0, "bodies": 1, "poses": poses}
        report.write_report(
            model=model,
            checked=checked,
            template=template,
            avatar=template,
            device=CPU,
            budget=budget,
            sway="",
            **paths,
            **numbers,
        )
        return (tmp_path / "vest.html").read_text()

    return write


@pytest.mark.slow
def test_the_report_embeds_its_pictures(write_vest, tmp_path):
    """PNGs inside the page: the garment as trained, on the user's avatar, and the sheet of drapes, also beside it."""
    pytest.importorskip("mitsuba", reason="needs the [view] extra")
    page = write_vest(TimeBudget())
    images = [base64.b64decode(image) for image in re.findall(r"data:image/png;base64,([^\"]+)", page)]
    assert len(images) == 3 and all(image.startswith(b"\x89PNG") for image in images)
    assert images[2] == (tmp_path / "vest.png").read_bytes()
    assert "a &lt; b" in page and "c &amp; d" in page and "trained for 1.5 minutes" in page


@pytest.fixture(scope="module")
def scores_of_one_pose():
    """What `evaluate_model` gives, measured when it is first asked for; then again and again."""
    evaluate, kept = report.evaluate_model, {}

    def scores(*arguments, **options):
        if not kept:
            kept.update(evaluate(*arguments, **options | {"poses": 1}))
        return kept

    return scores


@pytest.mark.parametrize(("left", "measured"), [(31, [2, 60]), (-10, [2])])
def test_as_many_poses_are_measured_as_there_is_time_for(
    left, measured, write_vest, scores_of_one_pose, monkeypatch, no_pictures
):
    """Half a second a pose."""
    watch, done = Watch(), []
    budget = TimeBudget(1, clock=watch)
    watch.now = 60.0 - left

    def evaluate(*arguments, poses, **options):
        watch.now += 0.5 * poses
        done.append(poses)
        return scores_of_one_pose(*arguments, **options)

    monkeypatch.setattr(report, "evaluate_model", evaluate)
    page = write_vest(budget, poses=64)
    assert done == measured
    assert re.search(r"On your avatar.*(good|usable|bad): \d.* % of the skin shows; in everyday poses \d", page)
    assert budget.left >= min(0, left - 1)


@pytest.mark.parametrize(
    ("energies", "words"),
    [
        ([4.0, 3.0, 2.0, 1.5, 1.0], "A longer run is worth while: over the last 25 % of the steps"),
        ([4.0, 3.0, 2.0, 1.5, 1.0], "went from 2.0000 to 1.0000 J (-40.0 % of what strains it)"),
        ([0.0, -1.0, -2.0, -2.5, -3.0], "went from -2.0000 to -3.0000 J (-40.0 % of what strains it)"),
        ([4.0, 1.0, 1.01, 1.0, 1.0], "A longer run would gain little: over"),
        ([4.0], "Too short a run"),
        ([], "Too short a run"),
    ],
)
def test_the_report_says_whether_to_train_longer(energies, words, tmp_path):
    rows = [
        {"step": 100 * (k + 1), "validation_energy": energy, "validation_strained": 2.5}
        for k, energy in enumerate(energies)
    ]
    record = TrainingRecord(tmp_path / "losses.jsonl")
    record.path.write_text("\n".join(map(json.dumps, [{"step": 50}, *rows])))
    assert words in record.longer_or_not()


def test_the_report_says_what_was_taken_over_and_what_was_learnt():
    rows = [{"step": step, "validation_energy": energy} for step, energy in ((0, 3.6), (100, 1.7), (200, 1.8))]
    begun = {"started_from": {"transferred_from": "hoodie"}}
    lost, kept = (taken_over(begun, sways=sways) for sways in (False, True))
    assert "began with hoodie" in lost and "hoodie has no sway network" in lost and "learn-sway" in lost
    assert "and its sway network, by which cloth lags" in kept and "learn-sway" not in kept
    nothing = taken_over({}, sways=False)
    assert "began with nothing" in nothing and "no sway network" in nothing
    own = "Its own sway network was learnt: so far."
    for began in ({}, begun):
        told = taken_over(began, sways=True, own_sway=own)
        assert told.endswith(own) and "no sway" not in told and "lags" not in told
    told = learnt(begun, rows)
    assert told.startswith("From there") and "that of step 100: " in told and "1.7000 J (3.6000 J at first)" in told
    assert learnt({}, []).startswith("It learnt from scratch")


@pytest.mark.parametrize(("steps", "strain", "few"), [(171, 4.0, True), (9000, 11.8, True), (9000, 5.0, False)])
def test_undertrained_is_said_in_plain_words(steps, strain, few, tmp_path):
    """Of a run of few steps, and of one that is hardly better than plain skinning."""
    scores = {"model": {"edge_strain_percent": strain}, "skinning": {"edge_strain_percent": 12.0}}
    record = TrainingRecord(tmp_path / "losses.jsonl")
    record.path.write_text(json.dumps({"step": steps}))
    said = record.undertrained(scores)
    assert bool(said) is few
    assert not few or (f"After {steps:,} steps" in said and f"{strain} %" in said and "12.0 %" in said)


def test_a_late_report_has_no_pictures(write_vest, tmp_path):
    """It says how to draw them, and has everything else."""
    page = write_vest(TimeBudget(1e-9))
    assert "<img" not in page and "contact-sheet vest.safetensors" in page and "plain skinning" in page
    assert ">undertrained</span> After 5 steps" in page and ":--" not in page
    assert page.index("In short") < page.index("began with nothing") < page.index("a &lt; b") < page.index("Figures")
    assert "0 checks found nothing amiss" in page
    assert not (tmp_path / "vest.png").exists()


def test_check_only_writes_the_repaired_mesh_and_trains_nothing(band, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "SIZE", (33, 29))
    output = tmp_path / "band.safetensors"
    assert main(["fit-garment", str(band), "-o", str(output), "--check-only", "--device", "cpu"]) == 0
    drawn = ["placement.png"] if find_spec("mitsuba") else []
    assert sorted(path.name for path in (tmp_path / "band").iterdir()) == ["garment.obj", *drawn]
    assert not output.exists()
    assert "repaired: winding: " in capsys.readouterr().out
    again = ["fit-garment", str(tmp_path / "band" / "garment.obj"), "-o", str(tmp_path / "again.safetensors")]
    assert main([*again, "--check-only", "--device", "cpu"]) == 0
    told = capsys.readouterr().out
    fine = re.search("^ok: (.*)$", told, re.MULTILINE)[1]
    assert len(fine.split(", ")) == 19 and "warning: scale: " in told, "its loose cut"


def test_a_refused_mesh_is_told_in_one_line(tmp_path, capsys):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.5e4)
    ball.export(tmp_path / "ball.obj")
    output = tmp_path / "ball.safetensors"
    assert main(["fit-garment", str(tmp_path / "ball.obj"), "-o", str(output), "--device", "cpu"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "units" in error
    assert not (tmp_path / "ball").exists()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["-o", "{tmp}/band.glb"], "band.glb"),
        (["-o", "{tmp}/band.safetensors", "--minutes", "0"], "--minutes 0 must"),
        (["-o", "{tmp}/band.safetensors", "--minutes", "3"], "--minutes 3 is too little on a CPU: at least 4"),
        (["-o", "{tmp}/band.safetensors", "--steps", "0"], "--steps 0"),
        (["-o", "{tmp}/band.safetensors", "--avatar", "{tmp}/nosuch.glb"], "nosuch.glb"),
        (["-o", "{tmp}/band.safetensors", "--device", "tpu"], "tpu"),
    ],
)
def test_errors(arguments, named, band, tmp_path, capsys):
    arguments = [argument.format(tmp=tmp_path) for argument in arguments]
    assert main(["fit-garment", str(band), "--device", "cpu", *arguments]) == 2
    assert named in capsys.readouterr().err


def test_a_run_that_falls_behind_leaves_steps_out(tmp_path, monkeypatch):
    """Each step takes a second where half as long was planned: every second one is left out, but not the last."""
    config = small_config(tmp_path, steps=40)
    unpruned = replace(config.garment_nodes, influences=config.garment_nodes.initial_influences)
    watch, taken = Watch(), []
    monkeypatch.setattr(run_reports.time, "perf_counter", watch)

    def take_steps(trainer, steps):
        while trainer.step < steps:
            watch.now += 1.0
            trainer.step += 1
            taken.append(trainer.step)
            yield trainer.step

    monkeypatch.setattr(Trainer, "run", take_steps)
    monkeypatch.setattr(
        run, "fitted_rest_normals", lambda _, garment, __: vertex_normals(garment.vertices, garment.faces)
    )
    trainer = Trainer(replace(config, garment_nodes=unpruned), CPU)
    model = trained_model(trainer, tmp_path, tmp_path / "band.safetensors", within=20.0)
    assert len(taken) in (20, 21) and taken[-1] == 40
    assert model.name == "band"
