"""Linear blend skinning, vertex by vertex with 4x4 matrices and their inverses."""

from __future__ import annotations

import dataclasses

import numpy as np
from random_models import unit_rows

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar
from physkin_core.model.skinning import plain_skinning, skin, skinning_matrices


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


def test_matrices_keep_leading_axes():
    rng = np.random.default_rng(1)
    nodes, rest = rng.normal(size=(2, 4, 6, 3, 4)), rng.normal(size=(6, 3))
    matrices = skinning_matrices(nodes, rest)
    for index in np.ndindex(2, 4, 6):
        expected = at(nodes[index][:, :3], nodes[index][:, 3]) @ np.linalg.inv(at(np.eye(3), rest[index[2]]))
        np.testing.assert_allclose(matrices[index], expected[:3], atol=1e-12)


def test_normals_stay_upright_on_sheared_cloth():
    """One affine transform of all garment nodes: perpendicular to what it makes of the surface, mirrored or not."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        s, linear = scene(rng), rng.normal(size=(3, 3))
        nodes = np.array([np.c_[linear, linear @ rest] for rest in s["node_rest"]])
        for u, v, normal, turned in zip(*tangents(s["normals"]), s["normals"], skin(nodes, **s)[1]):
            np.testing.assert_allclose(np.cross(u, v), normal, atol=1e-12)
            upright = np.cross(linear @ u, linear @ v)
            np.testing.assert_allclose(turned, upright / np.linalg.norm(upright), atol=1e-9)


def tangents(normals):
    """Unit u, v with u x v = normal."""
    u = np.cross(normals, np.roll(normals, 1, axis=1))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normals, u)


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
