"""How far layers beneath swell the skin, on a tube in tubes; and that a garment is made for it."""

from types import SimpleNamespace

import numpy as np
import pytest
from random_models import tube

from physkin_core.model.garment import vertex_normals
from physkin_core.runtime.layers_beneath import LARGEST_SWELLING, LAYER_GAP, TUCKED_SWELLING, swelling

SKIN = tube(rings=25, segments=60, radius=0.15)


def layer(radius, *, above=-np.inf, tucked=False):
    """A tube around the skin, of what lies higher than told."""
    vertices = SKIN.vertices * [radius / 0.15, radius / 0.15, 1]
    rows = np.concatenate([vertices, vertex_normals(vertices, SKIN.faces)], axis=1).astype(np.float32)
    return SimpleNamespace(rest=rows[SKIN.vertices[:, 2] > above], tucked=tucked)


def height(*beneath):
    moved = swelling(SKIN.vertices, SKIN.faces, beneath)
    outward = vertex_normals(SKIN.vertices, SKIN.faces)
    np.testing.assert_allclose(moved, (moved * outward).sum(axis=1)[:, None] * outward, atol=1e-9)
    return (moved * outward).sum(axis=1)


@pytest.mark.parametrize("off, expected", [(0.006, 0.008), (0.03, LARGEST_SWELLING)])
def test_skin_swells_to_a_gap_over_the_layer_by_at_most_15_mm(off, expected):
    np.testing.assert_allclose(height(layer(0.15 + off)), expected, atol=3e-4)


def test_the_outermost_layer_counts_and_a_tucked_one_hugs_the_skin():
    np.testing.assert_allclose(height(layer(0.154), layer(0.158)), 0.008 + LAYER_GAP, atol=3e-4)
    np.testing.assert_allclose(height(layer(0.18, tucked=True)), TUCKED_SWELLING, atol=1e-6)


def test_swelling_ends_smoothly_beyond_a_hem():
    """Far below the hem there is none, far above all of it, and no step between neighbours."""
    z = SKIN.vertices[:, 2]
    middle = (z.min() + z.max()) / 2
    found = height(layer(0.158, above=middle))
    assert found[z > middle + 0.12].min() > 0.0095 and found[z < middle - 0.15].max() < 1e-4
    steps = np.abs(np.diff(found[SKIN.edges], axis=1))
    assert steps.max() < 0.004
