"""Rest normals fitted to drapes: closer to the cloth, and exactly right where skinning is linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from physkin_core import Draper, avatar_from_body, load_body_model
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.rig.rig import Rig
from physkin_training.config import NetworkConfig
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import drape_from_model
from physkin_training.networks.garment_nodes import GarmentNodeSet
from physkin_training.networks.rest_normals import fitted_rest_normals


@pytest.fixture(scope="module")
def tshirt(shipped):
    """Without detail, which bends cloth more finely than normals at rest know."""
    return replace(shipped("tshirt"), detail=None)


def test_fitted_normals_are_nearer_to_the_draped_mesh_s(tshirt):
    """In poses they were not fitted to, on a body that was not either, of vertices draped as points, whose normals are
    carried along: the median angle to the normals of the draped mesh is a tenth smaller than of the mesh's own normals.
    In uniform poses they gain a fifth (docs/notebook)."""
    garment, rig = tshirt.garment, tshirt.rig
    fitted = fitted_rest_normals(drape_from_model(tshirt), garment, rig, bodies=4, poses=16)
    own = vertex_normals(garment.vertices, garment.faces)
    body_model = load_body_model()
    avatar = avatar_from_body(body_model, body_model.held_out_bodies[0])
    median = {}
    for name, normals in (("fitted", fitted), ("own", own)):
        model = replace(tshirt, rest_normals=normals)  # vertices as points, which carry their rest normals along
        draper = Draper(model, avatar, fit=0.0, precision="fp32", points=garment.vertices)
        angles, generator = [], np.random.default_rng(1)
        for positions in generator.uniform(rig.lower, rig.upper, (4, len(rig.rest))):
            cloud = draper.drape(positions.astype(np.float32), np.array([0.0, 0.0, -1.0], dtype=np.float32))
            cosine = (cloud[:, 3:] * vertex_normals(cloud[:, :3], garment.faces)).sum(axis=1)
            angles.append(np.degrees(np.arccos(cosine.clip(-1, 1))))
        median[name] = np.median(angles)
    assert median["fitted"] < 0.9 * median["own"]


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


def test_another_rig_is_refused(tshirt):
    rig = Rig.from_json(tshirt.rig.to_json() | {"dofs": tshirt.rig.to_json()["dofs"][1:]})
    with pytest.raises(ValueError, match="rig"):
        fitted_rest_normals(drape_from_model(tshirt), tshirt.garment, rig)
