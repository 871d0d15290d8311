"""Hyper modulator: points on the body in canonical pose -> modulation of the pose modulator (paper: Hyper Modulator).

Positional encoding, one standard transformer encoder layer (post-norm, ReLU, 4 heads), self-attention pooling to one
vector, residual MLP blocks, a linear output. Runs once a body (`physkin_core.runtime.body_encoder`).

Dimensions: `D` token width.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from physkin_core.native_module import native

__all__ = [
    "BENDING_OCTAVES",
    "ENCODING_FREQUENCIES",
    "OCTAVES_OF_A_CODE",
    "POINT_COUNT",
    "at_fit",
    "bending_code",
    "hyper_modulator_shapes",
    "token_features",
    "with_bending",
]

POINT_COUNT = 4096
ENCODING_FREQUENCIES: int = native.constants["encoding_frequencies"]
HEADS: int = native.constants["heads"]
BENDING_OCTAVES = (-2.0, 5.0)
"""How much softer and stiffer than the trained cloth others bend in training, as powers of two."""
OCTAVES_OF_A_CODE = 4.0
"""How many of them a step of 1 in the code for bending is."""


def token_features() -> int:
    """Numbers a point has after positional encoding: position, sines and cosines, normal."""
    return 3 + 6 * ENCODING_FREQUENCIES + 3


def hyper_modulator_shapes(names: Collection[str]) -> dict[str, str]:
    """Every array by its name, "fit" and "bend" (D,) among them, and its shape (see `physkin_core.model.model_arrays`).

    names: of arrays that are there, by which residual blocks are counted.
    """
    layers = {
        "embed": f"D {token_features()}",
        "attention.input": "3D D",
        "attention.output": "D D",
        "norm_1": "D",
        "feed_forward.0": "feed_forward D",
        "feed_forward.1": "D feed_forward",
        "norm_2": "D",
        "pool": "1 D",
    }
    block = 0
    while any(name.startswith(f"residual.{block}.") for name in names):
        inner = f"residual_{block}"
        own = {"norm": "D", "0": f"{inner} D", "1": f"D {inner}"}
        layers |= {f"residual.{block}.{part}": shape for part, shape in own.items()}
        block += 1
    layers["output"] = "pose_modulation D"
    shapes = {f"{name}.weight": shape for name, shape in layers.items()}
    return shapes | {f"{name}.bias": shape.split()[0] for name, shape in layers.items()} | {"fit": "D", "bend": "D"}


def at_fit(network: Mapping[str, np.ndarray], fit: float) -> dict[str, np.ndarray]:
    """The hyper modulator of a garment worn at a fit, 0 (the template) to 1 (made to measure).

    Every token is shifted by fit times the learnt vector "fit" (D,), which goes into a bias.
    """
    return {name: array for name, array in _shifted(network, "fit", fit).items() if name not in ("fit", "bend")}


def bending_code(stiffer: float) -> float:
    """The number that stands for cloth which bends `stiffer` times as stiffly as the trained one: 0 for that one."""
    return math.log2(stiffer) / OCTAVES_OF_A_CODE


def with_bending(network: Mapping[str, np.ndarray], stiffer: float) -> dict[str, np.ndarray]:
    """The hyper modulator of cloth that bends `stiffer` times as stiffly as the trained one, and can bend no other way.

    Every token is shifted by `bending_code` times the learnt vector "bend" (D,), of which zeros are left.
    """
    return _shifted(network, "bend", bending_code(stiffer)) | {"bend": np.zeros_like(network["bend"])}


def _shifted(network: Mapping[str, np.ndarray], name: str, amount: float) -> dict[str, np.ndarray]:
    """All tokens shifted by `amount` times the vector of that name, which goes into a bias."""
    shift = {"embed.bias": network["embed.bias"] + np.float32(amount) * network[name]} if amount else {}
    return {**network, **shift}
