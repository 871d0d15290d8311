"""Training configuration: defaults, files, and the refusal of unknown keys, wrong types and impossible values."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the [training] extra")

from physkin_core import load_garment_model  # noqa: E402
from physkin_core.model.garment_model import Material  # noqa: E402
from physkin_core.model.model_file import shipped_models  # noqa: E402
from physkin_training.config import ConfigError, TrainingConfig, load_config  # noqa: E402

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
    assert config.networks.pose_hidden == 384 and config.networks.node_outputs == 12


def test_values_reach_their_place(tmp_path):
    """Integers stand for floats; infinity is a number."""
    config = load(
        tmp_path,
        MINIMAL
        + "seed = 3\n[optimisation]\nsteps = 7\nsamples = 8\nbodies = 2\nlearning_rate = 1\nheavy_energy = inf\n"
        + "[garment_nodes]\ncount = 19\n[poses]\nupright = 1\n[material]\ndensity = 1\n"
        + '[networks]\nactivation = "relu"\n',
    )
    assert config.seed == 3 and config.optimisation.steps == 7 and config.optimisation.heavy_energy == float("inf")
    assert config.optimisation.learning_rate == 1.0 and isinstance(config.optimisation.learning_rate, float)
    assert config.garment_nodes.count == 19 and config.poses.upright == 1.0
    assert config.networks.activation == "relu" and config.material.density == 1.0


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_configurations_load(path):
    config = load_config(path)
    assert path.stem.startswith(config.name) and config.garment.is_file()


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_are_runs_of_their_configurations(name):
    """But for how the number of steps came about; a key that came later has the default, which was the only way."""
    told = load_garment_model(name).training
    config = load_config(FOLDER / f"{name}.toml").as_plain_data()
    defaults = TrainingConfig(name=name, garment=Path("a.obj")).as_plain_data()
    ran = {key: defaults[key] | told[key] if isinstance(defaults[key], dict) else told[key] for key in config}
    ran["optimisation"]["minutes"] = 0.0
    assert config == ran
    assert 0 < told["step"] <= config["optimisation"]["steps"]


@pytest.mark.parametrize(
    "text, message",
    [
        ('name = "shirt"', "garment"),
        ('garment = "shirt.obj"', "name"),
        ("name = 3\ngarment = 'a.obj'", "name must be str, got 3"),
        ("name = 'a'\ngarment = 3", "garment must be Path, got 3"),
    ],
)
def test_name_and_garment_are_needed(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, text)


@pytest.mark.parametrize(
    "text, message",
    [
        ("colour = 3", "unknown key 'colour'; allowed: name, garment, seed"),
        ("[optimisation]\nstep = 3", "optimisation: unknown key 'step'; allowed: steps, minutes, samples"),
        ("[networks]\nwidth = 3", "networks: unknown key 'width'"),
        ("[material]\nyoung = 3", "material: unknown key 'young'"),
        ("[cloth]\nx = 1", "unknown key 'cloth'"),
    ],
)
def test_unknown_keys(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, MINIMAL + text)


@pytest.mark.parametrize(
    "text, message",
    [
        ('seed = "three"', "seed must be int, got 'three'"),
        ("seed = 3.5", "seed must be int, got 3.5"),
        ("seed = true", "seed must be int, got True"),
        ("[optimisation]\nsteps = 1e5", "steps must be int, got 100000.0"),
        ("[optimisation]\nlearning_rate = true", "learning_rate must be float, got True"),
        ('[optimisation]\nlearning_rate = "1e-3"', "learning_rate must be float"),
        ("[networks]\nactivation = 1", "activation must be str, got 1"),
        ("optimisation = 3", "optimisation must be a table, got 3"),
    ],
)
def test_wrong_types(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, MINIMAL + text)


@pytest.mark.parametrize(
    "text, message",
    [
        ("[optimisation]\nsamples = 7\nbodies = 2", "samples must be a multiple of optimisation.bodies 2, got 7"),
        ("[optimisation]\nbodies = 0", "bodies must be at least 1, got 0"),
        ("[optimisation]\nsteps = 0", "optimisation.steps must be at least 1, got 0"),
        ("[optimisation]\nlearning_rate = 0", "optimisation.learning_rate must be finite and above 0, got 0.0"),
        ("[optimisation]\nlearning_rate = -1e-3", "learning_rate must be"),
        ("[optimisation]\nencoder_points = 0", "encoder_points must be at least 1"),
        ('[networks]\nactivation = "gelu"', "activation 'gelu' is not one of silu, relu"),
        ("[networks]\nnode_outputs = 10", "node_outputs must be 9 .* or 12 .* got 10"),
        ("[optimisation]\nlearning_rate = nan", "learning_rate"),
        ("[optimisation]\nsamples = 0", "samples"),
        ("[optimisation]\nsamples = -12\nbodies = 12", "samples"),
        ("train_bodies = 0", "train_bodies"),
        ("train_bodies = -3", "train_bodies"),
        ("[garment_nodes]\ncount = 0", "count"),
        ("[garment_nodes]\ninfluences = 0", "influences"),
        ("[poses]\nupright = 1.5", "upright"),
        ("[material]\npoisson_ratio = 1", "poisson_ratio"),
        ("[material]\nyoungs_modulus = -60", "youngs_modulus"),
        ("seed = -1", "seed must be 0"),
        ("[optimisation]\nskinning_rate = inf", "optimisation.skinning_rate must be finite and at least 0, got inf"),
        ("[optimisation]\nminutes = -1", "optimisation.minutes must be finite and at least 0, got -1"),
        ("[optimisation]\nsteps = 7\nminutes = 4", "both steps and minutes; give one of them"),
        ('body_distribution = "elves"', "body_distribution must be one of adults, fantastical, got 'elves'"),
        ('[networks]\nconditioning = "hope"', "conditioning 'hope' is not one of modulation, concatenation"),
        ("[optimisation]\ngrowth = 1.1", "optimisation.growth must be 0 to 1, got 1.1"),
        ("[optimisation]\naverage = 1.0", "optimisation.average must be at least 0 and below 1, got 1.0"),
        ("[optimisation]\nheavy_energy = 0.0", "optimisation.heavy_energy must be above 0, got 0.0"),
        (
            "[optimisation]\nprune_at = 0.2",
            "optimisation.prune_at must be at least optimisation.prune_from 0.3, got 0.2",
        ),
        ("[garment_nodes]\ncount = 12", "initial_influences must be 1 to garment_nodes.count 12, got 16"),
        ("[garment_nodes]\ninfluences = 17", "influences must be 1 to garment_nodes.initial_influences 16, got 17"),
        ("[poses]\nlargest_tilt_degrees = 181", "poses.largest_tilt_degrees must be 0 to 180, got 181.0"),
        ("[networks]\ntoken_width = 30", "token_width"),
        ("[networks]\npose_hidden = 0", "pose_hidden"),
        (
            '[optimisation]\nother_limbs = "never"',
            "optimisation.other_limbs must be one of one_way, both_ways, got 'never'",
        ),
        ('[optimisation]\nfit = "tight"', "optimisation.fit must be one of template, both, got 'tight'"),
    ],
)
def test_impossible_values(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, MINIMAL + text)


@pytest.mark.parametrize("name", ["", "..", "a/b", "/a", "a\\\\b", ".hidden"])
def test_the_name_must_do_as_a_file_name(tmp_path, name):
    with pytest.raises(ConfigError, match="name must be a plain file name"):
        load(tmp_path, f'name = "{name}"\ngarment = "shirt.obj"')


@pytest.mark.parametrize("content", [b"name = ", b"\xff\xfe", b"[a\n"])
def test_unreadable_files(tmp_path, content):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="cannot read configuration .*run.toml"):
        load_config(path)
    with pytest.raises(ConfigError, match="nowhere.toml"):
        load_config(tmp_path / "nowhere.toml")
