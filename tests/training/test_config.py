"""Training configuration: defaults, files, and the refusal of unknown keys, wrong types and impossible values."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from physkin_core import load_garment_model
from physkin_core.model.garment_model import Material
from physkin_core.model.model_file import shipped_models
from physkin_training.config import ConfigError, TrainingConfig, load_config

FOLDER = Path(__file__).parents[2] / "training" / "configs"
GARMENTS, RECIPE = FOLDER.parent / "garments", FOLDER / "wardrobe.toml"
MINIMAL = 'name = "shirt"\ngarment = "shirt.obj"\n'


def load(tmp_path, text):
    path = tmp_path / "run.toml"
    path.write_text(text)
    return load_config(path)


def test_two_keys_are_enough(tmp_path):
    """The rest is the defaults and the reference material; the path is relative to the file."""
    config = load(tmp_path, MINIMAL)
    assert config == TrainingConfig(name="shirt", garment=tmp_path / "shirt.obj")
    assert config.material == Material() and config.garment_nodes.count == 128
    assert config.networks.pose_hidden == 384


def test_values_reach_their_place(tmp_path):
    """Integers stand for floats."""
    config = load(
        tmp_path,
        MINIMAL
        + "seed = 3\n[optimisation]\nsteps = 7\nsamples = 8\nbodies = 2\nlearning_rate = 1\n"
        + "[garment_nodes]\ncount = 19\n[material]\ndensity = 1\n"
        + "[networks]\npose_layers = 5\n",
    )
    assert config.seed == 3 and config.optimisation.steps == 7
    assert config.optimisation.learning_rate == 1.0 and isinstance(config.optimisation.learning_rate, float)
    assert config.garment_nodes.count == 19
    assert config.networks.pose_layers == 5 and config.material.density == 1.0


def test_a_recipe_is_of_any_garment(tmp_path, monkeypatch):
    """Name and mesh that are given take the place of the file's, and stand in for them; the rest is the file's."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recipe.toml").write_text("seed = 3\n")
    given = {"name": "vest", "garment": Path("meshes/vest.obj")}
    assert load_config("recipe.toml", **given) == TrainingConfig("vest", tmp_path / "meshes" / "vest.obj", seed=3)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "run.toml").write_text(MINIMAL)
    assert load_config("own/run.toml", **given) == TrainingConfig("vest", tmp_path / "meshes" / "vest.obj")
    assert load_config("own/run.toml").garment == tmp_path / "own" / "shirt.obj"
    with pytest.raises(
        ConfigError, match="recipe.toml: name is missing, and no --garment gives it; garment is missing"
    ):
        load_config("recipe.toml")
    with pytest.raises(ConfigError, match=r"recipe.toml: name.*'\.\./vest'"):
        load_config("recipe.toml", name="../vest", garment=Path("vest.obj"))


def test_the_small_configuration_names_a_garment_that_is_there():
    config = load_config(FOLDER / "smoke.toml")
    assert config.name == "smoke" and config.garment.is_file()


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_are_runs_of_the_recipe(name):
    """From nothing, but for the number of steps, which is as many as there was time for."""
    training = load_garment_model(name).training
    wanted = load_config(RECIPE, name=name, garment=GARMENTS / f"{name}.obj").as_plain_data()
    assert "started_from" not in training
    steps = training["optimisation"]["steps"]
    assert 0 < training["step"] <= steps
    wanted["optimisation"]["steps"] = steps
    trained = {key: training[key] for key in wanted}
    trained["optimisation"] = {"patience": 0} | trained["optimisation"]  # there were no such choices at first
    trained["networks"] = {"pose_rank": 0, "drapes": 0} | trained["networks"]
    assert trained == wanted


@pytest.mark.parametrize(
    "text, key, value",
    [
        ("colour = 3", "'colour'", "garment, start, seed"),
        ("[optimisation]\nstep = 3", "optimisation: .*'step'", "steps, samples"),
        ("[networks]\nwidth = 3", "networks: .*'width'", "pose_hidden"),
        ("[material]\nyoung = 3", "material: .*'young'", "youngs_modulus"),
        ("[cloth]\nx = 1", "'cloth'", "garment"),
        ('[optimisation]\nfit = "both"', "optimisation: .*'fit'", "steps, samples"),
        ('[networks]\nactivation = "silu"', "networks: .*'activation'", "pose_hidden"),
        ('seed = "three"', "seed", "'three'"),
        ("seed = 3.5", "seed", "3.5"),
        ("seed = true", "seed", "True"),
        ("seed = -1", "seed", "-1"),
        ("train_bodies = 0", "train_bodies", "0"),
        ("optimisation = 3", "optimisation", "3"),
        ("[optimisation]\nsteps = 1e5", "optimisation.steps", "100000.0"),
        ("[optimisation]\nsteps = 0", "optimisation.steps", "0"),
        ("[optimisation]\nsamples = 7\nbodies = 2", "samples must be a multiple of bodies 2", "7"),
        ("[optimisation]\nbodies = 0", "optimisation.bodies", "0"),
        ("[optimisation]\nlearning_rate = true", "optimisation.learning_rate", "True"),
        ('[optimisation]\nlearning_rate = "1e-3"', "optimisation.learning_rate", "'1e-3'"),
        ("[optimisation]\nlearning_rate = 0", "optimisation.learning_rate", "0"),
        ("[optimisation]\nlearning_rate = nan", "optimisation.learning_rate", "nan"),
        ("[optimisation]\nlearning_rate = inf", "optimisation.learning_rate", "inf"),
        ("[optimisation]\nskinning_rate = inf", "optimisation.skinning_rate", "inf"),
        ("[optimisation]\ngrowth = 1.1", "optimisation.growth", "1.1"),
        ("[optimisation]\nprune_at = 0.2", "prune_at must be at least prune_from 0.3", "0.2"),
        ("[garment_nodes]\ncount = 12", "initial_influences must be 1 to count 12", "16"),
        ("[garment_nodes]\ninfluences = 17", "influences must be 1 to initial_influences 16", "17"),
        ("[garment_nodes]\nengine_influences = 17", "engine_influences must be 1 to initial_influences 16", "17"),
        ("[garment_nodes]\nengine_influences = 0", "garment_nodes.engine_influences", "0"),
        ("[garment_nodes]\ninfluences = 0", "garment_nodes.influences", "0"),
        ("[optimisation]\nsamples = 12", "samples must be at least 24", "12"),
        ("[poses]\neveryday = 0.5", "'poses'", "garment"),
        ("[networks]\ntoken_width = 30", "networks.token_width: .*multiple of 4", "30"),
        ("[networks]\npose_hidden = 0", "networks.pose_hidden", "0"),
        ("[material]\npoisson_ratio = 1", "poisson_ratio", "1"),
        ("[material]\nyoungs_modulus = -60", "youngs_modulus", "-60"),
        ("[material]\ndensity = true", "density", "True"),
        ('[material]\nrest_angles = "round"', "rest_angles is 'round'", "'flat' or 'as_made'"),
        ("material = 3", "material", "3"),
    ],
)
def test_refusals_name_key_and_value(tmp_path, text, key, value):
    with pytest.raises(ConfigError, match=f"run.toml: .*{key}.*{value}"):
        load(tmp_path, MINIMAL + text)


@pytest.mark.parametrize(
    "text, key",
    [
        ('name = "shirt"', "garment"),
        ('garment = "shirt.obj"', "name"),
        ("name = 3\ngarment = 'a.obj'", "name.*3"),
        ("name = 'a'\ngarment = 3", "garment.*3"),
        *((f'name = "{name}"\ngarment = "a.obj"', "name") for name in ("", "..", "a/b", "/a", "a\\\\b", ".hidden")),
    ],
)
def test_a_plain_name_and_a_garment_are_needed(tmp_path, text, key):
    with pytest.raises(ConfigError, match=key):
        load(tmp_path, text)


def test_several_mistakes_are_named_at_once(tmp_path):
    with pytest.raises(ConfigError, match="steps.*0.*growth.*nan"):
        load(tmp_path, MINIMAL + "[optimisation]\nsteps = 0\ngrowth = nan")


@pytest.mark.parametrize("content", [b"name = ", b"\xff\xfe", b"[a\n"])
def test_unreadable_files(tmp_path, content):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="run.toml"):
        load_config(path)
    with pytest.raises(ConfigError, match="nowhere.toml"):
        load_config(tmp_path / "nowhere.toml")


def test_reading_needs_no_torch():
    """In a fresh process; a configuration is data."""
    path = FOLDER / "smoke.toml"
    code = (
        "import sys; from physkin_training.config import load_config; "
        f"load_config({str(path)!r}); print(sorted({{'torch', 'warp'}} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
