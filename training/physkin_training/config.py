"""Training configuration: one TOML file, unknown keys refused."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import get_type_hints

from physkin_core.garment_model import Material
from physkin_training.networks import NetworkConfig

__all__ = ["ConfigError", "TrainingConfig", "load_config"]


class ConfigError(ValueError):
    """A training configuration cannot be used."""


@dataclass(frozen=True)
class OptimisationConfig:
    """Steps and schedules.

    samples: poses a step, spread evenly over `bodies`. Learning rates decay along a cosine to `final_rate` of the start
    after a linear warm-up over `warm_up` of the run. Pose range and contact stiffness (from `initial_contact` of the
    material's) grow until `growth` of the run. From `prune_at` of the run on, only `garment_nodes.influences` garment
    nodes a vertex remain; from `full_encoding` on, bodies are encoded from all 4096 points, before from
    `encoder_points` of them. `contact_linear_beyond` [m] and `force_limit` [N]: see `PhysicsLosses`.
    """

    steps: int = 150000
    samples: int = 96
    bodies: int = 12
    learning_rate: float = 5e-4
    skinning_rate: float = 5e-3
    final_rate: float = 0.005
    warm_up: float = 0.01
    growth: float = 0.15
    initial_contact: float = 0.05
    prune_at: float = 0.25
    full_encoding: float = 0.85
    encoder_points: int = 1024
    gradient_clip: float = 1.0
    contact_linear_beyond: float = 0.005
    force_limit: float = 5.0


@dataclass(frozen=True)
class GarmentNodeConfig:
    """Garment nodes and skinning: `count` nodes, `initial_influences` a vertex while training, `influences` shipped."""

    count: int = 128
    initial_influences: int = 16
    influences: int = 8


@dataclass(frozen=True)
class PoseConfig:
    """Pose sampling: share of `upright` roots, the others tilted by up to `largest_tilt_degrees`."""

    upright: float = 0.5
    largest_tilt_degrees: float = 110.0


@dataclass(frozen=True)
class TrainingConfig:
    """All of one training run. `garment` is a mesh path relative to the configuration file."""

    name: str
    garment: Path
    seed: int = 0
    train_bodies: int = 512
    optimisation: OptimisationConfig = field(default_factory=OptimisationConfig)
    garment_nodes: GarmentNodeConfig = field(default_factory=GarmentNodeConfig)
    poses: PoseConfig = field(default_factory=PoseConfig)
    networks: NetworkConfig = field(default_factory=NetworkConfig)
    material: Material = field(default_factory=Material)

    def __post_init__(self) -> None:
        o = self.optimisation
        if o.bodies < 1 or o.samples % o.bodies:
            raise ConfigError(f"optimisation.samples {o.samples} must be a multiple of optimisation.bodies {o.bodies}")
        if o.steps < 1 or o.learning_rate <= 0 or o.encoder_points < 1:
            raise ConfigError(
                "optimisation needs steps >= 1, learning_rate > 0 and encoder_points >= 1; got "
                f"{o.steps}, {o.learning_rate}, {o.encoder_points}"
            )


def load_config(path: str | Path) -> TrainingConfig:
    """Read a TOML configuration. Raises ConfigError on unknown keys, wrong types or impossible values."""
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot read configuration {path}: {error}") from error
    config = build(TrainingConfig, data, where=str(path))
    return replace(config, garment=(path.parent / config.garment).resolve())


def build(kind: type, data: dict, *, where: str):
    """Make a configuration dataclass from plain data, refusing unknown keys and wrong types."""
    hints = get_type_hints(kind)
    allowed = [f.name for f in fields(kind)]
    values = {}
    for key, value in data.items():
        if key not in allowed:
            raise ConfigError(f"{where}: unknown key {key!r}; allowed: {', '.join(allowed)}")
        expected = hints[key]
        if is_dataclass(expected):
            if not isinstance(value, dict):
                raise ConfigError(f"{where}: {key} must be a table, got {value!r}")
            values[key] = build(expected, value, where=f"{where}: {key}")
        elif expected is Path and isinstance(value, str):
            values[key] = Path(value)
        elif expected is float and isinstance(value, int) and not isinstance(value, bool):
            values[key] = float(value)
        elif type(value) is expected:
            values[key] = value
        else:
            raise ConfigError(f"{where}: {key} must be {expected.__name__}, got {value!r}")
    try:
        return kind(**values)
    except TypeError as error:
        raise ConfigError(f"{where}: {error}") from error
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from error
