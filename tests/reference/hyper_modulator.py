"""Hyper modulator: points on a body in canonical pose -> modulation of the pose modulator (paper: the same name).

Positional encoding, one standard transformer encoder layer (post-norm, ReLU, four heads), self-attention pooling to one
vector, residual MLP blocks, a linear output. Dimensions: `N` points, `D` token width.
"""

import numpy as np

OCTAVES, HEADS = 6, 4


def body_modulation(network, points, normals):
    """Scale and shift (s,) for every hidden unit of the pose modulator.

    network: arrays by name as in the garment model file, less the prefix. points, normals: (N, 3).
    """

    def linear(name, x):
        return x @ network[f"{name}.weight"].astype(np.float64).T + network[f"{name}.bias"]

    def norm(name, x):
        away = x - x.mean(axis=-1, keepdims=True)
        deviation = np.sqrt(np.square(away).mean(axis=-1, keepdims=True) + 1e-5)
        return away / deviation * network[f"{name}.weight"] + network[f"{name}.bias"]

    angles = (points[..., None].astype(np.float64) * np.pi * 2.0 ** np.arange(OCTAVES)).reshape(len(points), -1)
    tokens = linear("embed", np.concatenate([points, np.sin(angles), np.cos(angles), normals], axis=1))
    tokens = norm("norm_1", tokens + linear("attention.output", attention(linear("attention.input", tokens))))
    hidden = np.maximum(linear("feed_forward.0", tokens), 0)
    tokens = norm("norm_2", tokens + linear("feed_forward.1", hidden))
    body = softmax(linear("pool", tokens)[:, 0]) @ tokens
    block = 0
    while f"residual.{block}.norm.weight" in network:
        hidden = np.maximum(linear(f"residual.{block}.0", norm(f"residual.{block}.norm", body)), 0)
        body, block = body + linear(f"residual.{block}.1", hidden), block + 1
    return linear("output", body)


def attention(projected):
    """Self-attention (N, D) of queries, keys and values side by side (N, 3 D), head by head."""
    heads = []
    for query, key, value in zip(*(np.split(part, HEADS, axis=1) for part in np.split(projected, 3, axis=1))):
        heads.append(softmax(query @ key.T / np.sqrt(query.shape[1])) @ value)
    return np.concatenate(heads, axis=1)


def softmax(scores):
    shares = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return shares / shares.sum(axis=-1, keepdims=True)
