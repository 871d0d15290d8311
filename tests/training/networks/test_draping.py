"""The trainable drape: values of the reference, gradients by finite differences, pruning of influences."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from random_models import random_avatar, random_model, random_pose, random_rotation
from reference.skinning import skin
from reference.unfolded_frame import unfolded_drape, unfolded_offsets

from physkin_core.model.mlp import modulation_size
from physkin_training.networks.draping import compose_nodes, delta_transforms
from physkin_training.networks.export import drape_from_model


def tensor(array):
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float64)


def posed_scene(seed, **sizes):
    """A random model, its float64 drape, and posed garment nodes (4, m, 3, 4) of random transforms."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, **sizes)
    bones = [[np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(model.rig.bone_count)] for _ in range(4)]
    return rng, model, drape_from_model(model).double(), np.array(bones)


@pytest.mark.parametrize("detail_nodes, pose_rank", [(0, 0), (15, 0), (0, 5)])
def test_the_whole_drape_agrees_with_the_reference(detail_nodes, pose_rank):
    """Pose and body in, vertices out, on a random rig and another body; with detail and without, and with a pose
    modulator of low rank."""
    rng = np.random.default_rng(1)
    model = random_model(rng, bones=12, dofs=20, detail_nodes=detail_nodes, pose_rank=pose_rank)
    drape, avatar = drape_from_model(model).double(), random_avatar(rng, model.rig)
    heads, tails = (tensor(each)[None] for each in (avatar.bone_heads, avatar.bone_tails))
    on_body = drape.node_positions(SimpleNamespace(heads=heads, tails=tails))
    modulation = rng.normal(size=modulation_size(model.pose_modulator), scale=0.3)
    worn = SimpleNamespace(**vars(model), vertices=model.garment.vertices, normals=0 * model.garment.vertices)
    if model.detail is not None:
        worn.detail_offsets, worn.detail_nodes = model.detail.offsets, model.detail.nodes
        worn.detail_weights = model.detail.weights
    for _ in range(3):
        q, gravity = random_pose(rng, model.rig)
        posed = drape.posed_nodes(tensor(model.rig.bone_transforms(q, heads=avatar.bone_heads))[None], on_body)
        with torch.no_grad():
            vertices = drape(tensor(modulation)[None], tensor(q)[None], tensor(gravity)[None], posed)[0].numpy()
        offsets = unfolded_offsets(model, avatar, modulation, q, gravity)
        expected, _ = skin(worn, unfolded_drape(model, avatar, modulation, q, gravity), offsets)
        np.testing.assert_allclose(vertices, expected, atol=1e-6)


def test_gradients_of_node_numbers_and_skinning_logits():
    """d vertices / d (numbers, logits) entry by entry against central differences, pruned logits included."""
    rng, _, drape, bones = posed_scene(3, nodes=5, influences=3, rings=3, segments=4)
    drape.influence_bias[0, 1] = -float("inf")
    posed = drape.posed_nodes(tensor(bones[:2]), tensor(rng.normal(size=(2, 5, 3))))
    raw = tensor(0.3 * rng.normal(size=(2, 5, 12))).requires_grad_()
    logits = drape.skinning_logits.detach().clone().requires_grad_()

    del drape.skinning_logits  # a parameter; below, a plain tensor in its place

    def vertices(raw, logits):
        drape.skinning_logits = logits
        return drape.skin(compose_nodes(posed, delta_transforms(raw)))

    assert torch.autograd.gradcheck(vertices, (raw, logits), eps=1e-6, atol=1e-6)
    (by_logits,) = torch.autograd.grad(vertices(raw, logits).square().sum(), logits)
    assert by_logits[0, 1] == 0 and by_logits.abs().max() > 1e-3


def test_pruning_keeps_the_strongest_influences_for_good():
    """Exactly `keep` remain, in the old proportions; the others stay zero whatever their logits do."""
    drape = drape_from_model(random_model(np.random.default_rng(6), influences=6))
    before = drape.skinning_weights.detach().numpy()
    drape.prune_influences(3)
    after = drape.skinning_weights.detach().numpy()
    for old, new in zip(before, after):
        kept = np.argsort(-old)[:3]
        expected = np.zeros(6)
        expected[kept] = old[kept] / old[kept].sum()
        np.testing.assert_allclose(new, expected, atol=1e-6)
    drape.prune_influences(3)
    np.testing.assert_array_equal(drape.skinning_weights.detach().numpy(), after)
    with torch.no_grad():
        drape.skinning_logits += 5 * torch.randn_like(drape.skinning_logits)
    np.testing.assert_array_equal(drape.skinning_weights.detach().numpy() > 0, after > 0)
    drape.skin(torch.eye(4)[:3].expand(1, 10, 3, 4)).sum().backward()
    assert torch.isfinite(drape.skinning_logits.grad).all()


def test_pruning_leaves_no_more_than_asked_for_among_equals():
    """A vertex midway between garment nodes has influences of equal strength."""
    drape = drape_from_model(random_model(np.random.default_rng(8), influences=4))
    with torch.no_grad():
        drape.skinning_logits.zero_()
    drape.prune_influences(2)
    assert ((drape.skinning_weights > 0).sum(dim=1) == 2).all()
