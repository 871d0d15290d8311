"""Small trainings for the tests of trainer, checkpoint and export: a belly band on three bodies, tiny networks.

A step takes a few hundredths of a second on a CPU, one with all body points half a second.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import random_model, tube

from physkin_core import Draper, Garment, GarmentModel, load_body_model
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import MeshFile
from physkin_training.config import (
    DetailConfig,
    GarmentNodeConfig,
    NetworkConfig,
    OptimisationConfig,
    TrainingConfig,
)
from physkin_training.networks.export import model_from_drape
from physkin_training.sway import body_codes, learning, walker_simulation
from physkin_training.train.trainer import Trainer

SIZES = NetworkConfig(
    pose_hidden=24,
    pose_layers=2,
    deformer_hidden=16,
    deformer_layers=2,
    token_width=8,
    feed_forward=16,
    residual_blocks=1,
)


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> MeshFile:
    """As it is read from a file of shape alone."""
    return MeshFile(vertices, faces, 0, Look.plain(len(faces)))


def write_belly_band(path: Path) -> None:
    """A tube of 286 vertices about the waist of the garment maker's body, as OBJ."""
    garment = tube(rings=11, segments=26, radius=1.0, height=0.3)
    vertices = garment.vertices * np.array([0.16, 0.2, 1.0]) + np.array([0.0, 0.0, 0.12])
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (garment.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def waist_band_model(**options) -> GarmentModel:
    """A model with random networks of a band about the waist, tight enough to be inside some bodies in places.
    options: of `random_model`."""
    band = tube(rings=9, segments=20, radius=1.0, height=0.3)
    garment = Garment(band.vertices * [0.15, 0.18, 1.0] + [0, 0, 0.12], band.faces)
    rig = load_body_model().rig
    return random_model(np.random.default_rng(1), rig=rig, garment=garment, nodes=12, correction=0.02, **options)


def networks_alone(*given, **options) -> Draper:
    """A draper that does not keep cloth out of the skin, as evaluation and training drape it."""
    draper = Draper(*given, precision="fp32", **options)
    draper.outfit = draper.outfit.with_bound_garment(0, draper.bound.without_contact)
    return draper


def simulate_walkers_quickly(patch: pytest.MonkeyPatch) -> None:
    """Few bodies, and so few products that limbs go through the cloth, which is not lost for it."""
    for module, name, value in (
        (body_codes, "BODIES", 3),
        (learning, "BATCH", 4),
        (walker_simulation, "NEWTON", 1),
        (walker_simulation, "PRODUCTS", 3),
        (walker_simulation, "FIRST_STEPS", 1),
        (walker_simulation, "MOST_DEEP", 1.0),
    ):
        patch.setattr(module, name, value)


SMALL_DETAIL = DetailConfig(nodes=40, features=8, influences=3)
NODES = GarmentNodeConfig(count=12, initial_influences=6, influences=3, engine_influences=2)


def small_config(folder: Path, **optimisation) -> TrainingConfig:
    """Twelve steps of four samples; influences are pruned after the third, all body points used in the twelfth.

    The average is measured after the eighth and the twelfth.
    """
    path = folder / "band.obj"
    if not path.exists():
        write_belly_band(path)
    schedule = OptimisationConfig(
        steps=12, samples=4, bodies=2, growth=0.5, warm_up=0.1, prune_from=0.2, prune_at=0.25, full_encoding=0.9,
        encoder_points=64, learning_rate=2e-3, validate_every=4,
    )  # fmt: skip
    return TrainingConfig(
        name="band",
        garment=path,
        seed=5,
        train_bodies=3,
        optimisation=replace(schedule, **optimisation),
        garment_nodes=NODES,
        networks=SIZES,
    )


def exported(trainer: Trainer, influences: int, *, engine_influences: int = 2) -> GarmentModel:
    """The trained drape (not the average) as a model of so many influences a vertex."""
    config = trainer.config
    given = {"name": "band", "influences": influences, "material": config.material, "training": {"seed": config.seed}}
    return model_from_drape(trainer.drape, trainer.garment, trainer.rig, engine_influences=engine_influences, **given)


def train_command(folder: Path, *more: object, config: str = "band.toml", out: str | Path = "out") -> list[str]:
    """Arguments of `physkin`, a training on the CPU: a configuration in the folder, an output folder in it."""
    return [
        "train",
        "--config",
        str(folder / config),
        "--output",
        str(folder / out),
        "--device",
        "cpu",
        *map(str, more),
    ]


def run(trainer: Trainer, steps: int) -> None:
    """Up to `steps` more steps."""
    for _ in trainer.run(steps):
        pass
