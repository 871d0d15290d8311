"""The incremental potential of drapes at chosen frames of a scene, as if each frame were one step from the two before.

Dimensions: `T` frames of the scene, `F` chosen ones, `n` garment vertices. Metres, root frames.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.motion.motion import Motion
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.dynamics.scenes import scene_wind
from physkin_training.energies.motion import Dynamics

__all__ = ["frame_potentials"]


def frame_potentials(
    model: GarmentModel,
    body_model: BodyModel,
    coefficients: np.ndarray,
    motion: Motion,
    drapes: np.ndarray,
    frames: np.ndarray,
    device: torch.device,
    *,
    dynamics: Dynamics | None = None,
) -> dict[str, np.ndarray]:
    """Energies (F,) [J] by term, those of motion among them, of drapes (T, n, 3) on a body at frames (F,), 2 or later.

    The garment is made to measure for the body.
    """
    body = torch.zeros(len(frames), dtype=torch.int64, device=device)
    samples = DressedSamples(model, body_model, coefficients[None], body)
    dynamics = dynamics or Dynamics()
    potential = samples.potential(1 / motion.rate_hz, dynamics)
    turn = Rotation.from_quat(motion.root_orientation).as_matrix()
    place = motion.root_position.astype(np.float64)

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

    def in_world(which: np.ndarray) -> np.ndarray:
        return drapes[which] @ turn[which].transpose(0, 2, 1) + place[which, None]

    def in_root(world: np.ndarray) -> torch.Tensor:
        return tensor((world - place[frames, None]) @ turn[frames])

    last, before_last = in_world(frames - 1), in_world(frames - 2)
    samples.pose(tensor(motion.positions_for(model.rig)[frames]))
    potential.begin(in_root(last), in_root(2 * last - before_last))
    with torch.no_grad():
        gravity = tensor(dynamics.effective_gravity(turn, scene_wind(motion))[frames])
        energies, _ = potential.evaluate(tensor(drapes[frames]), gravity, *samples.contact)
    return {name: values.cpu().numpy() for name, values in energies.items()}
