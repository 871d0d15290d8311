"""Hyper modulator: points on the body in canonical pose -> modulation of the pose modulator (paper: Hyper Modulator).

Positional encoding, one standard transformer encoder layer (post-norm, ReLU, 4 heads), self-attention pooling to one
vector, residual MLP blocks, a linear output. Runs once a body. Attention is computed in chunks of query points, so
4096 points need tens of megabytes, not gigabytes.

Dimensions: `N` points, `D` token width, `H` heads.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from physkin_core.native_module import native

__all__ = [
    "BENDING_OCTAVES",
    "ENCODING_FREQUENCIES",
    "POINT_COUNT",
    "at_fit",
    "bending_code",
    "body_modulation",
    "encode_points",
    "hyper_modulator_shapes",
    "token_features",
    "with_bending",
]

POINT_COUNT = 4096
ENCODING_FREQUENCIES: int = native.constants["encoding_frequencies"]
HEADS: int = native.constants["heads"]
BENDING_OCTAVES = (-2.0, 4.0)
"""How much softer and stiffer than the trained cloth others bend, as powers of two."""
QUERY_CHUNK = 256


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


def encode_points(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Positional encoding: x, sin(2^k pi x), cos(2^k pi x) for k < 6, and the normal.

    points: (..., N, 3) [m] canonical pose, root at the origin. normals: (..., N, 3).
    Returns (..., N, token_features()).
    """
    angles = points[..., None] * (np.pi * 2.0 ** np.arange(ENCODING_FREQUENCIES))
    angles = angles.reshape(*points.shape[:-1], -1)
    return np.concatenate([points, np.sin(angles), np.cos(angles), normals], axis=-1)


def at_fit(network: Mapping[str, np.ndarray], fit: float) -> dict[str, np.ndarray]:
    """The hyper modulator of a garment worn at a fit, 0 (the template) to 1 (made to measure).

    Every token is shifted by fit times the learnt vector "fit" (D,), which goes into a bias.
    """
    return {name: array for name, array in _shifted(network, "fit", fit).items() if name not in ("fit", "bend")}


def bending_code(stiffer: float) -> float:
    """The number that stands for cloth which bends `stiffer` times as stiffly as the trained one: 0 for that one."""
    return math.log2(stiffer) / BENDING_OCTAVES[1]


def with_bending(network: Mapping[str, np.ndarray], stiffer: float) -> dict[str, np.ndarray]:
    """The hyper modulator of cloth that bends `stiffer` times as stiffly as the trained one, and can bend no other way.

    Every token is shifted by `bending_code` times the learnt vector "bend" (D,), of which zeros are left.
    """
    return _shifted(network, "bend", bending_code(stiffer)) | {"bend": np.zeros_like(network["bend"])}


def _shifted(network: Mapping[str, np.ndarray], name: str, amount: float) -> dict[str, np.ndarray]:
    """All tokens shifted by `amount` times the vector of that name, which goes into a bias."""
    shift = {"embed.bias": network["embed.bias"] + np.float32(amount) * network[name]} if amount else {}
    return {**network, **shift}


def body_modulation(network: Mapping[str, np.ndarray], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Scale and shift for every hidden unit of the pose modulator.

    network: arrays by name as in the garment model file (without the `hyper_modulator.` prefix).
    points, normals: (N, 3) from `sample_surface`. Returns (s,) float32, laid out as in `physkin_core.model.mlp`.
    """
    tokens = _linear(network, "embed", encode_points(points, normals).astype(np.float32))
    attended = _linear(network, "attention.output", _self_attention(network, tokens))
    tokens = _layer_norm(network, "norm_1", tokens + attended)
    hidden = np.maximum(_linear(network, "feed_forward.0", tokens), 0)
    tokens = _layer_norm(network, "norm_2", tokens + _linear(network, "feed_forward.1", hidden))
    share = _softmax_in_place(_linear(network, "pool", tokens), axis=0)
    body = (share * tokens).sum(axis=0)
    block = 0
    while f"residual.{block}.norm.weight" in network:
        inner = _linear(network, f"residual.{block}.0", _layer_norm(network, f"residual.{block}.norm", body))
        body = body + _linear(network, f"residual.{block}.1", np.maximum(inner, 0))
        block += 1
    return _linear(network, "output", body)


def _self_attention(network: Mapping[str, np.ndarray], tokens: np.ndarray) -> np.ndarray:
    count, width = tokens.shape
    projected = _linear(network, "attention.input", tokens).reshape(count, 3, HEADS, width // HEADS)
    query, key, value = projected.transpose(1, 2, 0, 3)
    out = np.empty((count, HEADS, width // HEADS), dtype=tokens.dtype)
    scale = np.float32(1 / np.sqrt(width // HEADS))
    for start in range(0, count, QUERY_CHUNK):
        chunk = slice(start, start + QUERY_CHUNK)
        share = _softmax_in_place((query[:, chunk] * scale) @ key.transpose(0, 2, 1), axis=-1)
        out[chunk] = (share @ value).transpose(1, 0, 2)
    return out.reshape(count, width)


def _linear(network: Mapping[str, np.ndarray], name: str, x: np.ndarray) -> np.ndarray:
    return x @ network[f"{name}.weight"].T + network[f"{name}.bias"]


def _layer_norm(network: Mapping[str, np.ndarray], name: str, x: np.ndarray) -> np.ndarray:
    centred = x - x.mean(axis=-1, keepdims=True)
    deviation = np.sqrt((centred * centred).mean(axis=-1, keepdims=True) + 1e-5)
    return centred / deviation * network[f"{name}.weight"] + network[f"{name}.bias"]


def _softmax_in_place(x: np.ndarray, axis: int) -> np.ndarray:
    """Overwrites and returns `x`: a chunk's scores are by far the largest array, and one copy of them is enough."""
    x -= x.max(axis=axis, keepdims=True)
    np.exp(x, out=x)
    x /= x.sum(axis=axis, keepdims=True)
    return x
