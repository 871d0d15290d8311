"""Windows are whole motions at three frame rates; blurred they are of other bodies; gentle ones count as much as wild
ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from physkin_core.model.model_file import load_garment_model
from physkin_training.sway.modules import Features, swaying_joints
from physkin_training.sway.windows import OTHER_BODY, OTHER_JOINTS, STRIDES, Windows

MODEL = load_garment_model("skirt")
JOINTS = swaying_joints(MODEL, np.ones(len(MODEL.node_rest), dtype=bool))
WALKERS, FRAMES, SHAPES = 3, 30, 4


@pytest.fixture
def windows():
    """Of three walkers who stand, and whose cloth swings by 1, 10 and 0."""
    rest = torch.tensor(MODEL.rig.rest, dtype=torch.float32)
    kept = len(range(0, FRAMES, 4))
    to_and_fro = torch.sin(torch.arange(kept))[None, :, None].expand(WALKERS, -1, SHAPES)
    walkers = SimpleNamespace(
        positions=rest.expand(WALKERS, FRAMES, -1),
        place=torch.zeros(WALKERS, FRAMES, 3),
        turn=torch.eye(3).expand(WALKERS, FRAMES, -1, -1),
        gravity=torch.tensor([0.0, 0, -1]).expand(WALKERS, FRAMES, -1),
        codes=torch.tensor([[1.0, 2.0], [3.0, 4.0]]),
        body=torch.tensor([0, 1, 1]),
        coefficients=(torch.tensor([1.0, 10.0, 0.0])[:, None, None] * to_and_fro + 5).half(),
        valid=torch.ones(WALKERS, kept, dtype=torch.bool),
    )
    return Windows(walkers, Features(MODEL.rig, JOINTS, torch.device("cpu")))


@pytest.mark.parametrize("stride", STRIDES)
def test_every_target_is_seen_at_every_rate(windows, stride):
    window = windows.at(torch.tensor([2, 0]), stride=stride)
    frames = window.drive.shape[1]
    assert window.step == pytest.approx(stride / 60)
    assert len(range(0, frames, window.every)) == window.coefficients.shape[1] == window.share.shape[1] == 8
    assert torch.equal(window.code, torch.tensor([[3.0, 4.0], [1.0, 2.0]]))
    torch.testing.assert_close(window.swing(window.coefficients)[0], torch.ones(SHAPES))  # 1 of what does not move


def test_blurred_windows_are_of_other_bodies_in_other_poses_throughout(windows):
    torch.manual_seed(0)
    window = windows.at(torch.arange(WALKERS).repeat(500), stride=4)
    blurred = window.blurred()
    joints = len(JOINTS)
    for name in ("pose", "drive"):
        moved = getattr(blurred, name) - getattr(window, name)
        torch.testing.assert_close(moved, moved[:, :1].expand_as(moved), rtol=0, atol=1e-6)
        assert moved[..., joints:].abs().max() == 0
        assert float(moved[:, 0, :joints].std()) == pytest.approx(OTHER_JOINTS, rel=0.05)
    torch.testing.assert_close(blurred.pose[..., :joints], blurred.drive[..., :joints], rtol=0, atol=1e-6)
    assert float((blurred.code - window.code).std()) == pytest.approx(OTHER_BODY, rel=0.05)
    assert blurred.coefficients is window.coefficients


def test_sharp_windows_stay_as_they_are(windows):
    window = windows.at(torch.arange(WALKERS), stride=4)
    sharp = torch.tensor([True, False, True])
    blurred = window.blurred(sharp=sharp)
    for name in ("drive", "pose", "code"):
        same = (getattr(blurred, name) == getattr(window, name)).flatten(1).all(dim=1)
        assert torch.equal(same, sharp), name


def test_errors_count_more_where_cloth_moves_less(windows):
    gentle, wild, still = windows.at(torch.arange(WALKERS), stride=4).evenly().tolist()
    assert still > gentle > 3 * wild and gentle + wild + still == pytest.approx(WALKERS)


def test_what_does_not_count_is_left_out(windows):
    window = windows.at(torch.tensor([0, 1]), stride=1)
    errors = torch.arange(16.0).view(2, 8)
    share = torch.zeros(2, 8)
    share[0, 3] = share[1, 4] = 1
    window = replace(window, share=share)
    assert float(window.mean(errors)) == (3 + 12) / 2
    torch.testing.assert_close(window.swing(window.coefficients), torch.ones(2, SHAPES))
    assert float(replace(window, share=torch.zeros(2, 8)).mean(errors)) == 0
