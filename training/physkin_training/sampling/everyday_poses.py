"""Everyday poses: what people do when they stand, walk, talk and dance, as a mixture of Gaussians learnt from mocap.

Made by `physkin_prepare.everyday_poses`. Dimensions: `K` components, `d` degrees of freedom, `B` samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from physkin_core.rig.rig import Rig

__all__ = ["EVERYDAY_POSES", "EverydayPoses", "save_mixture"]

EVERYDAY_POSES = Path(__file__).parents[1] / "assets" / "everyday_poses.safetensors"


class EverydayPoses:
    """Draws joint positions (B, d) [rad] within limits and gravity directions (B, 3) on a device.

    Raises ValueError for a rig that has other joints than those learnt.
    """

    def __init__(self, rig: Rig, device: torch.device, path: Path = EVERYDAY_POSES) -> None:
        from safetensors import safe_open

        with safe_open(path, framework="np") as file:
            names = tuple(file.metadata()["joint_names"].split(","))
            weights, means, factors = (file.get_tensor(key) for key in ("weights", "means", "factors"))
        if names != rig.joint_names:
            raise ValueError(f"everyday poses are of the default rig, whose joints are {', '.join(names)}")

        def tensor(values: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(np.asarray(values, dtype=np.float32), device=device)

        self.lower, self.upper = tensor(rig.lower), tensor(rig.upper)
        self._chance = tensor(np.cumsum(weights.astype(np.float64)) / weights.astype(np.float64).sum())
        self._means, self._factors = tensor(means), tensor(factors)

    def sample(self, count: int, *, generator: torch.Generator | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """Joint positions (count, d) and gravity directions (count, 3). generator: of the device; default its own."""
        device = self.lower.device
        chance = torch.rand(count, device=device, generator=generator)
        component = torch.searchsorted(self._chance, chance).clamp_max(len(self._chance) - 1)
        normal = torch.randn(count, self._means.shape[1], device=device, generator=generator)
        drawn = self._means[component] + (self._factors[component] @ normal[..., None])[..., 0]
        positions = torch.clamp(drawn[:, :-3], self.lower, self.upper)
        return positions, torch.nn.functional.normalize(drawn[:, -3:], dim=1)


def save_mixture(
    path: Path, joint_names: Sequence[str], weights: np.ndarray, means: np.ndarray, covariances: np.ndarray
) -> None:
    """Write weights (K,), means (K, d + 3) and Cholesky factors of covariances (K, d + 3, d + 3) in half precision."""
    from safetensors.numpy import save_file

    arrays = {"weights": weights, "means": means, "factors": np.linalg.cholesky(covariances)}
    path.parent.mkdir(parents=True, exist_ok=True)
    halves = {name: np.ascontiguousarray(array.astype(np.float16)) for name, array in arrays.items()}
    save_file(halves, str(path), metadata={"joint_names": ",".join(joint_names)})
