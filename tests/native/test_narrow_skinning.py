"""Where network weights are not in fp32, skinning weights, places at rest and indices take fewer bits: skinning stays
within their rounding of the reference. What does not fit these bits keeps its own."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from reference.skinning import skin

from physkin_core.runtime.evaluator import Skinner, supported_instruction_sets

LEVELS = supported_instruction_sets()
STEPS, DETAIL_STEPS, REST_STEPS = 4095, 255, 2 * 32767
"""How many there are to one, to one, and to the garment's extent."""


def draped(garment, pose, level, precision="int8"):
    """Rows (n, 6), garment nodes and offsets of detail nodes of a frame."""
    evaluator = NativeFrame([garment], instruction_set=level, precision=precision)
    (cloud,) = clouds(evaluator, [garment], pose[0], told(pose[1]))
    return cloud, evaluator.node_transforms(), evaluator.detail_offsets()


def rounding(garment, nodes, offsets, sums=1.0):
    """(n,) how far away a vertex may be: every weight by a step, which moves it from what all of its nodes make of it
    towards what one does, and places at rest by half of one. sums: largest of a vertex's weights."""
    linear = nodes[:, :, :3]
    shift = nodes[:, :, 3] - np.einsum("mij,mj->mi", linear, garment.node_rest)
    images = (
        np.einsum("nkij,nj->nki", linear[garment.influence_nodes], garment.vertices) + shift[garment.influence_nodes]
    )
    spread = np.linalg.norm(images - images.mean(axis=1, keepdims=True), axis=2)
    stretch = np.linalg.norm(linear, ord=2, axis=(1, 2)).max()
    at_rest = np.sqrt(3) / 2 * np.ptp(garment.vertices, axis=0).max() / REST_STEPS
    if len(offsets):
        at_rest = at_rest + np.linalg.norm(offsets[garment.detail_nodes], axis=2).sum(axis=1) / DETAIL_STEPS
    return sums * (spread.sum(axis=1) / STEPS + stretch * at_rest) + 1e-5 * max(1, np.abs(images).max())


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("precision", ["bf16", "int8"])
@pytest.mark.parametrize("detail_nodes", [0, 40])
@pytest.mark.parametrize("influences", [1, 3, 16])
def test_agrees_with_the_reference(influences, detail_nodes, precision, level, make_garment, make_pose):
    """Garments whose vertices do not fill the blocks, with more nodes in a block than there are vertices."""
    rng = np.random.default_rng(100 * influences + detail_nodes)
    garment = make_garment(rng, nodes=40, vertices=333, influences=influences, detail_nodes=detail_nodes)
    cloud, nodes, offsets = draped(garment, make_pose(rng, garment), level, precision)
    positions, _ = skin(garment, nodes, offsets if detail_nodes else ())
    away = np.linalg.norm(cloud[:, :3] - positions, axis=1)
    assert (away <= rounding(garment, nodes, offsets)).all()
    skinned = np.empty_like(cloud)
    Skinner(garment).skin(nodes, skinned, *([offsets] if detail_nodes else []))  # not rounded
    assert not np.array_equal(skinned, cloud) and np.abs(skinned[:, :3] - positions).max() < 1e-5 * np.abs(nodes).max()


@pytest.mark.parametrize("level", LEVELS)
def test_weights_of_model_files_are_kept(level, make_garment, make_pose):
    """Which are whole steps already."""
    rng = np.random.default_rng(3)
    garment = make_garment(rng, nodes=40, vertices=333, influences=8)
    steps = rng.multinomial(STEPS, [0.5, 0.2, 0.1, 0.1, 0.05, 0.02, 0.02, 0.01], size=333)
    kept = replace(garment, influence_weights=(steps / STEPS).astype(np.float32))
    cloud, nodes, _ = draped(kept, make_pose(rng, garment), level)
    stretch = np.linalg.norm(nodes[:, :, :3], ord=2, axis=(1, 2)).max()
    at_rest = np.sqrt(3) / 2 * np.ptp(kept.vertices, axis=0).max() / REST_STEPS
    away = np.linalg.norm(cloud[:, :3] - skin(kept, nodes)[0], axis=1).max()
    assert away < stretch * at_rest + 1e-5 * max(1, np.abs(nodes).max())


@pytest.mark.parametrize("level", LEVELS)
def test_a_garment_that_moves_as_one_stays_as_it_is(level, make_garment, make_pose):
    """Rounded weights still sum to one: a step less would put a vertex 0.2 mm off, a metre from the root."""
    rng = np.random.default_rng(4)
    garment = make_garment(rng, bones=1, nodes=40, vertices=333, influences=16, deformer_widths=(8,))
    for weight, bias in garment.deformer_layers:
        weight[:] = bias[:] = 0
    garment = replace(garment, node_positions=garment.node_rest)
    cloud, nodes, _ = draped(garment, make_pose(rng, garment), level)
    at_rest = np.sqrt(3) / 2 * np.ptp(garment.vertices, axis=0).max() / REST_STEPS
    assert np.linalg.norm(cloud[:, :3] - skin(garment, nodes)[0], axis=1).max() < at_rest + 5e-6


def test_weights_may_sum_to_anything(make_garment, make_pose):
    rng = np.random.default_rng(5)
    garment = make_garment(rng, nodes=40, vertices=333, influences=4, detail_nodes=40)
    weights = garment.influence_weights * rng.uniform(0, 3, size=(333, 1)).astype(np.float32)
    weights[7] = 0
    garment = replace(garment, influence_weights=weights)
    cloud, nodes, offsets = draped(garment, make_pose(rng, garment), LEVELS[-1])
    whole = np.abs(skin(garment, nodes, offsets)[0]).max(axis=1) + 4  # the sum, too, by half a step
    away = np.linalg.norm(cloud[:, :3] - skin(garment, nodes, offsets)[0], axis=1)
    assert (away <= rounding(garment, nodes, offsets, sums=3) + 3 / STEPS * whole).all()
    assert (cloud[7, :3] == 0).all()


@pytest.mark.parametrize(
    "vertices, nodes, detail_nodes, is_rounded",
    [
        (65536, 6, 40, True),
        (65537, 6, 40, False),
        (200, 5461, 40, True),
        (200, 5462, 40, False),
        (200, 6, 21845, True),
        (200, 6, 21846, False),
    ],
)
def test_what_has_too_many_parts_keeps_its_bits(vertices, nodes, detail_nodes, is_rounded, make_garment, make_pose):
    """Then it is skinned as by `Skinner`. Vertices go with the last nodes."""
    rng = np.random.default_rng(6)
    garment = make_garment(rng, vertices=vertices, nodes=nodes, detail_nodes=40)
    garment.influence_nodes[:] = nodes - 1 - garment.influence_nodes % 6
    garment.detail_nodes[:] = detail_nodes - 1 - garment.detail_nodes
    garment = replace(garment, detail_offsets=np.resize(garment.detail_offsets, (3 * detail_nodes, 7)))
    cloud, nodes, offsets = draped(garment, make_pose(rng, garment), LEVELS[-1])
    skinned = np.empty_like(cloud)
    Skinner(garment).skin(nodes, skinned, offsets)
    assert np.array_equal(cloud, skinned) != is_rounded
    positions, _ = skin(garment, nodes, offsets)
    assert (np.linalg.norm(cloud[:, :3] - positions, axis=1) <= rounding(garment, nodes, offsets)).all()


@pytest.mark.parametrize("of", ["influence_weights", "detail_weights"])
def test_weights_below_zero_keep_their_bits(of, make_garment, make_pose):
    rng = np.random.default_rng(8)
    garment = make_garment(rng, nodes=40, vertices=100, detail_nodes=40)
    weights = getattr(garment, of)
    weights[50] = -0.5, 0.75, 0.75
    cloud, nodes, offsets = draped(garment, make_pose(rng, garment), LEVELS[-1])
    skinned = np.empty_like(cloud)
    Skinner(garment).skin(nodes, skinned, offsets)
    assert np.array_equal(cloud, skinned)
