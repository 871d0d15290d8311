"""Everyday poses: within limits, like what they were learnt from, the same for a seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'physkin[training]'")

from physkin_core import load_body_model, load_motion  # noqa: E402
from physkin_training.sampling.everyday_poses import EverydayPoses, save_mixture  # noqa: E402
from physkin_training.sampling.mirrored_poses import mirrored  # noqa: E402
from physkin_training.sampling.pose_sampling import PoseSampler  # noqa: E402

CPU = torch.device("cpu")
RIG = load_body_model().rig


def test_samples_are_everyday():
    """Within limits, gravity of length 1 and mostly downwards, elbows near the trunk as a standing person's."""
    positions, gravity = EverydayPoses(RIG, CPU).sample(2000, generator=torch.Generator().manual_seed(0))
    assert (positions.numpy() >= RIG.lower - 1e-6).all() and (positions.numpy() <= RIG.upper + 1e-6).all()
    torch.testing.assert_close(torch.linalg.norm(gravity, dim=1), torch.ones(2000))
    assert (gravity[:, 2] < -0.7).float().mean() > 0.9
    again, _ = EverydayPoses(RIG, CPU).sample(2000, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(again, positions)
    # a frame of walking lies closer to one of them than to a pose drawn uniformly
    uniform, _ = PoseSampler(RIG, CPU, upright=1.0).sample(2000, 1.0)
    walk = torch.as_tensor(load_motion("walk").positions_for(RIG)[::8])
    assert torch.cdist(walk, positions).min(dim=1)[0].max() < torch.cdist(walk, uniform).min(dim=1)[0].min()


def test_the_mixture_is_what_was_saved(tmp_path):
    """Means, covariances and weights of two components, to half precision."""
    size = len(RIG.joint_names) + 3
    means = np.stack([np.append(RIG.rest + shift, [0.0, 0.0, -1.0]) for shift in (0.01, -0.01)])
    spread = np.diag(np.full(size, 1e-6))
    save_mixture(tmp_path / "two.safetensors", RIG.joint_names, np.array([0.75, 0.25]), means, np.stack([spread] * 2))
    positions, _ = EverydayPoses(RIG, CPU, tmp_path / "two.safetensors").sample(4000)
    first = (positions.numpy() - RIG.rest).mean(axis=1) > 0
    assert abs(first.mean() - 0.75) < 0.03
    free = (RIG.lower < RIG.rest - 0.05) & (RIG.upper > RIG.rest + 0.05)
    np.testing.assert_allclose(positions[first].numpy().mean(axis=0)[free], (RIG.rest + 0.01)[free], atol=2e-3)


def test_another_rig_is_refused():
    dofs = tuple(replace(dof, name=f"my_{dof.name}") for dof in RIG.dofs)
    with pytest.raises(ValueError, match="everyday poses are of the default rig"):
        EverydayPoses(replace(RIG, dofs=dofs), CPU)


def test_mirrored_bones_are_where_the_others_were():
    pose = load_motion("kick").positions_for(RIG)[30:31].astype(np.float64)
    there, here = RIG.bone_transforms(mirrored(RIG, pose)[0]), RIG.bone_transforms(pose[0])

    def heads(transforms):
        return np.einsum("bij,bj->bi", transforms[..., :3], RIG.heads) + transforms[..., 3]

    for index, name in enumerate(RIG.bone_names):
        other = name.replace(".L", ".\0").replace(".R", ".L").replace(".\0", ".R")
        np.testing.assert_allclose(heads(there)[RIG.bone_index(other)], heads(here)[index] * [1, -1, 1], atol=0.01)


def test_shares_of_everyday_and_accelerated_samples():
    """What is not accelerated has gravity of length 1; what is, up to three times that. At a share of 0 all rest."""
    sampler = PoseSampler(RIG, CPU, upright=1.0, everyday=0.5, accelerated=0.3)
    generator = torch.Generator().manual_seed(0)
    positions, gravity = sampler.sample(4000, 1.0, generator=generator)
    length = torch.linalg.norm(gravity, dim=1)
    assert abs(((length - 1).abs() > 1e-3).float().mean() - 0.3) < 0.03 and length.max() <= 3.0 + 1e-5
    positions, gravity = sampler.sample(100, 0.0, generator=generator)
    torch.testing.assert_close(positions, sampler.rest.expand(100, -1))
    torch.testing.assert_close(gravity, torch.tensor([0.0, 0.0, -1.0]).expand(100, -1))
