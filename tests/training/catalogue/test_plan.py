"""What a catalogue run has to do, without Ray and without training."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from physkin_training.catalogue.page import catalogue_table
from physkin_training.catalogue.plan import (
    CatalogueError,
    Status,
    find_jobs,
    read_status,
    stage,
    steps_taken,
    write_status,
)
from physkin_training.fit_garment.settings import FitSettings

MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def shop(tmp_path):
    """Two meshes and a sewing pattern, one of the meshes with a recipe."""
    folder = tmp_path / "shop"
    folder.mkdir()
    for name in ("coat.obj", "hat.ply", "shirt.json"):
        (folder / name).write_text(MESH + name)
    (folder / "hat.toml").write_text("seed = 1\n")
    (folder / "notes.txt").write_text("spring\n")
    return folder


def jobs_of(shop, **settings):
    return {job.name: job for job in find_jobs(shop, shop.parent / "models", FitSettings(**settings))}


def note(job, state, **more):
    write_status(job, Status(job.fingerprint, state, **more))


def save_checkpoint(job):
    job.folder.mkdir(parents=True, exist_ok=True)
    entries = dict.fromkeys(("config", "drape", "average", "optimiser", "random"), {})
    torch.save({"step": 7, "best": None, "started_from": None} | entries, job.folder / "checkpoint.pt")


def test_a_job_for_each_mesh_and_pattern(shop, tmp_path):
    recipe = tmp_path / "all.toml"
    recipe.write_text("seed = 2\n")
    jobs = jobs_of(shop, recipe=recipe, steps=9)
    assert list(jobs) == ["coat", "hat", "shirt"] and jobs["shirt"].mesh == shop / "shirt.json"
    assert jobs["coat"].settings == FitSettings(steps=9, recipe=recipe, resume=True)
    assert jobs["hat"].settings.recipe == shop / "hat.toml", "its own goes before"
    assert jobs["hat"].output == tmp_path / "models" / "hat.safetensors"
    assert len({job.fingerprint for job in jobs.values()}) == 3


def test_what_is_finished_what_resumes_and_what_is_new(shop):
    jobs = jobs_of(shop)
    assert {stage(job) for job in jobs.values()} == {"new"}
    note(jobs["coat"], "finished")
    assert stage(jobs["coat"]) == "new", "its model is not there"
    jobs["coat"].output.write_text("model")
    assert stage(jobs["coat"]) == "finished"
    note(jobs["hat"], "training")
    assert stage(jobs["hat"]) == "new", "nothing to go on from"
    save_checkpoint(jobs["hat"])
    assert stage(jobs["hat"]) == "resumes"
    note(jobs["shirt"], "failed", reason="diverged")
    save_checkpoint(jobs["shirt"])
    assert stage(jobs["shirt"]) == "resumes", "what failed is tried again"


def test_another_mesh_recipe_or_length_is_trained_anew(shop, tmp_path):
    avatar = tmp_path / "me.glb"
    avatar.write_text("one")
    settings = {"steps": 9, "avatar": str(avatar)}
    for job in jobs_of(shop, **settings).values():
        note(job, "finished")
        job.output.write_text("model")

    def stages(**other):
        return [stage(job) for job in jobs_of(shop, **(settings | other)).values()]

    assert stages(poses=2) == ["finished"] * 3, "the report is no part of the model"
    assert stages(steps=10) == ["new"] * 3
    (shop / "hat.toml").write_text("seed = 3\n")
    assert stages() == ["finished", "new", "finished"]
    (shop / "coat.obj").write_text(MESH)
    assert stages() == ["new", "new", "finished"]
    avatar.write_text("two")
    assert stages() == ["new"] * 3


def test_a_damaged_status_is_none(shop):
    job = jobs_of(shop)["coat"]
    note(job, "finished", starts=2, resumed_at=[40])
    assert read_status(job) == Status(job.fingerprint, "finished", starts=2, resumed_at=[40])
    for text in ("", "[]", '{"state": "finished"}', '{"unknown": 1}'):
        (job.folder / "status.json").write_text(text)
        assert read_status(job) is None


def test_steps_taken(shop):
    job = jobs_of(shop)["coat"]
    assert steps_taken(job) is None
    job.folder.mkdir(parents=True)
    (job.folder / "losses.jsonl").write_text('{"step": 10}\n{"step": 20}\n')
    assert steps_taken(job) is None, "no configuration"
    (job.folder / "config.toml").write_text('name = "coat"\ngarment = "coat.obj"\n[optimisation]\nsteps = 80\n')
    assert steps_taken(job) == (20, 80)


def test_folders_that_are_refused(shop, tmp_path):
    (tmp_path / "empty").mkdir()
    (shop / "typo.toml").write_text("")
    for folder, settings, said in (
        (shop / "nosuch", {}, "nosuch is not a folder"),
        (tmp_path / "empty", {}, "empty holds no garment mesh or pattern; allowed: .obj, .*.json"),
        (shop, {}, "typo.toml belongs to no garment: there is no typo.obj"),
        (shop, {"avatar": "me.glb"}, "--avatar .*me.glb: no such file"),
        (shop, {"recipe": tmp_path / "my.toml"}, "--recipe .*my.toml: no such file"),
    ):
        with pytest.raises(CatalogueError, match=said):
            find_jobs(folder, tmp_path, FitSettings(**settings))
    of_all = FitSettings(recipe=shop / "typo.toml")
    assert len(find_jobs(shop, tmp_path, of_all)) == 3, "it is the recipe of all"
    (shop / "coat.stl").write_text("")
    with pytest.raises(CatalogueError, match=r"coat.obj and .*coat.stl would both become coat.safetensors"):
        find_jobs(shop, tmp_path, of_all)


def test_the_page_has_a_row_each(shop):
    """Waiting, stopped on the way, refused with its reason; read again while there is more to come."""
    jobs = jobs_of(shop)
    note(jobs["hat"], "stopped", starts=3, resumed_at=[40, 60])
    note(jobs["shirt"], "failed", reason="units: 5 < 6 & odd")
    page = catalogue_table(list(jobs.values()))
    assert page.count("<tr>") == 1 + 3 and "1 waiting, 1 stopped, 1 failed" in page
    assert "units: 5 &lt; 6 &amp; odd" in page and 'href="shirt/log.txt"' in page
    assert "begun 3 times" in page and "gone on at step 60" in page
    figures = {"model": {}, "skinning": {}}
    for number, row in enumerate(figures.values()):
        row |= {f"{name}_percent": 10 * number + 2.0 for name in ("edge_strain", "area_strain", "inside")}
    job = jobs["coat"]
    sits = {"edge_strain_percent": 3.25, "inside_percent": 0.5, "deepest_mm": 4.0}
    verdicts = [{"check": "units", "outcome": "repaired"}, {"check": "winding", "outcome": "ok"}]
    fitted = {"seconds": 90, "verdicts": verdicts, "figures": figures, "advice": "train <longer>"}
    check = {"verdict": "usable", "everyday": sits, "rest": {"inside_percent": 0.125}}
    note(job, "finished", check=check, fitted=fitted)
    (job.folder / "picture.jpg").write_bytes(b"\xff\xd8\xff")
    page = catalogue_table(list(jobs.values()))
    for words in (
        "usable</span>",
        "edges 3.2 %",
        "edges 2.0 %, skinning 12.0 %",
        "1.5 minutes",
        "train &lt;longer&gt;",
        "units",
        'href="coat.html"',
    ):
        assert words in page
    assert "winding" not in page and page.count("data:image/jpeg;base64,/9j/") == 1


def test_status_of_another_state_is_kept_whole(shop):
    """A reader never finds half a file."""
    job = jobs_of(shop)["coat"]
    note(job, "training")
    write_status(job, replace(read_status(job), state="failed", reason="x"))
    assert [path.name for path in job.folder.iterdir()] == ["status.json"]
