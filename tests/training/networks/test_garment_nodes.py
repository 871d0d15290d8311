"""Sampling of garment nodes and their initial skinning, on a cylinder whose geodesics are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from random_models import tube, tube_geodesics

from physkin_core import Garment
from physkin_training.networks.garment_nodes import initial_skinning_weights, sample_garment_nodes


@pytest.fixture(scope="module")
def cloth():
    """A tube of 1 cm edges, 30 garment nodes, their heat-method distances, and the exact ones."""
    garment = tube(rings=41, segments=94, radius=0.15, height=0.4)
    nodes, distances = sample_garment_nodes(garment, 30)
    exact = np.stack([tube_geodesics(garment.vertices, int(node)) for node in nodes])
    return garment, nodes, distances, exact


def test_distances_are_geodesic(cloth):
    """Within 8 % of a node spacing of those along the smooth cylinder: not those through the air."""
    garment, nodes, distances, exact = cloth
    assert distances.shape == exact.shape and distances.min() >= 0
    assert np.abs(distances - exact).max() < 0.02 and np.abs(distances - exact).mean() < 0.006
    straight = np.linalg.norm(garment.vertices[nodes][:, None] - garment.vertices, axis=-1)
    assert (exact - straight).max() > 0.15, "the test must tell geodesics from straight lines"
    assert np.abs(distances[np.arange(30), nodes]).max() < 1e-9


def test_each_node_is_the_farthest_from_those_before_it(cloth):
    garment, nodes, _, exact = cloth
    radius = np.linalg.norm(garment.vertices - garment.vertices.mean(axis=0), axis=1)
    assert radius[nodes[0]] == pytest.approx(radius.max()) and len(set(nodes.tolist())) == 30
    for count in range(1, 30):
        to_others = exact[:count].min(axis=0)
        assert to_others[nodes[count]] > to_others.max() - 0.015


def two_tubes():
    one = tube(rings=9, segments=16)
    return Garment(
        np.concatenate([one.vertices, one.vertices + [0, 0, 1]]), np.concatenate([one.faces, one.faces + 144])
    )


def with_a_loose_vertex():
    one = tube(rings=3, segments=5)
    return Garment(np.vstack([one.vertices, [0, 0, 3]]), one.faces)


def test_every_piece_of_a_garment_gets_nodes():
    """Two pieces of the same size: a trouser leg is not left without garment nodes of its own, and no vertex follows
    nodes of the other piece only."""
    garment = two_tubes()
    nodes, distances = sample_garment_nodes(garment, 12)
    same = (nodes < 144)[:, None] == (np.arange(288) < 144)
    np.testing.assert_array_equal(np.isfinite(distances), same)
    assert 4 <= (nodes < 144).sum() <= 8
    order, weights = initial_skinning_weights(garment, distances, 4)
    own = (nodes[order] < 144) == (np.arange(288)[:, None] < 144)
    assert (weights * own).sum(axis=1).min() == pytest.approx(1)


def test_pieces_are_measured_as_if_alone():
    """Distances within a piece are those of the piece by itself, and its first node is its farthest from its middle."""
    one = tube(rings=9, segments=16)
    nodes, distances = sample_garment_nodes(two_tubes(), 2)
    alone, expected = sample_garment_nodes(one, 1)
    assert nodes[0] == alone[0] and nodes[1] >= 144
    np.testing.assert_array_equal(distances[0, :144], expected[0])


@pytest.mark.parametrize(
    "garment, count, named",
    [
        *((tube(rings=3, segments=5), count, f"{count} .* 15") for count in (0, -1, 16)),
        (two_tubes(), 1, "cannot cover 2 separate pieces of the garment with 1 garment nodes"),
        (with_a_loose_vertex(), 3, "garment vertex 15 belongs to no face"),
    ],
)
def test_impossible_nodes_are_refused(garment, count, named):
    with pytest.raises(ValueError, match=named):
        sample_garment_nodes(garment, count)


def test_skinning_weights_row_by_row(cloth):
    """exp(-d / spacing) over the closest nodes, spacing sqrt(area / m), normalised; closest first."""
    garment, _, distances, _ = cloth
    order, weights = initial_skinning_weights(garment, distances, 8)
    assert order.shape == weights.shape == (len(garment.vertices), 8)
    spacing = math.sqrt(2 * 94 * 0.15 * math.sin(math.pi / 94) * 0.4 / 30)
    for vertex in range(0, len(garment.vertices), 97):
        closest = sorted(range(30), key=lambda node: distances[node, vertex])[:8]
        expected = np.array([math.exp(-distances[node, vertex] / spacing) for node in closest])
        np.testing.assert_allclose(weights[vertex], expected / expected.sum(), rtol=1e-9)
        np.testing.assert_allclose(distances[order[vertex], vertex], distances[closest, vertex])


def test_more_influences_than_nodes_means_all_of_them():
    garment = tube(rings=3, segments=5)
    _, distances = sample_garment_nodes(garment, 4)
    order, weights = initial_skinning_weights(garment, distances, 16)
    assert order.shape == weights.shape == (15, 4)
