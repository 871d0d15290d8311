"""Export: the garment model says what the trained drape says, pruned to the influences asked for, and back again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from random_models import random_model
from training.small_runs import SMALL_DETAIL, exported, networks_alone, run, small_config

from physkin_core import Draper, avatar_from_body, load_body_model, load_garment_model, save_garment_model
from physkin_core.model.garment_model import ENGINE_WEIGHT_STEP
from physkin_core.runtime.body_encoder import encode_body
from physkin_core.runtime.low_rank import low_rank_layers
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.networks import export
from physkin_training.networks.export import (
    ExportError,
    agreement,
    drape_from_model,
    encode_bodies,
    model_from_drape,
    network_config,
    store_checked,
)
from physkin_training.train.trainer import Trainer

BODY = load_body_model()


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A small run a few steps in, not yet pruned, with networks and detail large enough to matter."""
    config = small_config(tmp_path_factory.mktemp("run"), prune_at=1.0, full_encoding=1.0)
    trainer = Trainer(replace(config, detail=SMALL_DETAIL), torch.device("cpu"))
    run(trainer, 3)
    with torch.no_grad():
        for network in (trainer.drape.networks.pose_modulator, trainer.drape.networks.node_deformer):
            network.layers[-1].weight += 0.05 * torch.randn_like(network.layers[-1].weight)
        trainer.drape.skinning_logits += torch.randn_like(trainer.drape.skinning_logits)
        trainer.drape.detail_logits += torch.randn_like(trainer.drape.detail_logits)
        trainer.drape.networks.detail.offsets.weight += 0.02 * torch.randn(120, 8)
    return trainer


def poses(count=4):
    rng = np.random.default_rng(3)
    gravity = rng.normal(size=(count, 3))
    q = rng.uniform(BODY.rig.lower, BODY.rig.upper, size=(count, len(BODY.rig.dofs)))
    return q.astype(np.float32), (gravity / np.linalg.norm(gravity, axis=1, keepdims=True)).astype(np.float32)


def torch_drape(drape, avatar, q, gravity):
    """The drape in torch on one body: (B, n, 3)."""
    heads, tails = (torch.as_tensor(a)[None] for a in (avatar.bone_heads, avatar.bone_tails))
    bodies = type("Bodies", (), {"heads": heads, "tails": tails})
    transforms = np.stack([BODY.rig.bone_transforms(pose, heads=avatar.bone_heads) for pose in q])
    with torch.no_grad():
        positions = drape.node_positions(bodies).expand(len(q), -1, -1)
        nodes = drape.posed_nodes(torch.as_tensor(transforms, dtype=torch.float32), positions)
        body = encode_bodies(drape, avatar.vertices[None], avatar.faces).expand(len(q), -1)
        return drape(body, torch.as_tensor(q), torch.as_tensor(gravity), nodes).numpy()


def test_the_exported_model_drapes_as_the_trained_one(trained, tmp_path):
    """The run time on the model, its file read again, and torch: within 0.1 mm in memory, 1 mm through the file;
    the correctives that this compares are centimetres."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[1])
    q, gravity = poses()
    expected = torch_drape(trained.drape, avatar, q, gravity)
    model = exported(trained, 6)
    save_garment_model(model, tmp_path / "band.safetensors")
    for form, tolerance in ((model, 1e-4), (load_garment_model(tmp_path / "band.safetensors"), 1e-3)):
        draper = networks_alone(form, avatar, fit=0.0)
        for index in range(len(q)):
            drape = draper.drape(q[index], gravity[index])[:, :3]
            assert np.linalg.norm(drape - expected[index], axis=1).max() < tolerance
    (weight, bias) = model.node_deformer[-1]
    plain = replace(model, node_deformer=(*model.node_deformer[:-1], (0 * weight, 0 * bias)))
    skinned = networks_alone(plain, avatar, fit=0.0).drape(q[0], gravity[0])[:, :3]
    assert np.linalg.norm(skinned - expected[0], axis=1).max() > 0.02


def test_a_model_made_to_measure_agrees_both_ways(tmp_path):
    """Its file read again, at the run time and in torch; a fit that only torch has learnt otherwise is seen."""
    trainer = Trainer(small_config(tmp_path, full_encoding=1.0), torch.device("cpu"))
    with torch.no_grad():
        trainer.drape.networks.hyper_modulator.fit.normal_()
        for network in (trainer.drape.networks.pose_modulator, trainer.drape.networks.node_deformer):
            network.layers[-1].weight += 0.05 * torch.randn_like(network.layers[-1].weight)
        trainer.drape.networks.hyper_modulator.output.weight += torch.randn(1)
    model = exported(trainer, 6)
    save_garment_model(model, tmp_path / "band.safetensors")
    model = load_garment_model(tmp_path / "band.safetensors")
    twin = drape_from_model(model)
    assert agreement(model, twin, poses=4).largest < 1e-4
    with torch.no_grad():
        twin.networks.hyper_modulator.fit += 1
    assert agreement(model, twin, poses=1).largest < 1e-4, "one pose is at the template"
    assert agreement(model, twin, poses=4).largest > 1e-4


def test_a_wide_pose_modulator_agrees():
    """One that the run time narrows for a body, by far more than the two may differ."""
    rng = np.random.default_rng(2)
    model = random_model(rng, rig=BODY.rig, rings=20, nodes=20, pose_widths=(400, 400), deformer_widths=(64, 64))
    assert agreement(model, drape_from_model(model), poses=2).largest < 1e-4
    narrow = low_rank_layers([model.pose_modulator], model.rig)
    assert len(narrow) > len(model.pose_modulator)


def test_agreement_sees_a_difference(trained):
    """One garment node's translation wrong by a centimetre in torch."""
    model = exported(trained, 3)
    spoilt = drape_from_model(model)
    with torch.no_grad():
        spoilt.networks.node_deformer.layers[-1].bias[9] += 0.01
    difference = agreement(model, spoilt, poses=2)
    shares = np.where(model.influence_nodes == 0, model.influence_weights, 0).sum(axis=1)
    assert difference.largest == pytest.approx(0.01 * shares.max(), rel=0.05)
    assert difference.mean == pytest.approx(0.01 * shares.mean(), rel=0.05)


def test_agreement_tells_what_pruning_costs(trained):
    """Nothing with all influences, millimetres and more with a few of them; the twin check sees none of it."""
    costs = [agreement(exported(trained, influences), trained.drape, poses=2) for influences in (6, 3, 1)]
    assert costs[0].largest < 1e-4
    assert 1e-3 < costs[1].largest < costs[2].largest and costs[1].mean < costs[2].mean
    model = exported(trained, 1)
    assert agreement(model, drape_from_model(model), poses=2).largest < 1e-4


@pytest.mark.parametrize(
    "tolerances, other",
    [((1e-9, 1), "the trained drape"), ((1, 1e-9), "the same model in torch")],
)
def test_a_file_that_drapes_otherwise_is_refused(trained, tmp_path, monkeypatch, tolerances, other):
    """Where it does not, the model comes back as it is stored; else the file stays apart."""
    path = tmp_path / "band.safetensors"
    stored = store_checked(exported(trained, 6), trained.drape, path)
    np.testing.assert_array_equal(stored.node_rest, load_garment_model(path).node_rest)
    path.unlink()
    for name, tolerance in zip(("EXPORT_TOLERANCE", "TWIN_TOLERANCE"), tolerances):
        monkeypatch.setattr(export, name, tolerance)
    with pytest.raises(ExportError, match=f"{other}.*1e-06 mm"):
        store_checked(exported(trained, 6), trained.drape, path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["band.unchecked"]


@pytest.mark.parametrize("influences", [1, 3])
def test_pruning_keeps_the_strongest_and_renormalises(trained, influences):
    """By the index of their node."""
    model = exported(trained, influences)
    weights = trained.drape.skinning_weights.detach().numpy()
    nodes = trained.drape.influence_nodes.numpy()
    assert model.influence_nodes.shape == model.influence_weights.shape == (286, influences)
    np.testing.assert_allclose(model.influence_weights.sum(axis=1), 1, atol=1e-6)
    for vertex in range(286):
        kept = sorted(range(6), key=lambda k: -weights[vertex, k])[:influences]
        kept.sort(key=lambda k: nodes[vertex, k])
        assert model.influence_nodes[vertex].tolist() == nodes[vertex, kept].tolist()
        expected = weights[vertex, kept] / weights[vertex, kept].sum()
        np.testing.assert_allclose(model.influence_weights[vertex], expected, atol=1e-6)


@pytest.mark.parametrize("pose_rank, deformer_widths", [(0, (12, 12)), (5, (12, 12, 20))])
def test_there_and_back_again(pose_rank, deformer_widths):
    """A garment model through torch is the same garment model, array by array, but for rest normals, which are those of
    the mesh, and engines' skinning weights, which are its others."""
    widths = {"pose_widths": (16,) * 3, "pose_rank": pose_rank, "deformer_widths": deformer_widths}
    model = random_model(np.random.default_rng(1), **widths)
    assert network_config(model).drapes == (20 if pose_rank else 0)
    sizes = {"influences": 4, "engine_influences": 4, "material": model.material}
    back = model_from_drape(drape_from_model(model), model.garment, model.rig, name=model.name, **sizes)
    dense, dense_back = (np.zeros((len(m.garment.vertices), 10)) for m in (model, back))
    for m, target in ((model, dense), (back, dense_back)):
        np.put_along_axis(target, m.influence_nodes.astype(int), m.influence_weights, axis=1)
    np.testing.assert_allclose(dense_back, dense, atol=1e-6)
    expected = model.arrays()
    for name, array in back.arrays().items():
        if "skinning" not in name:
            np.testing.assert_array_equal(array, expected[name], err_msg=name)


def test_influences_that_were_pruned_stay_out_of_a_drape_trained_on():
    model = random_model(np.random.default_rng(2))
    weights = model.influence_weights.copy()
    weights[:, 2:] = 0
    model = replace(model, influence_weights=weights / weights.sum(axis=1, keepdims=True))
    drape = drape_from_model(model)
    with torch.no_grad():
        drape.skinning_logits += 30
    assert (drape.skinning_weights[:, 2:] == 0).all()


def test_bodies_are_encoded_as_at_run_time(trained):
    model = exported(trained, 3)
    avatars = [avatar_from_body(BODY, coefficients) for coefficients in BODY.held_out_bodies[:2]]
    encoded = encode_bodies(trained.drape, np.stack([avatar.vertices for avatar in avatars]), BODY.faces).numpy()
    for index, avatar in enumerate(avatars):
        np.testing.assert_allclose(encoded[index], encode_body(model, avatar, fit=0.0), atol=2e-4)
    assert np.abs(encoded[0] - encoded[1]).max() > 5e-4


def test_the_untrained_model_is_plain_skinning(trained, tmp_path):
    """Its nodes ride on their bones, whatever pose and gravity."""
    model = plain_model(trained.garment, nodes=12, influences=4)
    assert model.influence_nodes.shape == (286, 4)
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[0])
    draper = Draper(model, avatar, precision="fp32")
    q, gravity = poses(1)
    first = draper.drape(q[0], gravity[0])
    np.testing.assert_array_equal(draper.drape(q[0], -gravity[0]), first)
    bones = draper.bone_transforms(q[0])[model.node_bone]
    np.testing.assert_allclose(draper.node_transforms()[..., :3], bones[..., :3], atol=1e-6)


def test_the_skinning_weights_for_engines_go_along(tmp_path):
    """Two influences a vertex, read again; the model for engines drapes as the trained drape does by them."""
    trainer = Trainer(small_config(tmp_path), torch.device("cpu"))
    run(trainer, 5)
    path = tmp_path / "band.safetensors"
    save_garment_model(exported(trainer, 3), path)
    model = load_garment_model(path)
    assert model.for_engines().influence_weights.shape == (len(model.garment.vertices), 2)
    torch.manual_seed(1)  # stored weights are rounded, which moves some nodes' vertices by more than others'
    nodes = torch.eye(4)[:3] + 0.1 * torch.randn(4, len(model.node_rest), 3, 4)
    with torch.no_grad():
        expected = trainer.drape.skin(nodes, for_engines=True)
        stored = drape_from_model(model.for_engines()).skin(nodes)
        assert (trainer.drape.skin(nodes) - expected).abs().max() > 1e-3
    # Half a step of one of two weights, times how far apart two nodes carry a vertex: 0.1 m times two normal numbers.
    torch.testing.assert_close(stored, expected, atol=0.5 * ENGINE_WEIGHT_STEP * 0.1 * 6, rtol=0)
