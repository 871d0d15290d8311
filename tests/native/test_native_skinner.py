"""Skinning without networks equals the readable reference."""

import numpy as np
import pytest
from random_models import needs_native

from physkin_core.model.skinning import skin

pytestmark = needs_native


@pytest.mark.parametrize("influences", [1, 4])
def test_equals_the_reference(influences):
    """Random garment nodes and skinning weights."""
    from physkin_core.runtime.native_skinner import NativeSkinner

    random = np.random.default_rng(influences)
    n, m = 137, 11
    vertices, node_rest = (random.normal(size=(count, 3)).astype(np.float32) for count in (n, m))
    normals = random.normal(size=(n, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    nodes = random.integers(0, m, (n, influences)).astype(np.int32)
    weights = random.uniform(0.1, 1, (n, influences)).astype(np.float32)
    weights /= weights.sum(axis=1, keepdims=True)
    transforms = random.normal(size=(m, 3, 4)).astype(np.float32)
    out = np.empty((n, 6), dtype=np.float32)
    NativeSkinner(vertices, normals, node_rest, nodes, weights).skin(transforms, out)
    positions, turned = skin(transforms.astype(np.float64), node_rest, vertices, normals, nodes, weights)
    np.testing.assert_allclose(out[:, :3], positions, atol=2e-5)
    np.testing.assert_allclose(out[:, 3:], turned, atol=2e-4)
    nodes[5, 0] = m
    with pytest.raises(ValueError):
        NativeSkinner(vertices, normals, node_rest, nodes, weights)
