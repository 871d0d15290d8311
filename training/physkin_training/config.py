"""Training configuration: one TOML file, unknown keys refused. Reading it needs neither torch nor Warp."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, field, fields, replace
from pathlib import Path
from typing import Annotated, get_type_hints

from pydantic import BeforeValidator, ConfigDict, Field, InstanceOf, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from physkin_core.file_reading import ContentError, read_text, reading
from physkin_core.model.garment_model import Material
from physkin_core.model.hyper_modulator import HEADS

__all__ = [
    "ConfigError",
    "DetailConfig",
    "GarmentNodeConfig",
    "NetworkConfig",
    "OptimisationConfig",
    "TrainingConfig",
    "as_toml",
    "load_config",
]

Count = Annotated[int, Field(strict=True, ge=1)]
Real = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]

STRICT = ConfigDict(extra="forbid")
LARGEST_CONFIG = 1 << 20  # [bytes]


class ConfigError(ValueError):
    """A training configuration cannot be used."""


@dataclass(frozen=True, config=STRICT)
class OptimisationConfig:
    """Steps and schedules.

    samples: poses a step, spread evenly over `bodies`. Learning rates decay along a cosine after a linear warm-up
    over `warm_up` of the run; `skinning_rate` 0 leaves skinning weights as they start. Pose range and contact
    stiffness grow until `growth` of the run. From `prune_from` to `prune_at` of the run, influences a vertex fall
    one by one to `garment_nodes.influences`; from `full_encoding` on, bodies are encoded from all 4096 points,
    before from `encoder_points` of them. `validate_every`: steps from one measurement of the moving average to the
    next, once range and influences are final; the best one is exported. `patience`: measurements without a better
    one after which the run goes on with its last 40 %, where learning rates are low, and after as many there ends;
    0 for all steps. `steadiness` [J/m2]: weight of garment nodes that jump between poses beside each other (see
    `Steadiness`). `other_bending`: share of the bodies whose cloth bends otherwise, from a quarter to 32 times as
    stiffly. Every second body of a step wears the garment made to measure.
    """

    steps: Count = 100000
    samples: Count = 192
    bodies: Count = 12
    learning_rate: Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)] = 2e-3
    skinning_rate: Real = 1e-2
    warm_up: Share = 0.01
    growth: Share = 0.25
    prune_from: Share = 0.3
    prune_at: Share = 0.6
    full_encoding: Share = 0.93
    encoder_points: Count = 1024
    steadiness: Real = 1000.0
    validate_every: Count = 500
    patience: Annotated[int, Field(strict=True, ge=0)] = 0
    other_bending: Share = 0.5

    def __post_init__(self) -> None:
        if self.prune_at < self.prune_from:
            raise ValueError(f"prune_at must be at least prune_from {self.prune_from}, got {self.prune_at}")
        if self.samples % self.bodies:
            raise ValueError(f"samples must be a multiple of bodies {self.bodies}, got {self.samples}")


@dataclass(frozen=True, config=STRICT)
class GarmentNodeConfig:
    """Garment nodes and skinning: `count` nodes, `initial_influences` a vertex while training, `influences` shipped.

    `engine_influences`: of a second set of skinning weights, for engines; an eighth of the samples is skinned by it.
    """

    count: Count = 128
    initial_influences: Count = 16
    influences: Count = 16
    engine_influences: Count = 4

    def __post_init__(self) -> None:
        if self.initial_influences > self.count:
            raise ValueError(f"initial_influences must be 1 to count {self.count}, got {self.initial_influences}")
        for name in ("influences", "engine_influences"):
            if getattr(self, name) > self.initial_influences:
                raise ValueError(
                    f"{name} must be 1 to initial_influences {self.initial_influences}, got {getattr(self, name)}"
                )


@dataclass(frozen=True, config=STRICT)
class DetailConfig:
    """Folds between garment nodes (see `physkin_core.model.detail`): `nodes` detail nodes, `influences` of them a
    vertex, moved by `features` numbers. nodes 0, the default: none, the garment is what its garment nodes make of
    it."""

    nodes: Annotated[int, Field(strict=True, ge=0)] = 0
    features: Count = 96
    influences: Count = 6


@dataclass(frozen=True, config=STRICT)
class NetworkConfig:
    """Sizes of the networks.

    As many network weights a frame as the paper's (a pose modulator of 4 layers of 512, a node deformer of 4 of 128),
    spent where they do more: a node deformer twice as wide, whose last layer spans twice as many drapes. pose_rank: of
    the pose modulator's layers but the first, each then a product of two (see `physkin_core.model.mlp`); 0: full.
    drapes: width of the node deformer's last hidden layer, so many drapes it mixes; 0: as the others.
    """

    pose_hidden: Count = 384
    pose_layers: Count = 3
    pose_rank: Annotated[int, Field(strict=True, ge=0)] = 0
    deformer_hidden: Count = 256
    deformer_layers: Count = 4
    drapes: Annotated[int, Field(strict=True, ge=0)] = 0
    token_width: Annotated[Count, Field(multiple_of=HEADS)] = 128
    feed_forward: Count = 256
    residual_blocks: Annotated[int, Field(strict=True, ge=0)] = 2

    @property
    def deformer_widths(self) -> list[int]:
        """Of the node deformer's hidden layers."""
        return [self.deformer_hidden] * (self.deformer_layers - 1) + [self.drapes or self.deformer_hidden]


def _as_material(data: object) -> object:
    """A table as a `Material`, which checks its numbers itself."""
    if not isinstance(data, dict):
        return data
    allowed = [entry.name for entry in fields(Material)]
    if unknown := sorted(set(data) - set(allowed)):
        raise ValueError(f"unknown key {unknown[0]!r}; allowed: {', '.join(allowed)}")
    return Material(**data)


@dataclass(frozen=True, config=STRICT)
class TrainingConfig:
    """All of one training run. name: of the model file. garment: mesh path, in a file relative to that file. start: a
    model of that mesh, likewise, whose garment nodes, networks and weights it begins with; default from nothing."""

    name: Annotated[str, Field(pattern=r"^\w[\w. -]*$")]
    garment: Path
    start: Path | None = None
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    train_bodies: Count = 512
    optimisation: OptimisationConfig = field(default_factory=OptimisationConfig)
    garment_nodes: GarmentNodeConfig = field(default_factory=GarmentNodeConfig)
    networks: NetworkConfig = field(default_factory=NetworkConfig)
    detail: DetailConfig = field(default_factory=DetailConfig)
    material: Annotated[InstanceOf[Material], BeforeValidator(_as_material)] = field(default_factory=Material)

    def __post_init__(self) -> None:
        least = 2 * self.optimisation.bodies
        if self.optimisation.samples < least:
            raise ValueError(
                f"optimisation.samples must be at least {least}, two poses a body, one of them for engines, got "
                f"{self.optimisation.samples}"
            )

    def as_plain_data(self) -> dict:
        """Tables, strings and numbers, for checkpoints and the model file; of paths only the file names."""
        plain = asdict(self)
        start = plain.pop("start")
        return plain | {"garment": self.garment.name} | ({"start": start.name} if start else {})


def load_config(path: str | Path, *, name: str | None = None, garment: Path | None = None) -> TrainingConfig:
    """Read a TOML configuration.

    name, garment: take the place of the file's own, which is then a recipe and need not name any; `garment` is relative
    to the working folder. Raises ConfigError on unknown or missing keys, wrong types or impossible values.
    """
    path = Path(path)
    given = {"name": name, "garment": garment and garment.resolve()}
    with reading(f"configuration {path}", ConfigError):
        data = tomllib.loads(read_text(path, most=LARGEST_CONFIG))
        data |= {key: value for key, value in given.items() if value is not None}
        try:
            config = TypeAdapter(TrainingConfig).validate_python(data)
        except ValidationError as error:
            raise ContentError("; ".join(map(_in_words, error.errors()))) from error
    start = config.start and (path.parent / config.start).resolve()
    return replace(config, garment=(path.parent / config.garment).resolve(), start=start)


def as_toml(config: TrainingConfig) -> str:
    """A configuration as the text of a file that `load_config` reads; the garment by its file name alone."""
    data = config.as_plain_data()
    tables = {name: value for name, value in data.items() if isinstance(value, dict)}

    def lines(values: dict) -> list[str]:
        return [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in values.items()]

    text = lines({name: value for name, value in data.items() if name not in tables})
    for name, values in tables.items():
        text += ["", f"[{name}]", *lines(values)]
    return "\n".join(text) + "\n"


def _in_words(error: dict) -> str:
    """One of pydantic's errors in a sentence: the key, what is allowed, the value."""
    place = ".".join(map(str, error["loc"]))
    if error["type"] == "unexpected_keyword_argument":
        *tables, key = error["loc"]
        kind = TrainingConfig
        for table in tables:
            kind = get_type_hints(kind)[table]
        where = f"{'.'.join(tables)}: " if tables else ""
        return f"{where}unknown key {key!r}; allowed: {', '.join(entry.name for entry in fields(kind))}"
    if error["type"] == "missing":
        return f"{place} is missing, and no --garment gives it"
    message = error["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    where = f"{place}: " if place else ""
    return where + message + ("" if error["type"] == "value_error" else f", got {error['input']!r}")
