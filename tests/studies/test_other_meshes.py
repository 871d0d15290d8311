"""A model carried to other meshes of its garment: the same nodes and networks, drapes that lie on one another."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("gpytoolbox", reason="needs the [data] extra")

from scipy.spatial import cKDTree
from training.small_runs import write_belly_band

from physkin_core import Draper, avatar_from_body, load_body_model
from physkin_studies.other_meshes import carried_to, cropped, remeshed
from physkin_training.evaluate.plain_model import plain_model


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "band.obj"
    write_belly_band(path)
    return plain_model(path, nodes=24, influences=6)


def drape(model):
    body = load_body_model()
    draper = Draper(model, avatar_from_body(body, body.held_out_bodies[1]), backend="numpy")
    positions = (model.rig.rest + 0.3 * (model.rig.upper - model.rig.rest)).astype(np.float32)
    return draper.drape(positions, np.array([0, 0, -1], dtype=np.float32))[:, :3]


@pytest.mark.parametrize("edge_length", [0.03, 0.012])
def test_remeshed_garments_drape_onto_the_trained_one(trained, edge_length):
    """Other edge lengths as asked; every vertex within 2 cm of the trained garment's drape."""
    garment = remeshed(trained.garment, edge_length)
    assert garment.edge_lengths.mean() == pytest.approx(edge_length, rel=0.25)
    model = carried_to(trained, garment)
    assert len(model.influence_nodes) == len(garment.vertices) != len(trained.garment.vertices)
    assert model.node_deformer is trained.node_deformer and model.node_rest is trained.node_rest
    corners = drape(trained)[trained.garment.faces]
    mixes = np.random.default_rng(0).dirichlet(np.ones(3), size=60)
    dense = np.einsum("fci,kc->fki", corners, np.concatenate([mixes, np.eye(3)])).reshape(-1, 3)
    distance, _ = cKDTree(dense).query(drape(model))
    assert distance.max() < 0.02


def test_a_cropped_garment_lacks_its_lower_end(trained):
    garment, whole = cropped(trained.garment, 0.4), trained.garment.vertices[:, 2]
    assert garment.vertices[:, 2].min() == pytest.approx(whole.min() + 0.4 * np.ptp(whole), abs=1e-6)
    assert garment.face_areas.sum() == pytest.approx(0.6 * trained.garment.face_areas.sum(), rel=0.05)
    assert np.isfinite(drape(carried_to(trained, garment))).all()


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_impossible_crops_are_refused(trained, share):
    with pytest.raises(ValueError, match=f"between 0 and 1, got {share}"):
        cropped(trained.garment, share)
