"""Linear blend skinning, vertex by vertex with 4x4 matrices and their inverses."""

from __future__ import annotations

import dataclasses

import numpy as np
from random_models import unit_rows

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar
from physkin_core.model.skinning import skin
from physkin_core.runtime.bound_garment import plain_skinning


def scene(rng, *, n=20, m=6, influences=3):
    weights = rng.uniform(size=(n, influences))
    return dict(
        node_rest=rng.normal(size=(m, 3)),
        vertices=rng.normal(size=(n, 3)),
        normals=unit_rows(rng, n),
        influence_nodes=rng.integers(0, m, size=(n, influences)),
        influence_weights=weights / weights.sum(axis=1, keepdims=True),
    )


def at(linear, translation):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, translation
    return matrix


def test_positions_and_normals_vertex_by_vertex():
    """x' = sum w chi inverse(chi-bar) x with affine nodes; a garment node may occur twice at a vertex."""
    rng = np.random.default_rng(0)
    s, nodes = scene(rng), rng.normal(size=(6, 3, 4))
    positions, normals = skin(nodes, **s)
    for v in range(20):
        total = np.zeros((4, 4))
        for node, weight in zip(s["influence_nodes"][v], s["influence_weights"][v]):
            chi = at(nodes[node][:, :3], nodes[node][:, 3])
            total += weight * chi @ np.linalg.inv(at(np.eye(3), s["node_rest"][node]))
        np.testing.assert_allclose(positions[v], (total @ [*s["vertices"][v], 1])[:3], atol=1e-12)
        turned = np.linalg.det(total) * np.linalg.inv(total[:3, :3]).T @ s["normals"][v]
        np.testing.assert_allclose(normals[v], turned / np.linalg.norm(turned), atol=1e-12)


def test_normals_that_cancel_out_stay_finite():
    s = scene(np.random.default_rng(4), m=2, influences=2)
    s["influence_nodes"][:], s["influence_weights"][:] = [0, 1], 0.5
    nodes = np.stack([np.c_[np.eye(3), np.zeros(3)], np.c_[-np.eye(3), np.zeros(3)]])
    assert np.isfinite(skin(nodes, **s)[1]).all()


def test_plain_skinning_is_a_model_that_corrects_nothing(garment_model):
    """The evaluator agrees when the node deformer's last layer is zero."""
    *layers, (weight, bias) = garment_model.node_deformer
    plain = dataclasses.replace(garment_model, node_deformer=(*layers, (0 * weight, 0 * bias)))
    draper = Draper(plain, load_avatar(BUNDLED_AVATAR, plain.rig))
    rig = plain.rig
    positions = np.random.default_rng(2).uniform(rig.lower, rig.upper).astype(np.float32)
    skinned = plain_skinning(draper.bound, draper.bone_transforms(positions))
    np.testing.assert_allclose(draper.drape(positions)[:, :3], skinned, atol=1e-5)
