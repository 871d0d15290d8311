"""The trainable drape: values of the run time's draper, gradients by finite differences, pruning of influences."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_avatar, random_model, random_pose, random_rotation

torch = pytest.importorskip("torch", reason="needs the [training] extra")

from physkin_core import Draper, load_body_model  # noqa: E402
from physkin_core.model import garment_nodes, skinning  # noqa: E402
from physkin_core.runtime.binding import encode_body  # noqa: E402
from physkin_training.config import NetworkConfig  # noqa: E402
from physkin_training.networks.draping import Drape, compose_nodes, delta_transforms  # noqa: E402
from physkin_training.networks.export import drape_from_model  # noqa: E402
from physkin_training.networks.garment_nodes import GarmentNodeSet  # noqa: E402
from physkin_training.sampling.posed_bodies import BodySet  # noqa: E402


def tensor(array):
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float64)


def posed_scene(seed, **sizes):
    """A random model, its float64 drape, and posed garment nodes (4, m, 3, 4) of random transforms."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, **sizes)
    bones = [[np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(model.rig.bone_count)] for _ in range(4)]
    return rng, model, drape_from_model(model).double(), np.array(bones)


@pytest.mark.parametrize("node_outputs", [9, 12])
def test_pieces_agree_with_the_run_time(node_outputs):
    """Posed nodes, correctives, composition, skinning and pose vector, each against its NumPy twin."""
    rng, model, drape, bones = posed_scene(0)
    m = len(model.node_rest)
    positions = rng.normal(size=(4, m, 3))
    posed = drape.posed_nodes(tensor(bones), tensor(positions)).numpy()
    for sample in range(4):
        expected = garment_nodes.pose_nodes(bones[sample], model.node_bone, positions[sample])
        np.testing.assert_allclose(posed[sample], expected, atol=1e-12)
    raw = rng.normal(size=(4, m, node_outputs))
    delta = delta_transforms(tensor(raw)).numpy()
    np.testing.assert_allclose(delta, garment_nodes.delta_transforms(raw.reshape(4, -1), m), atol=1e-10)
    nodes = compose_nodes(tensor(posed), tensor(delta)).numpy()
    np.testing.assert_allclose(nodes, garment_nodes.compose_nodes(posed, delta), atol=1e-12)
    with torch.no_grad():
        vertices = drape.skin(tensor(nodes)).numpy()
    garment = model.garment
    for sample in range(4):
        expected, _ = skinning.skin(
            nodes[sample],
            model.node_rest,
            garment.vertices.astype(np.float32),
            garment.vertices,
            model.influence_nodes,
            model.influence_weights,
        )
        np.testing.assert_allclose(vertices[sample], expected, atol=1e-6)
    q, gravity = rng.uniform(-4, 4, size=(4, len(model.rig.dofs))), rng.normal(size=(4, 3))
    theta = drape.pose_vector(tensor(q), tensor(gravity)).numpy()
    np.testing.assert_allclose(theta, model.rig.pose_vector(q, gravity), atol=1e-6)


@pytest.mark.parametrize("activation, node_outputs", [("silu", 9), ("relu", 9), ("silu", 12), ("relu", 12)])
def test_the_whole_drape_agrees_with_the_run_time(activation, node_outputs):
    """Pose and body in, vertices out, on a random rig and another body."""
    rng = np.random.default_rng(1)
    model = random_model(rng, bones=12, dofs=20, activation=activation, node_outputs=node_outputs)
    drape, avatar = drape_from_model(model).double(), random_avatar(rng, model.rig)
    draper = Draper(model, avatar, backend="numpy")
    modulation = tensor(encode_body(model, avatar))[None]
    for _ in range(3):
        q, gravity = random_pose(rng, model.rig)
        posed = drape.posed_nodes(tensor(draper.bone_transforms(q))[None], tensor(draper.bound.node_positions)[None])
        with torch.no_grad():
            vertices = drape(modulation, tensor(q)[None], tensor(gravity)[None], posed)[0].numpy()
        np.testing.assert_allclose(vertices, draper.drape(q, gravity)[:, :3], atol=1e-5)


def test_node_positions_on_other_bodies_agree():
    """All bodies at once, against the run time one by one."""
    rng, body = np.random.default_rng(2), load_body_model()
    model = random_model(rng, rig=body.rig)
    chosen = body.held_out_bodies[:3]
    positions = drape_from_model(model).node_positions(BodySet(body, chosen, torch.device("cpu"))).numpy()
    for index, coefficients in enumerate(chosen):
        expected = garment_nodes.node_positions_on_body(
            model.node_rest, model.node_bone, (body.rig.heads, body.rig.tails), body.bones(coefficients)
        )
        np.testing.assert_allclose(positions[index], expected, atol=1e-5)
    assert np.abs(positions[0] - positions[1]).max() > 1e-2


@pytest.mark.parametrize("node_outputs", [9, 12])
def test_gradients_of_node_numbers_and_skinning_logits(node_outputs):
    """d vertices / d (numbers, logits) entry by entry against central differences, pruned logits included."""
    rng, _, drape, bones = posed_scene(3, nodes=5, influences=3, rings=3, segments=4)
    drape.influence_bias[0, 1] = -float("inf")
    posed = drape.posed_nodes(tensor(bones[:2]), tensor(rng.normal(size=(2, 5, 3))))
    raw = tensor(0.3 * rng.normal(size=(2, 5, node_outputs))).requires_grad_()
    logits = drape.skinning_logits.detach().clone().requires_grad_()

    del drape.skinning_logits  # a parameter; below, a plain tensor in its place

    def vertices(raw, logits):
        drape.skinning_logits = logits
        return drape.skin(compose_nodes(posed, delta_transforms(raw)))

    assert torch.autograd.gradcheck(vertices, (raw, logits), eps=1e-6, atol=1e-6)
    (by_logits,) = torch.autograd.grad(vertices(raw, logits).square().sum(), logits)
    assert by_logits[0, 1] == 0 and by_logits.abs().max() > 1e-3


def test_gradient_through_the_whole_drape():
    """Pose, networks and skinning together, along random directions of every parameter, in float64."""
    rng, model, drape, bones = posed_scene(4, nodes=5, rings=3, segments=4)
    posed = drape.posed_nodes(tensor(bones), tensor(rng.normal(size=(4, 5, 3))))
    body = tensor(rng.normal(size=(4, drape.networks.pose_modulator.modulation_size)))
    q = tensor(rng.uniform(model.rig.lower, model.rig.upper, size=(4, len(model.rig.dofs))))
    gravity, pull = tensor(rng.normal(size=(4, 3))), tensor(rng.normal(size=(4, len(model.garment.vertices), 3)))

    def loss():
        return (pull * drape(body, q, gravity, posed)).sum()

    loss().backward()
    step = 1e-6
    for name, parameter in drape.named_parameters():
        if "hyper_modulator" in name:
            continue
        direction = torch.randn(parameter.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
        with torch.no_grad():
            parameter += step * direction
            above = loss().item()
            parameter -= 2 * step * direction
            below = loss().item()
            parameter += step * direction
        expected = (parameter.grad * direction).sum().item()
        assert (above - below) / (2 * step) == pytest.approx(expected, rel=1e-4, abs=1e-6), name


def test_a_new_drape_has_the_initial_skinning_weights():
    model = random_model(np.random.default_rng(5))
    nodes = GarmentNodeSet(model.node_rest, model.node_bone, model.influence_nodes, model.influence_weights)
    drape = Drape(model.garment, nodes, model.rig, NetworkConfig(pose_hidden=8, deformer_hidden=8, token_width=8))
    np.testing.assert_allclose(drape.skinning_weights.detach().numpy(), model.influence_weights, atol=1e-6)


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


def test_pruning_to_more_than_there_are_changes_nothing():
    drape = drape_from_model(random_model(np.random.default_rng(7), influences=4))
    before = drape.skinning_weights.detach().clone()
    drape.prune_influences(9)
    assert torch.equal(drape.skinning_weights, before)


def test_pruning_leaves_no_more_than_asked_for_among_equals():
    """A vertex midway between garment nodes has influences of equal strength."""
    drape = drape_from_model(random_model(np.random.default_rng(8), influences=4))
    with torch.no_grad():
        drape.skinning_logits.zero_()
    drape.prune_influences(2)
    assert ((drape.skinning_weights > 0).sum(dim=1) == 2).all()
