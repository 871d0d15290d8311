"""The everyday poses that training draws: a mixture of Gaussians over joint positions and gravity, learnt from mocap.

`python -m physkin_prepare.everyday_poses POSES.npz` reads poses of the default rig (arrays `joint_names` (d,),
`positions` (P, d) [rad], `gravity` (P, 3), `clip` (P,), `clip_names`), leaves the held-out clips out, adds mirrored
poses and poses whose arms come from other poses, and writes `EVERYDAY_POSES`, and twenty poses drawn from there as the
`CHECK_POSES` of `physkin check`. Needs the `data` extra.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.everyday_poses import CHECK_POSES
from physkin_core.rig.rig import Rig
from physkin_training.sampling.everyday_poses import EVERYDAY_POSES, EverydayPoses, save_mixture
from physkin_training.sampling.mirrored_poses import mirrored

__all__ = ["HELD_OUT_CLIPS", "main", "save_check_poses"]

HELD_OUT_CLIPS = ("01_01", "02_02", "indian_06", "martial_03", "salsa_01")
"""What evaluation is on: whole clips, one of each kind."""
COMPONENTS = 48
SAMPLES = 40_000
MIRRORED, EXCHANGED = 0.5, 0.4
"""Shares of the poses that are mirrored, and of the arms that come from another pose."""
NOISE = 0.1
"""Standard deviation [rad] that is added to every joint."""
UNSEEN_SHARE = 0.3
"""Of half a joint's range: standard deviation of joints that mocap leaves at rest, such as clavicles and wrists."""
ARM_BONES = ("clavicle", "shoulder", "upperarm", "lowerarm", "wrist")


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("poses", type=Path)
    parser.add_argument("--output", type=Path, default=EVERYDAY_POSES)
    options = parser.parse_args(argv)
    from sklearn.mixture import GaussianMixture

    rig = load_body_model().rig
    bank = np.load(options.poses)
    order = [list(bank["joint_names"]).index(name) for name in rig.joint_names]
    kept = ~np.isin(bank["clip_names"][bank["clip"]], HELD_OUT_CLIPS)
    positions, gravity = bank["positions"][kept][:, order].astype(np.float64), bank["gravity"][kept].astype(np.float64)
    random = np.random.default_rng(0)
    poses = _varied(rig, positions, gravity, random)
    mixture = GaussianMixture(COMPONENTS, reg_covar=1e-3, random_state=0, max_iter=60, init_params="k-means++")
    mixture.fit(poses)
    still = np.ptp(positions, axis=0) < 1e-3
    spread = np.where(still, UNSEEN_SHARE * (rig.upper - rig.lower) / 2, NOISE)
    covariances = mixture.covariances_ + np.diag(np.concatenate([spread, np.full(3, 0.05)]) ** 2)
    save_mixture(options.output, rig.joint_names, mixture.weights_, mixture.means_, covariances)
    save_check_poses(CHECK_POSES, rig)
    print(f"{len(positions)} poses of {len(set(bank['clip'][kept]))} clips; wrote {options.output}")
    return 0


def save_check_poses(path: Path, rig: Rig, *, count: int = 20) -> None:
    """Write joint positions (count, d) [rad] and gravity (count, 3), drawn from the mixture, in half precision."""
    from safetensors.numpy import save_file

    generator = torch.Generator().manual_seed(0)
    drawn = EverydayPoses(rig, torch.device("cpu")).sample(count, generator=generator)
    tensors = {name: values.numpy().astype(np.float16) for name, values in zip(("positions", "gravity"), drawn)}
    save_file(tensors, str(path), metadata={"joint_names": ",".join(rig.joint_names)})


def _varied(rig: Rig, positions: np.ndarray, gravity: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Poses and gravity (SAMPLES, d + 3) drawn from (P, d) and (P, 3); some mirrored, some with other arms."""
    pick = random.integers(len(positions), size=SAMPLES)
    pose, down = positions[pick], gravity[pick]
    for side in "LR":
        arm = np.array([name.startswith(ARM_BONES) and f".{side}_" in name for name in rig.joint_names])
        other = positions[random.integers(len(positions), size=SAMPLES)]
        pose = np.where((random.random((SAMPLES, 1)) < EXCHANGED) & arm, other, pose)
    turned = random.random((SAMPLES, 1)) < MIRRORED
    pose = np.where(turned, mirrored(rig, pose), pose)
    down = np.where(turned, down * [1, -1, 1], down)
    return np.concatenate([pose, down], axis=1)


if __name__ == "__main__":
    raise SystemExit(main())
