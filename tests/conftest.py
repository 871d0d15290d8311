"""Fixtures of several folders: a small garment model with random networks, as a file and in memory."""

from __future__ import annotations

import signal
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
from random_models import random_hyper_modulator

from physkin_core import (
    BUNDLED_AVATAR,
    Garment,
    GarmentModel,
    Outfit,
    WornGarment,
    load_avatar,
    load_body_model,
    load_garment_model,
    save_garment_model,
)
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.model.garment import vertex_normals
from physkin_core.model.mlp import modulation_size

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background: children would inherit the deafness
    signal.signal(signal.SIGINT, signal.default_int_handler)


NEEDED = ("torch", "warp", "pydantic", "potpourri3d")
MISSING = [name for name in NEEDED if find_spec(name) is None]
collect_ignore = ["training"] if MISSING else []


def pytest_report_header() -> str | None:
    """Says what is left out where the [training] extra is not installed."""
    return f"left out: tests of training, which need {', '.join(MISSING)}" if MISSING else None


@pytest.fixture
def exact_network_weights(monkeypatch):
    """Where a test does not choose, the native evaluator computes with network weights in fp32, as the reference."""
    monkeypatch.setenv("PHYSKIN_NATIVE_PRECISION", "fp32")


@pytest.fixture(scope="session")
def asset_loader():
    """A loader with a process of its own, for all who need one."""
    loader = AssetLoader()
    yield loader
    loader.close()


@pytest.fixture(scope="session")
def shipped():
    """Shipped garment models by name, each read once."""
    return cache(load_garment_model)


@pytest.fixture(scope="session")
def worn(shipped):
    """Outfits of shipped garments on the bundled avatar, by name, from the skin outwards, each bound once. tucked: the
    name of one that is tucked in. options: of `Outfit`. Who asks gets a twin, with frames of its own."""

    @cache
    def bound(names: tuple[str, ...], tucked: str, options: frozenset) -> Outfit:
        garments = [WornGarment(shipped(name), tucked=name == tucked) for name in names]
        return Outfit(garments, load_avatar(BUNDLED_AVATAR, garments[0].model.rig), **dict(options))

    return lambda *names, tucked="", **options: bound(names, tucked, frozenset(options.items())).twin()


@pytest.fixture(scope="session")
def model_path(tmp_path_factory):
    """A garment model file."""
    path = tmp_path_factory.mktemp("models") / "vest.safetensors"
    save_garment_model(_vest(), path)
    return path


@pytest.fixture(scope="session")
def garment_model(model_path) -> GarmentModel:
    """What the file holds."""
    return load_garment_model(model_path)


def _vest() -> GarmentModel:
    """A garment of a few thousand vertices on 16 garment nodes, with small random networks."""
    random = np.random.default_rng(7)
    body = load_body_model()
    vertices, faces = body.vertices(body.garment_body), body.faces
    height = vertices[:, 2] - body.rig.heads[0, 2]
    worn = (height > 0.0) & (height < 0.4)
    kept = faces[worn[faces].all(axis=1)]
    used, kept = np.unique(kept, return_inverse=True)
    surface = vertices[used] + 0.01 * vertex_normals(vertices, faces)[used]
    nodes = np.linspace(0, len(used) - 1, 16).astype(int)
    distance = np.linalg.norm(surface[:, None] - surface[nodes], axis=-1)
    influences = np.argsort(distance, axis=1)[:, :4]
    weights = np.exp(-10 * np.take_along_axis(distance, influences, axis=1))

    def layers(*sizes: int):
        pairs = zip(sizes[:-1], sizes[1:])
        return tuple((0.1 * random.normal(size=(o, i)) / i**0.5, 0.01 * random.normal(size=o)) for i, o in pairs)

    deformer = layers(12 * 16, 16, 16, 12 * 16)
    pose = layers(body.rig.pose_size, 16, 16, modulation_size(deformer))
    strongest = body.influence_weights[used[nodes]].argmax(axis=1)
    return GarmentModel(
        name="vest",
        rig=body.rig,
        garment=Garment(surface, kept.reshape(-1, 3)),
        rest_normals=vertex_normals(surface, kept.reshape(-1, 3)),
        node_rest=surface[nodes].astype(np.float32),
        node_bone=body.influence_bones[used[nodes], strongest].astype(np.int32),
        influence_nodes=influences.astype(np.int32),
        influence_weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        engine_nodes=influences[:, :2].astype(np.int32),
        engine_weights=(weights[:, :2] / weights[:, :2].sum(axis=1, keepdims=True)).astype(np.float32),
        hyper_modulator=random_hyper_modulator(random, modulation_size(pose), blocks=1),
        pose_modulator=tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in pose),
        node_deformer=tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in deformer),
    )
