"""Training configuration: defaults, files, and the refusal of unknown keys, wrong types and impossible values."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from physkin_core import load_garment_model
from physkin_core.model.garment_model import Material
from physkin_core.model.model_file import shipped_models
from physkin_training.config import ConfigError, DetailConfig, TrainingConfig, load_config

FOLDER = Path(__file__).parents[2] / "training" / "configs"
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


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_configurations_load(path):
    config = load_config(path)
    assert path.stem.startswith(config.name) and config.garment.is_file()


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_are_runs_of_their_configurations(name):
    """The first from nothing, the last with fabrics. But for keys that are gone; those of before detail had none."""
    first = last = load_garment_model(name).training
    while "started_from" in first:
        first = first["started_from"]
    for training, path in ((first, f"{name}.toml"), (last, f"fabrics/{name}.toml")):
        config = load_config(FOLDER / path).as_plain_data()
        training.setdefault("detail", asdict(DetailConfig(nodes=0)))
        training["optimisation"] = {"other_bending": 0.0} | training["optimisation"]
        training["material"] = {"rest_angles": "as_made"} | training["material"]
        for key, value in config.items():
            ran = training[key]
            assert value == ({name: ran[name] for name in value} if isinstance(value, dict) else ran)
        assert 0 < training["step"] <= config["optimisation"]["steps"]


@pytest.mark.parametrize(
    "text, key, value",
    [
        ("colour = 3", "'colour'", "garment, seed"),
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
    path = next(FOLDER.glob("*.toml"))
    code = (
        "import sys; from physkin_training.config import load_config; "
        f"load_config({str(path)!r}); print(sorted({{'torch', 'warp'}} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
