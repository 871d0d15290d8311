"""Weights in whole steps, as model files hold them, are packed in fewer bits, and indices of no more than 16: skinning
loses nothing. What has too many parts for that keeps its own bits."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, told
from reference.skinning import skin

from physkin_core.runtime.evaluator import Skinner, supported_instruction_sets

LEVELS = supported_instruction_sets()
STEPS, DETAIL_STEPS = 4095, 511


def in_steps(rng, weights, steps):
    """Rows of weights, most of a vertex light and some heavy, that sum to one."""
    share = rng.dirichlet(np.full(weights.shape[1], 0.3), size=len(weights))
    return np.array([rng.multinomial(steps, row) / steps for row in share], dtype=np.float32)


def whole(rng, garment):
    """The same garment by whole steps; a vertex goes with one node of each kind alone."""
    weights, details = in_steps(rng, garment.influence_weights, STEPS), garment.detail_weights
    weights[3], weights[3, 0] = 0, 1
    if details.size:
        details = in_steps(rng, details, DETAIL_STEPS)
        details[3], details[3, 0] = 0, 1
    return replace(garment, influence_weights=weights, detail_weights=details)


def assert_agrees(garment, pose, level, columns=6):
    """Within 1e-5 of the garment's size, and normals within 1e-5, more where blending all but cancelled them."""
    frame = NativeFrame([garment], instruction_set=level)
    out = np.full((len(garment.vertices), columns), np.nan, dtype=np.float32)
    frame.evaluate(pose[0], told(pose[1])[None], [out])
    offsets = frame.detail_offsets()
    positions, normals = skin(garment, frame.node_transforms().astype(np.float64), offsets if len(offsets) else ())
    assert np.abs(out[:, :3] - positions).max() <= 1e-5 * max(1.0, np.abs(positions).max())
    if columns == 6 and not len(garment.faces):
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        assert (np.abs(out[:, 3:] - normals / length) * np.minimum(length, 1)).max() <= 1e-5
    return frame, out


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("columns", [3, 6])
@pytest.mark.parametrize("detail_nodes", [0, 40])
@pytest.mark.parametrize("influences", [1, 3, 16])
def test_whole_steps_lose_nothing(influences, detail_nodes, columns, level, make_garment, make_pose):
    """Vertices do not fill the blocks; some blocks go with more nodes than they have vertices. `Skinner` gives the
    same bits."""
    rng = np.random.default_rng(100 * influences + detail_nodes)
    garment = make_garment(rng, nodes=40, vertices=333, influences=influences, detail_nodes=detail_nodes)
    garment = whole(rng, garment)
    frame, out = assert_agrees(garment, make_pose(rng, garment), level, columns)
    skinned = np.full((333, 6), np.nan, dtype=np.float32)
    Skinner(garment).skin(frame.node_transforms(), skinned, *([frame.detail_offsets()] if detail_nodes else []))
    if level == LEVELS[-1]:
        assert np.array_equal(skinned[:, :columns], out)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    "weights, details",
    [
        ([4094 / 4095, 0.5 / 4095, 0.5 / 4095], [1, 0, 0]),
        ([1, 0, 0], [510 / 511, 0.5 / 511, 0.5 / 511]),
        ([-1 / 4095, 4095 / 4095, 1 / 4095], [1, 0, 0]),
        ([1, 0, 0], [-1, 1, 1]),
        ([9, 9, 9], [1, 0, 0]),
        ([1, 0, 0], [1, 1, 1]),
        ([0, 0, 0], [0, 0, 0]),
    ],
    ids=str,
)
def test_other_weights_lose_nothing_either(weights, details, level, make_garment, make_pose):
    """One vertex is enough: between steps, below zero, and in sum more than one or none."""
    rng = np.random.default_rng(5)
    garment = whole(rng, make_garment(rng, nodes=40, vertices=100, detail_nodes=40))
    garment.influence_weights[50], garment.detail_weights[50] = weights, details
    assert_agrees(garment, make_pose(rng, garment), level, columns=3)


@pytest.mark.parametrize("of", ["nodes", "detail_nodes"])
def test_a_node_may_be_listed_twice(of, make_garment, make_pose):
    rng = np.random.default_rng(6)
    garment = whole(rng, make_garment(rng, nodes=40, vertices=100, detail_nodes=40))
    nodes = garment.influence_nodes if of == "nodes" else garment.detail_nodes
    nodes[:, 1] = nodes[:, 0]
    assert_agrees(garment, make_pose(rng, garment), LEVELS[-1])


@pytest.mark.parametrize(
    "vertices, nodes, detail_nodes",
    [
        (65520, 6, 40),
        (65521, 6, 40),
        (65536, 6, 40),
        (65537, 6, 40),
        (200, 5461, 40),
        (200, 5462, 40),
        (200, 6, 21845),
        (200, 6, 21846),
    ],
)
def test_as_many_parts_as_16_bits_tell_apart_and_more(vertices, nodes, detail_nodes, make_garment, make_pose):
    """Vertices go with the last nodes, and are put into places from which normals are computed, in groups of 16."""
    rng = np.random.default_rng(7)
    garment = whole(rng, make_garment(rng, vertices=vertices, nodes=nodes, detail_nodes=40))
    garment.influence_nodes[:] = nodes - 1 - garment.influence_nodes % 6
    garment.detail_nodes[:] = detail_nodes - 1 - garment.detail_nodes
    garment = replace(garment, detail_offsets=np.resize(garment.detail_offsets, (3 * detail_nodes, 7)))
    garment = replace(garment, faces=np.array([[0, 1, vertices - 1]], dtype=np.int32))
    assert_agrees(garment, make_pose(rng, garment), LEVELS[-1])
