"""`physkin train-catalogue`: refusals, and a small run on a local Ray cluster that loses a worker."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import signal
import threading
import time
from pathlib import Path

import pytest
from training.small_runs import small_config, write_belly_band

from physkin_core import load_garment_model
from physkin_core.cli import main
from physkin_core.extras import install_command
from physkin_training.catalogue.plan import find_jobs
from physkin_training.catalogue.train_catalogue import train_catalogue
from physkin_training.config import as_toml
from physkin_training.fit_garment.settings import FitSettings


@pytest.fixture
def shop(tmp_path):
    """Two bands and what is no garment; the recipe of a small training beside them."""
    folder = tmp_path / "shop"
    folder.mkdir()
    for name in ("belly", "waist"):
        write_belly_band(folder / f"{name}.obj")
    (folder / "dot.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "recipe.toml").write_text(as_toml(small_config(tmp_path, validate_every=1000, full_encoding=1.0)))
    return folder


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["{tmp}/nosuch"], "nosuch is not a folder of garment meshes"),
        (["{tmp}/shop", "--steps", "0"], "--steps 0 must be at least 1"),
        (["{tmp}/shop", "--minutes", "inf"], "--minutes inf must be above 0 and finite"),
        (["{tmp}/shop", "--cpus", "0"], "--cpus 0 must be at least 1"),
        (["{tmp}/shop", "--output", "{tmp}/recipe.toml"], "recipe.toml is a file; a folder is needed"),
    ],
)
def test_refusals(arguments, said, shop, tmp_path, capsys):
    """One sentence, before a cluster is asked for."""
    given = [argument.format(tmp=tmp_path) for argument in arguments]
    assert main(["train-catalogue", "-o", str(tmp_path / "models"), *given]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "models").exists()


def test_without_ray_the_extra_is_named(shop, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    assert main(["train-catalogue", str(shop), "-o", str(tmp_path / "models")]) == 2
    assert install_command("cluster") in capsys.readouterr().err


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:port", "127.0.0.1:99999", "ray://127.0.0.1:1"])
def test_an_address_without_a_cluster_is_told_at_once(address, shop, tmp_path, capsys):
    pytest.importorskip("ray", reason="needs the [cluster] extra")
    assert main(["train-catalogue", str(shop), "-o", str(tmp_path / "models"), "--address", address]) == 2
    error = capsys.readouterr().err
    assert f"--address {address}: no Ray cluster answers there" in error and error.count("\n") == 1


def process_that_writes(log: Path) -> int | None:
    """The process that has the file open for writing."""
    for number in filter(str.isdigit, os.listdir("/proc")):
        try:
            if os.readlink(f"/proc/{number}/fd/1") == str(log):
                return int(number)
        except OSError:
            continue
    return None


def kill_worker_of(folder: Path, *, after: int, within: float) -> None:
    """End the process that trains a garment at once, when it has a checkpoint and taken so many steps."""
    until = time.monotonic() + within
    while time.monotonic() < until:
        try:
            step = json.loads((folder / "losses.jsonl").read_text().splitlines()[-1])["step"]
        except (OSError, ValueError, LookupError):
            step = 0
        if step >= after and (folder / "checkpoint.pt").exists():
            number = process_that_writes(folder / "log.txt")
            if number:
                os.kill(number, signal.SIGKILL)
                return
        time.sleep(0.05)


@pytest.mark.slow
def test_a_lost_worker_is_replaced_and_goes_on(shop, tmp_path, capsys):
    """The refused mesh is a row, the killed training goes on, finished ones are not trained again."""
    if importlib.util.find_spec("ray") is None:  # not imported: what it prints is set before
        pytest.skip("needs the [cluster] extra")
    models = tmp_path / "models"
    (shop / "belly.toml").write_text((tmp_path / "recipe.toml").read_text())
    settings = FitSettings(
        recipe=tmp_path / "recipe.toml", steps=200, bodies=1, poses=2, device="cpu", checkpoint_every=0.6
    )

    def train():
        return train_catalogue(find_jobs(shop, models, settings), models, device="cpu")

    hand = threading.Thread(target=kill_worker_of, args=(models / "waist",), kwargs={"after": 40, "within": 300})
    hand.start()
    assert train() == 1, "one of three is refused"
    hand.join()
    said = capsys.readouterr()
    assert re.search(r"of 3: waist: (good|usable|bad), begun 2 times", said.out) and "raylet" not in said.out + said.err
    status = {name: json.loads((models / name / "status.json").read_text()) for name in ("belly", "waist", "dot")}
    assert [status[name]["state"] for name in status] == ["finished", "finished", "failed"]
    assert status["waist"]["starts"] == 2 and status["belly"]["starts"] == 1
    assert status["waist"]["resumed_at"][0] > 0
    assert load_garment_model(models / "waist.safetensors").training["optimisation"]["steps"] == 200
    steps = [json.loads(line)["step"] for line in (models / "waist" / "losses.jsonl").read_text().splitlines()]
    assert steps[-1] == 200 and len(steps) < 2 * 200 - 20, "it did not begin from the start"
    page = (models / "catalogue.html").read_text()
    assert "2 finished, 1 failed" in page and "begun 2 times" in page and "refresh" not in page
    times = {name: (models / f"{name}.safetensors").stat().st_mtime_ns for name in ("belly", "waist")}
    capsys.readouterr()
    assert train() == 1
    assert "3 garments, 2 of them finished" in capsys.readouterr().out
    assert times == {name: (models / f"{name}.safetensors").stat().st_mtime_ns for name in times}
    assert re.search(r"dot.*cannot be trained", json.loads((models / "dot" / "status.json").read_text())["reason"])
