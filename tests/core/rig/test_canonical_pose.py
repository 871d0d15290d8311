"""Canonical pose: least rotations, and limbs that end up in the directions of the canonical rig."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_rotation, unit_rows

from physkin_core import load_body_model
from physkin_core.rig.canonical_pose import (
    LIMB_SEGMENTS,
    limb_rotations,
    smallest_rotation,
    turned_down_the_chain,
)
from physkin_core.rig.linear_blend_skinning import linear_blend_skinning


def angle_of(rotation):
    return np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))


def directions():
    """Pairs of any, all but opposite and all but equal directions."""
    rng = np.random.default_rng(0)
    yield from zip(3 * unit_rows(rng, 50), 0.1 * unit_rows(rng, 50))
    for start in (*np.eye(3), *-np.eye(3), np.array([1.0, -2, 0.5])):
        for tilt in (0.0, 1e-12, 1e-7, 1e-4):
            nearly = start / np.linalg.norm(start) + tilt * np.roll(start, 1)
            yield from ((start, nearly), (start, -nearly))


def test_least_rotation_turns_one_direction_into_the_other():
    """By the angle between them and about their common normal, where they have one; lengths do not matter."""
    for start, end in directions():
        rotation = smallest_rotation(start, end)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-6)
        start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
        np.testing.assert_allclose(rotation @ start, end, atol=1e-4)
        assert angle_of(rotation) == pytest.approx(np.arccos(np.clip(start @ end, -1, 1)), abs=5e-4)
        if np.linalg.norm(np.cross(start, end)) > 1e-2:
            np.testing.assert_allclose(rotation @ np.cross(start, end), np.cross(start, end), atol=1e-9)
    for start, end in (([0, 0, 0], [1, 0, 0]), ([1, 0, 0], [0, 0, 0]), ([np.nan, 0, 0], [1, 0, 0])):
        with pytest.raises(ValueError, match="no length"):
            smallest_rotation(np.array(start), np.array(end))


def skeleton():
    rig = load_body_model().rig
    return dict(zip(rig.bone_names, rig.heads))


def test_any_pose_ends_up_in_the_canonical_directions():
    """Limbs bent at random: after turning each segment by its rotation, joint by joint down the limb, every segment has
    its canonical direction and its own length."""
    rng = np.random.default_rng(1)
    canonical, heads = skeleton(), dict(skeleton())
    for start, end in LIMB_SEGMENTS.values():
        heads[end] = heads[start] + random_rotation(rng) @ (canonical[end] - canonical[start]) * rng.uniform(0.8, 1.2)
    rotations = limb_rotations(heads, canonical)
    for bone, (start, end) in LIMB_SEGMENTS.items():
        turned, target = rotations[bone] @ (heads[end] - heads[start]), canonical[end] - canonical[start]
        np.testing.assert_allclose(turned / np.linalg.norm(turned), target / np.linalg.norm(target), atol=1e-7)


def test_a_lower_segment_is_carried_by_the_upper_one():
    """An arm turned as a whole comes back as a whole: upper and lower segment get the same rotation."""
    canonical, heads = skeleton(), dict(skeleton())
    rotation = smallest_rotation(canonical["lowerarm01.L"] - canonical["upperarm01.L"], np.array([0.3, 1.0, 0.2]))
    shoulder = canonical["upperarm01.L"]
    for name in ("lowerarm01.L", "wrist.L"):
        heads[name] = shoulder + rotation @ (canonical[name] - shoulder)
    rotations = limb_rotations(heads, canonical)
    np.testing.assert_allclose(rotations["upperarm01.L"], rotation.T, atol=1e-7)
    np.testing.assert_allclose(rotations["lowerarm01.L"], rotation.T, atol=1e-7)
    np.testing.assert_allclose(rotations["upperarm01.R"], np.eye(3), atol=1e-7)


def test_segments_missing_on_either_side_are_skipped():
    heads = skeleton()
    del heads["wrist.L"]
    rotations = limb_rotations(heads, skeleton())
    assert "lowerarm01.L" not in rotations and "upperarm01.L" in rotations and len(rotations) == 7
    assert len(limb_rotations(skeleton(), heads)) == 7


def test_turns_go_down_the_chain():
    """Joints with a turn have it as their world rotation, others their parent's; all stay attached; two roots."""
    rng = np.random.default_rng(2)
    parents, heads = np.array([-1, 0, 1, 1, -1, 4]), rng.normal(size=(6, 3))
    turns = {1: random_rotation(rng), 3: random_rotation(rng), 4: random_rotation(rng)}
    transforms, posed = turned_down_the_chain(heads, parents, turns)
    expected = [np.eye(3), turns[1], turns[1], turns[3], turns[4], turns[4]]
    np.testing.assert_allclose(transforms[..., :3], expected)
    np.testing.assert_allclose(posed[[0, 4]], heads[[0, 4]])
    for joint, parent in enumerate(parents):
        for carrier in {joint, parent} - {-1}:
            moved = transforms[carrier, :, :3] @ heads[joint] + transforms[carrier, :, 3]
            np.testing.assert_allclose(moved, posed[joint], atol=1e-12)


def test_blending_vertex_by_vertex():
    rng = np.random.default_rng(3)
    vertices, transforms = rng.normal(size=(8, 3)), rng.normal(size=(4, 3, 4))
    joints, weights = rng.integers(0, 4, size=(8, 2)), rng.dirichlet(np.ones(2), size=8)
    moved = linear_blend_skinning(vertices, transforms, joints, weights)
    for vertex, result, own, share in zip(vertices, moved, joints, weights):
        expected = sum(w * (transforms[j] @ [*vertex, 1.0]) for j, w in zip(own, share))
        np.testing.assert_allclose(result, expected, atol=1e-12)
