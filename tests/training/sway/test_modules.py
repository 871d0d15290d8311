"""The sway network in torch is that of the reference, frame by frame."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from reference.frame_input import FrameInput
from reference.sway_network import SwayNetwork
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model
from physkin_core.model.sway_network import fold_body
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.cloth_tuning import OffsetLayer
from physkin_training.sway.modules import Features, SwayModule, swaying_joints
from physkin_training.sway.shapes import principal_shapes

RIG = load_body_model().rig


def learnt(outputs: int):
    """A network with random numbers, and body codes; joints and modulation are a body's."""
    torch.manual_seed(0)
    joints = np.array([0, 1, 2, 18, 19, 20, 22, 35, 36, 37, 39], dtype=np.int32)
    network = SwayModule(len(joints), 3, outputs).eval()
    for parameter in network.gate.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    generator = np.random.default_rng(0)
    codes = BodyCodes(generator.normal(size=7).astype(np.float32), generator.normal(size=(3, 7)).astype(np.float32))
    return network, codes, joints, generator.normal(size=7).astype(np.float32)


@pytest.mark.parametrize("step", [1 / 60, 1 / 15])
def test_torch_and_the_reference_agree(step):
    network, codes, joints, modulation = learnt(24)
    frames, generator = 12, np.random.default_rng(1)
    away = np.cumsum(generator.normal(scale=0.05, size=(frames, len(RIG.rest))), axis=0)
    positions = (RIG.rest + away).astype(np.float32)
    place = np.cumsum(generator.normal(scale=0.1 * step * 15, size=(frames, 3)), axis=0).astype(np.float32)
    turn = Rotation.from_rotvec(np.cumsum(generator.normal(scale=0.15, size=(frames, 3)), axis=0)).as_matrix()
    gravity = np.cumsum(generator.normal(scale=0.1, size=(frames, 3)), axis=0) - turn[:, 2]
    with torch.no_grad():
        tensors = (torch.as_tensor(a, dtype=torch.float32)[None] for a in (positions, place, turn, gravity))
        drive, pose = Features(RIG, joints, torch.device("cpu"))(*tensors, step)
        code = codes(torch.as_tensor(modulation)[None])
        offsets = network(drive, pose, code, step)[0].unflatten(1, (-1, 3, 4))
        here = torch.cat([offsets[..., :3].flatten(2), offsets[..., 3]], dim=2).flatten(1).numpy()
    folded = fold_body(network.exported((network.out.weight, network.out.bias), joints, codes), modulation)
    sway = SwayNetwork(SimpleNamespace(dof_lower=RIG.lower, dof_upper=RIG.upper, sway_thighs=(), **folded))
    for frame in range(frames):
        row = FrameInput(gravity[frame], elapsed=-1.0)
        if frame:
            velocity = turn[frame].T @ (place[frame] - place[frame - 1]) / step
            turning = Rotation.from_matrix(turn[frame - 1].T @ turn[frame]).as_rotvec() / step
            row = row._replace(elapsed=step, moves=1.0, velocity=velocity, turning=turning)
        there = sway.offsets(positions[frame], row)
        np.testing.assert_allclose(here[frame], there, atol=2e-5 * np.abs(there).max() + 2e-5)


def test_the_last_layer_is_the_same_in_shapes_in_numbers_and_folded():
    network, _, _, _ = learnt(4)
    generator = torch.Generator().manual_seed(0)
    offsets = torch.randn(300, 4, generator=generator) @ torch.randn(4, 24, generator=generator)
    offsets[:, 12:] = 0
    cost = torch.eye(24) + 0.3
    shapes, _, _ = principal_shapes([offsets], torch.diag((torch.arange(24) < 12).float()), cost, 4, 1.0)
    walkers = SimpleNamespace(shapes=shapes, cost=cost, share=torch.tensor([1.0, 0.0]))
    last, hidden = OffsetLayer(network.out, walkers), torch.randn(5, network.out.in_features)
    with torch.no_grad():
        coefficients = network.out(hidden)
        torch.testing.assert_close(last(hidden)[:, :12], shapes.offsets(coefficients)[:, :12], atol=1e-4, rtol=1e-3)
        assert last(hidden)[:, 12:].abs().max() == 0, "held"
        torch.testing.assert_close(last.coefficients(hidden), coefficients, atol=2e-2, rtol=1e-3)
        weight, bias = last.folded()
        torch.testing.assert_close(hidden @ weight.T + bias, last(hidden), atol=1e-5, rtol=1e-4)
        walkers.share[0] = 0.5
        less = OffsetLayer(network.out, walkers)(hidden)
        torch.testing.assert_close(less, 0.5 * last(hidden), atol=1e-5, rtol=1e-4)


def names_of_joints(shipped: str, **changes) -> str:
    model = replace(load_garment_model(shipped), **changes)
    return " ".join(RIG.joint_names[k] for k in swaying_joints(model, np.ones(len(model.node_rest), dtype=bool)))


def test_a_network_looks_at_the_joints_that_move_its_cloth():
    shirt, skirt = names_of_joints("tshirt"), names_of_joints("skirt")
    assert all(name in shirt for name in ("spine02", "clavicle.L", "upperarm02.R", "upperleg01.L"))
    assert not any(name in shirt for name in ("lowerarm", "lowerleg", "head"))
    assert all(name in skirt for name in ("spine05", "upperleg01.L", "lowerleg01.R", "foot.R"))
    assert "spine02" not in skirt and "arm" not in skirt


def test_cloth_that_no_joint_moves_is_refused():
    with pytest.raises(ValueError, match="no joint moves"):
        names_of_joints("skirt", node_bone=np.zeros(128, dtype=np.int32))
