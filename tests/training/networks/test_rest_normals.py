"""Rest normals fitted to drapes: closer to the cloth, and exactly right where skinning is linear."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from physkin_core import load_garment_model, save_garment_model
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.rig.rig import Rig
from physkin_training.config import NetworkConfig
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import drape_from_model
from physkin_training.networks.garment_nodes import GarmentNodeSet
from physkin_training.networks.rest_normals import (
    MEASURED_BODIES,
    MEASURED_FRAMES,
    fitted_rest_normals,
    main,
    normal_errors,
)


def with_own_normals(model):
    """With the normals of its mesh."""
    return replace(model, rest_normals=vertex_normals(model.garment.vertices, model.garment.faces))


@pytest.fixture(scope="module")
def tshirt():
    """Without detail, which has normals of its faces."""
    return replace(load_garment_model("tshirt"), detail=None)


@pytest.mark.parametrize("name", ["tshirt", "trousers"])
def test_fitted_normals_are_nearer_to_the_draped_mesh_s(name):
    """Than its own normals carried, in the middle and at the worst, and nowhere farther, but where the worst is small.
    Of garments without detail: with it they have normals of their faces."""
    model = replace(load_garment_model(name), detail=None)
    model = replace(model, rest_normals=fitted_rest_normals(drape_from_model(model), model.garment, model.rig))
    fitted, own = (
        normal_errors(each, bodies=MEASURED_BODIES, frames=MEASURED_FRAMES) for each in (model, with_own_normals(model))
    )
    for take, errors in fitted.items():
        assert errors.median < 1.05 * own[take].median
        assert errors.p99 < max(1.06 * own[take].p99, 30.0)
    assert fitted["uniform"].median < 0.9 * own["uniform"].median
    assert fitted["uniform"].p99 < (0.97 if name == "trousers" else 0.93) * own["uniform"].p99  # folds lie either way


def test_where_one_node_carries_everything_the_normals_are_the_mesh_s_own(tshirt):
    """A rigid garment needs no correction, whatever the poses."""
    garment = Garment(tshirt.garment.vertices, tshirt.garment.faces)
    ones = np.ones((len(garment.vertices), 1), dtype=np.float32)
    nodes = GarmentNodeSet(tshirt.node_rest[:1], tshirt.node_bone[:1], 0 * ones.astype(np.int32), ones)
    config = NetworkConfig(pose_hidden=8, pose_layers=1, deformer_hidden=8, deformer_layers=1, token_width=8)
    drape = Drape(garment, nodes, tshirt.rig, config)
    torch.nn.init.zeros_(drape.networks.node_deformer.layers[-1].weight)
    fitted = fitted_rest_normals(drape, garment, tshirt.rig, bodies=1, poses=2)
    np.testing.assert_allclose(fitted, vertex_normals(garment.vertices, garment.faces), atol=1e-4)


@pytest.mark.parametrize("wrong", [{"bodies": 0}, {"bodies": 10**6}, {"poses": 0}])
def test_impossible_numbers_and_other_rigs_are_refused(tshirt, wrong):
    with pytest.raises(ValueError, match="allowed"):
        fitted_rest_normals(drape_from_model(tshirt), tshirt.garment, tshirt.rig, **wrong)
    rig = Rig.from_json(tshirt.rig.to_json() | {"dofs": tshirt.rig.to_json()["dofs"][1:]})
    with pytest.raises(ValueError, match="rig"):
        fitted_rest_normals(drape_from_model(tshirt), tshirt.garment, rig)


def test_store_writes_what_it_fitted(tmp_path, monkeypatch, capsys):
    """What it did for a shipped model before that was rounded; nothing else changes; the table has a row before and one
    after."""
    shipped, path = load_garment_model("trousers"), tmp_path / "mine.safetensors"
    save_garment_model(with_own_normals(shipped), path)
    before = load_garment_model(path)
    monkeypatch.setattr("physkin_training.networks.rest_normals.MEASURED_BODIES", 1)
    monkeypatch.setattr("physkin_training.networks.rest_normals.MEASURED_FRAMES", 1)
    assert main([str(path), "--store"]) == 0
    stored = load_garment_model(path)
    np.testing.assert_allclose(stored.rest_normals, shipped.rest_normals, atol=0.1)
    assert np.abs(stored.rest_normals - shipped.rest_normals).mean() < 5e-3
    arrays = before.arrays()
    for name, array in stored.arrays().items():
        if name != "garment.normals":
            np.testing.assert_array_equal(array, arrays[name])
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| trousers")]
    assert len(rows) == 2 and all(re.search(r"\| [0-9.]+, [0-9]+ +\|", row) for row in rows)


@pytest.mark.parametrize("arguments", [["tshirt", "--store"], ["nosuch.safetensors"]])
def test_models_that_cannot_be_written_or_read_are_named(arguments, capsys):
    assert main(arguments) == 2
    assert arguments[0] in capsys.readouterr().err
