"""The hyper modulator at run time: a body becomes the modulation of the pose modulator, once, on one core in a few
megabytes (paper: Hyper Modulator).

Dimensions: `N` points, `s` numbers of modulation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import POINT_COUNT, at_fit
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.native_module import as_float32, native
from physkin_core.runtime.garment_on_body import checked_fit

__all__ = ["encode_body", "encode_points"]


def encode_body(model: GarmentModel, avatar: Avatar, *, fit: float | None = None) -> np.ndarray:
    """Run the hyper modulator on a body: modulation (s,) float32 of the pose modulator. fit: of the garment, as in
    `bind_garment`."""
    points, normals = sample_surface(avatar.vertices, avatar.faces, POINT_COUNT)
    return encode_points(at_fit(model.hyper_modulator, checked_fit(model, fit)), points, normals)


def encode_points(
    network: Mapping[str, np.ndarray], points: np.ndarray, normals: np.ndarray, *, instruction_set: str | None = None
) -> np.ndarray:
    """Scale and shift for every hidden unit that the hyper modulator modulates.

    network: arrays by name as in the garment model file (without the `hyper_modulator.` prefix).
    points: (N, 3) [m] canonical pose, root at the origin; normals: (N, 3) unit, from `sample_surface`.
    instruction_set: as in `Evaluator`. Returns (s,) float32, s being the rows of `output.weight`.
    Raises KeyError for a missing array; ValueError for a wrong shape, a value that is not finite or beyond a million,
    a result that is not finite, or an unknown instruction set.
    """
    arrays = {name: as_float32(array) for name, array in network.items()}
    out = np.empty(len(arrays["output.weight"]), dtype=np.float32)
    native.encode_body(arrays, as_float32(points), as_float32(normals), out, instruction_set)
    return out
