"""Hyper modulator against a token-by-token float64 reading; memory, and the same person in two poses."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from random_models import random_hyper_modulator, random_model, unit_rows

from physkin_core import avatar_from_body, load_avatar, load_body_model, load_garment_model
from physkin_core.model import hyper_modulator
from physkin_core.model.hyper_modulator import POINT_COUNT, body_modulation
from physkin_core.model.model_file import MODELS_PATH
from physkin_core.runtime.binding import encode_body

SHIPPED = [
    pytest.param(path, marks=() if path.stem == "tshirt" else pytest.mark.slow, id=path.stem)
    for path in sorted(MODELS_PATH.glob("*.safetensors"))
]


def surface_points(rng, count):
    return rng.uniform(-1, 1, size=(count, 3)), unit_rows(rng, count)


# --- The oracle: one token, one head, one query at a time, in float64. ---


def oracle_features(point, normal):
    angles = [coordinate * math.pi * 2**k for coordinate in point for k in range(6)]
    return np.array([*point, *map(math.sin, angles), *map(math.cos, angles), *normal])


def oracle_norm(network, name, x):
    return (x - x.mean()) / np.sqrt(x.var() + 1e-5) * network[f"{name}.weight"] + network[f"{name}.bias"]


def oracle(arrays, points, normals):
    network = {name: array.astype(np.float64) for name, array in arrays.items()}

    def linear(name, x):
        return network[f"{name}.weight"] @ x + network[f"{name}.bias"]

    tokens = [linear("embed", oracle_features(p, n)) for p, n in zip(points, normals)]
    width = len(tokens[0])
    size = width // 4
    projected = [linear("attention.input", token) for token in tokens]
    for index, own in enumerate(projected):
        heads = []
        for head in range(4):
            part = slice(head * size, (head + 1) * size)
            query = own[:width][part]
            score = np.array([query @ other[width : 2 * width][part] / math.sqrt(size) for other in projected])
            share = np.exp(score) / np.exp(score).sum()
            heads.append(sum(s * other[2 * width :][part] for s, other in zip(share, projected)))
        token = oracle_norm(network, "norm_1", tokens[index] + linear("attention.output", np.concatenate(heads)))
        hidden = np.maximum(linear("feed_forward.0", token), 0)
        tokens[index] = oracle_norm(network, "norm_2", token + linear("feed_forward.1", hidden))
    score = np.array([linear("pool", token)[0] for token in tokens])
    body = sum(s * token for s, token in zip(np.exp(score) / np.exp(score).sum(), tokens))
    block = 0
    while f"residual.{block}.0.weight" in network:
        inner = linear(f"residual.{block}.0", oracle_norm(network, f"residual.{block}.norm", body))
        body = body + linear(f"residual.{block}.1", np.maximum(inner, 0))
        block += 1
    return linear("output", body)


@pytest.mark.parametrize(
    "width, feed_forward, blocks, count, chunk", [(8, 16, 2, 9, 1), (12, 5, 0, 100, 7), (4, 8, 1, 1, 500)]
)
def test_values_token_by_token(width, feed_forward, blocks, count, chunk, monkeypatch):
    """Whatever number of queries is worked on at once, also where the last chunk is a part of one."""
    monkeypatch.setattr(hyper_modulator, "QUERY_CHUNK", chunk)
    rng = np.random.default_rng([width, count])
    network = random_hyper_modulator(rng, 10, width=width, feed_forward=feed_forward, blocks=blocks)
    points, normals = surface_points(rng, count)
    result = body_modulation(network, points, normals)
    assert result.shape == (10,) and result.dtype == np.float32
    np.testing.assert_allclose(result, oracle(network, points, normals), atol=2e-5)


def test_paper_size_stays_below_64_megabytes():
    """4096 points at width 128; all scores at once would take 268 MB."""
    rng = np.random.default_rng(2)
    network = random_hyper_modulator(rng, 4096, width=128, feed_forward=256)
    surface = surface_points(rng, POINT_COUNT)
    tracemalloc.start()
    try:
        result = body_modulation(network, *surface)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert np.isfinite(result).all()
    assert 4e6 < peak < 64e6  # the lower bound shows that arrays are counted


# --- The same person ---


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    """Six A-posed bodies; the first three again as T-posed VRMs, loaded into the canonical pose."""
    from physkin_prepare.avatar import prepare_vrm

    body = load_body_model()
    folder = tmp_path_factory.mktemp("people")
    vrms = []
    for index, version in enumerate(("1.0", "0.x", "1.0")):
        prepare_vrm(folder / f"{index}.vrm", body_index=index, vrm_version=version)
        vrms.append(load_avatar(folder / f"{index}.vrm", body.rig))
    return [avatar_from_body(body, coefficients) for coefficients in body.held_out_bodies[:6]], vrms


def random_network(seed):
    return random_model(np.random.default_rng(seed), rig=load_body_model().rig, width=128)


@pytest.mark.parametrize("source", [0, *SHIPPED])
def test_a_person_encodes_alike_from_either_pose(people, source):
    """T-posed VRM and A-posed body of one person: nearest to each other, and a third as far apart as strangers are."""
    known = isinstance(source, str)
    model, fit = (load_garment_model(source), 1.0) if known else (random_network(source), 0.0)
    bodies, vrms = people
    encoded = np.array([encode_body(model, body, fit=fit) for body in bodies])
    assert encoded.dtype == np.float32
    strangers = np.linalg.norm(encoded[:, None] - encoded, axis=-1)[np.triu_indices(6, 1)].mean()
    for index, vrm in enumerate(vrms):
        distance = np.linalg.norm(encoded - encode_body(model, vrm, fit=fit), axis=1)
        assert distance.argmin() == index
        assert distance[index] < strangers / 3
