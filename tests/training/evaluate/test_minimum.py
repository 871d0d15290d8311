"""Energy minima: what garment nodes can reach, and start > subspace minimum > full-space minimum on a clothed body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from random_models import random_model, random_rotation, tube

from physkin_core import Garment, load_body_model
from physkin_core.model.detail import Detail
from physkin_core.model.garment_nodes import closest_bones
from physkin_training.evaluate import minimum
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.evaluate.minimum import subspace_minimum
from physkin_training.networks.draping import compose_nodes, delta_transforms
from physkin_training.networks.export import drape_from_model

CPU = torch.device("cpu")
BODY = load_body_model()


def with_detail(rng, model):
    """The model with six detail nodes, two of them a vertex."""
    n, width = len(model.garment.vertices), len(model.node_deformer[-1][0].T)
    detail = Detail(
        features=(rng.normal(size=(5, width)).astype(np.float32), np.zeros(5, dtype=np.float32)),
        offsets=0.01 * rng.normal(size=(18, 5)).astype(np.float32),
        nodes=np.stack([np.arange(n) % 3, 3 + np.arange(n) % 3], axis=1).astype(np.int32),
        weights=np.full((n, 2), 0.5, dtype=np.float32),
    )
    return replace(model, detail=detail)


@pytest.mark.parametrize("detailed", [False, True])
def test_subspace_finds_a_drape_that_the_nodes_can_reach(detailed, monkeypatch):
    """The energy is the squared distance to a drape made with known node numbers, and with detail that stays."""
    monkeypatch.setattr(minimum, "STEPS", 500)
    monkeypatch.setattr(minimum, "RATE", 0.02)
    rng = np.random.default_rng(0)
    model = random_model(rng, nodes=4)
    drape = drape_from_model(with_detail(rng, model) if detailed else model)
    detail = torch.as_tensor(0.05 * rng.normal(size=(2, 6, 3)), dtype=torch.float32) if detailed else None
    posed = torch.as_tensor(
        np.array([[np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(4)] for _ in range(2)]),
        dtype=torch.float32,
    )

    def shape(raw):
        return drape.skin(compose_nodes(posed, delta_transforms(raw)), detail=detail)

    with torch.no_grad():
        goal = shape(torch.as_tensor(0.1 * rng.normal(size=(2, 4, 12)), dtype=torch.float32))
    start = torch.zeros(2, 4, 12)

    def distance(result):
        return (result - goal).square().sum(dim=-1).mean().sqrt().item()

    result = subspace_minimum(lambda x: (x - goal).square().mean(), drape, posed, start, detail=detail)
    assert distance(shape(start)) > 0.02 and distance(result) < 1e-3
    assert not result.requires_grad
    assert not start.any(), "the start is left alone"


@pytest.mark.slow
def test_minima_on_a_clothed_body_are_in_order(monkeypatch):
    """The model's energy is above the subspace minimum's, and that above the full-space minimum's; gravity included."""
    monkeypatch.setattr(minimum, "STEPS", 100)
    band = tube(rings=9, segments=20, radius=1.0, height=0.3)
    garment = Garment(band.vertices * [0.19, 0.23, 1.0] + [0, 0, 0.12], band.faces)
    model = random_model(
        np.random.default_rng(1), rig=BODY.rig, garment=garment, nodes=12, influences=6, correction=0.005
    )
    model = replace(model, node_bone=closest_bones(model.node_rest, BODY.rig.heads, BODY.rig.tails))
    evaluation = Evaluation(model, CPU, bodies=1, poses=2, seed=0)
    rows = evaluation.minima(evaluation.uniform(upright=True))
    assert list(rows) == ["model_on_subset", "subspace_minimum", "minimum"]
    total = {name: row["energy_j"] + row["gravity_j"] for name, row in rows.items()}
    assert total["minimum"] < total["subspace_minimum"] < total["model_on_subset"]
    assert rows["minimum"]["edge_strain_percent"] < 0.5 * rows["model_on_subset"]["edge_strain_percent"]
