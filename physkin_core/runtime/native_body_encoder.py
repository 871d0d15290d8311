"""The hyper modulator in C++: `physkin_core.model.hyper_modulator.body_modulation` on one core in a few megabytes.

Dimensions: `N` points, `s` numbers of modulation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from physkin_core.runtime.native_evaluator import _native

__all__ = ["native_body_modulation"]


def native_body_modulation(
    network: Mapping[str, np.ndarray], points: np.ndarray, normals: np.ndarray, *, instruction_set: str | None = None
) -> np.ndarray:
    """Scale and shift for every hidden unit that the hyper modulator modulates (paper: Hyper Modulator).

    network: arrays by name as in the garment model file (without the `hyper_modulator.` prefix).
    points: (N, 3) [m] canonical pose, root at the origin; normals: (N, 3) unit, from `sample_surface`.
    instruction_set: as in `NativeEvaluator`. Returns (s,) float32, s being the rows of `output.weight`.
    Raises KeyError for a missing array; ValueError for a wrong shape, a value that is not finite or beyond a million,
    a result that is not finite, or an unknown instruction set.
    """
    arrays = {name: _float(array) for name, array in network.items()}
    out = np.empty(len(arrays["output.weight"]), dtype=np.float32)
    _native.encode_body(arrays, _float(points), _float(normals), out, instruction_set)
    return out


def _float(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float32)
