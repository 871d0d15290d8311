"""Training configuration: one TOML file, unknown keys refused."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import get_type_hints

from physkin_core.model.garment_model import Material
from physkin_training.networks.networks import NetworkConfig
from physkin_training.physics.wearing import OTHER_LIMBS
from physkin_training.sampling.fantastical_bodies import BODY_DISTRIBUTIONS

__all__ = ["ConfigError", "TrainingConfig", "load_config"]


FITS = ("template", "both")


class ConfigError(ValueError):
    """A training configuration cannot be used."""


def _check(config, table: str, keys: str, allowed: str, holds: Callable) -> None:
    for key in keys.split():
        value = getattr(config, key)
        if not holds(value):
            raise ConfigError(f"{table}{key} must be {allowed}, got {value!r}")


@dataclass(frozen=True)
class OptimisationConfig:
    """Steps and schedules.

    minutes: if above 0, `steps` is chosen so that the run takes that long (see `Trainer.choose_steps`). samples: poses
    a step, spread evenly over `bodies`. Learning rates decay along a cosine to `final_rate` of the start after a linear
    warm-up over `warm_up` of the run; `skinning_rate` 0 leaves skinning weights as they start. Pose range and contact
    stiffness (from `initial_contact` of the material's) grow until `growth` of the run; then contact is looked for
    `late_reach` [m] away, before 0.1 m. From `prune_from` to `prune_at` of the run, influences a vertex fall one by one
    to `garment_nodes.influences`; from `full_encoding` on, bodies are encoded from all 4096 points, before from
    `encoder_points` of them. `contact_linear_beyond` [m], `heavy_energy` [J]: see `PhysicsLosses`. `average`: decay a
    step of the moving average of networks and skinning weights that is exported, 0 for none. `validate_every`: steps
    from one measurement of the average to the next, once range and influences are final; the best one is exported.
    `fit`: "template", one rest shape for all bodies; "both": every second body of a step wears it made to measure.
    `other_limbs`: those that a vertex lies nowhere on press it "one_way", towards its own place on the body, or
    "both_ways", as any part does (see `Wearing`).
    """

    steps: int = 100000
    minutes: float = 0.0
    samples: int = 96
    bodies: int = 12
    learning_rate: float = 5e-4
    skinning_rate: float = 1e-2
    final_rate: float = 0.005
    warm_up: float = 0.01
    growth: float = 0.35
    initial_contact: float = 0.1
    late_reach: float = 0.05
    prune_from: float = 0.3
    prune_at: float = 0.6
    full_encoding: float = 0.93
    encoder_points: int = 1024
    gradient_clip: float = 10.0
    contact_linear_beyond: float = 0.01
    heavy_energy: float = 0.1
    average: float = 0.999
    validate_every: int = 500
    fit: str = "template"
    other_limbs: str = "one_way"

    def __post_init__(self) -> None:
        def check(keys: str, allowed: str, holds: Callable) -> None:
            _check(self, "optimisation.", keys, allowed, holds)

        check("steps samples bodies encoder_points validate_every", "at least 1", lambda value: value >= 1)
        check("learning_rate", "finite and above 0", lambda value: 0 < value < math.inf)
        check("minutes skinning_rate", "finite and at least 0", lambda value: 0 <= value < math.inf)
        check("gradient_clip contact_linear_beyond heavy_energy late_reach", "above 0", lambda value: value > 0)
        check(
            "final_rate warm_up growth initial_contact prune_from prune_at full_encoding",
            "0 to 1",
            lambda value: 0 <= value <= 1,
        )
        check("average", "at least 0 and below 1", lambda value: 0 <= value < 1)
        check("prune_at", f"at least optimisation.prune_from {self.prune_from}", lambda value: value >= self.prune_from)
        multiple = f"a multiple of optimisation.bodies {self.bodies}"
        check("samples", multiple, lambda value: value % self.bodies == 0)
        check("fit", "one of " + ", ".join(FITS), lambda value: value in FITS)
        check("other_limbs", "one of " + ", ".join(OTHER_LIMBS), lambda value: value in OTHER_LIMBS)

    @property
    def made_to_measure(self) -> bool:
        """Whether rest shapes graded to the body are trained on, too."""
        return self.fit == "both"


@dataclass(frozen=True)
class GarmentNodeConfig:
    """Garment nodes and skinning: `count` nodes, `initial_influences` a vertex while training, `influences` shipped."""

    count: int = 128
    initial_influences: int = 16
    influences: int = 16

    def __post_init__(self) -> None:
        _check(self, "garment_nodes.", "count", "at least 1", lambda value: value >= 1)
        fewer = f"1 to garment_nodes.count {self.count}"
        _check(self, "garment_nodes.", "initial_influences", fewer, lambda value: 1 <= value <= self.count)
        fewer = f"1 to garment_nodes.initial_influences {self.initial_influences}"
        _check(self, "garment_nodes.", "influences", fewer, lambda value: 1 <= value <= self.initial_influences)


@dataclass(frozen=True)
class PoseConfig:
    """Pose sampling: share of `upright` roots, the others tilted by up to `largest_tilt_degrees`."""

    upright: float = 0.5
    largest_tilt_degrees: float = 110.0

    def __post_init__(self) -> None:
        _check(self, "poses.", "upright", "0 to 1", lambda value: 0 <= value <= 1)
        _check(self, "poses.", "largest_tilt_degrees", "0 to 180", lambda value: 0 <= value <= 180)


@dataclass(frozen=True)
class TrainingConfig:
    """All of one training run. name: of the model file. garment: mesh path relative to the configuration file.
    body_distribution: whom it is trained on, "adults" or "fantastical"
    (see `physkin_training.sampling.fantastical_bodies`)."""

    name: str
    garment: Path
    seed: int = 0
    train_bodies: int = 512
    body_distribution: str = "adults"
    optimisation: OptimisationConfig = field(default_factory=OptimisationConfig)
    garment_nodes: GarmentNodeConfig = field(default_factory=GarmentNodeConfig)
    poses: PoseConfig = field(default_factory=PoseConfig)
    networks: NetworkConfig = field(default_factory=NetworkConfig)
    material: Material = field(default_factory=Material)

    def __post_init__(self) -> None:
        _check(self, "", "name", "a plain file name", lambda value: re.fullmatch(r"\w[\w. -]*", value))
        _check(self, "", "seed", "0 to 2^63 - 1", lambda value: 0 <= value < 2**63)
        _check(self, "", "train_bodies", "at least 1", lambda value: value >= 1)
        known = ", ".join(BODY_DISTRIBUTIONS)
        _check(self, "", "body_distribution", f"one of {known}", lambda value: value in BODY_DISTRIBUTIONS)

    def as_plain_data(self) -> dict:
        """Tables, strings and numbers, for checkpoints and the model file; of the garment's path only the file name."""
        return asdict(self) | {"garment": self.garment.name}


def load_config(path: str | Path) -> TrainingConfig:
    """Read a TOML configuration. Raises ConfigError on unknown keys, wrong types or impossible values."""
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot read configuration {path}: {error}") from error
    optimisation = data.get("optimisation")
    if isinstance(optimisation, dict) and "steps" in optimisation and optimisation.get("minutes"):
        raise ConfigError(f"{path}: optimisation has both steps and minutes; give one of them")
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
