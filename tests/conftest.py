"""Fixtures of several folders: a small garment model with random networks, as a file and in memory."""

from __future__ import annotations

import signal
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from random_models import random_model

from physkin_core import Garment, GarmentModel, load_body_model, load_garment_model, save_garment_model
from physkin_core.model.garment import vertex_normals
from physkin_core.model.garment_nodes import closest_bones

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background: children would inherit the deafness
    signal.signal(signal.SIGINT, signal.default_int_handler)


NEEDED = ("torch", "warp", "pydantic", "potpourri3d")
MISSING = [name for name in NEEDED if find_spec(name) is None]
collect_ignore = ["training", "studies"] if MISSING else []


def pytest_report_header() -> str | None:
    """Says what is left out where the [training] extra is not installed."""
    return f"left out: tests of training and studies, which need {', '.join(MISSING)}" if MISSING else None


@pytest.fixture
def exact_network_weights(monkeypatch):
    """Where a test does not choose, the native evaluator computes with network weights in fp32, as the reference."""
    monkeypatch.setenv("PHYSKIN_NATIVE_PRECISION", "fp32")


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
    body = load_body_model()
    vertices, faces = body.vertices(body.garment_body), body.faces
    height = vertices[:, 2] - body.rig.heads[0, 2]
    worn = (height > 0.0) & (height < 0.4)
    used, kept = np.unique(faces[worn[faces].all(axis=1)], return_inverse=True)
    surface = vertices[used] + 0.01 * vertex_normals(vertices, faces)[used]
    garment = Garment(surface, kept.reshape(-1, 3))
    model = random_model(np.random.default_rng(7), rig=body.rig, garment=garment, nodes=16, correction=0.005)
    bones = closest_bones(model.node_rest, body.rig.heads, body.rig.tails)
    return replace(model, name="vest", node_bone=bones, training={}, scores={})
