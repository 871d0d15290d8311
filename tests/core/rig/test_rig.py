"""Rig: forward kinematics against a chain of 4x4 matrices, every rejection, and the way to JSON and back."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from random_models import random_rig, unit_rows
from scipy.spatial.transform import Rotation

from physkin_core import DegreeOfFreedom, Rig, RigError, load_body_model
from physkin_core.rig.rig import pose_vector


def shift(t):
    matrix = np.eye(4)
    matrix[:3, 3] = t
    return matrix


def turn(axis, angle):
    matrix = np.eye(4)
    axis = np.asarray(axis, dtype=float)
    matrix[:3, :3] = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()
    return matrix


def oracle(rig: Rig, q, heads=None):
    """Canonical-to-posed 4x4 matrices, a product of shifts and turns from the root down to each bone."""
    heads = rig.heads if heads is None else heads
    result = []
    for bone in range(rig.bone_count):
        path = [bone]
        while rig.parents[path[0]] >= 0:
            path.insert(0, int(rig.parents[path[0]]))
        world = np.eye(4)
        for step, at in enumerate(path):
            world = world @ shift(heads[at] - (heads[path[step - 1]] if step else 0))
            for dof, value in zip(rig.dofs, q, strict=True):
                if dof.bone == rig.bone_names[at]:
                    world = world @ turn(dof.axis, value - dof.rest)
        result.append(world @ shift(-heads[bone]))
    return np.array(result)


@pytest.mark.parametrize("bones, dofs", [(1, 0), (1, 3), (5, 7), (36, 52), (128, 117)])
def test_forward_kinematics_is_a_chain_of_matrices(bones, dofs):
    """Random trees, rests that are not zero, axes that are not unit, several degrees of freedom a bone, other heads."""
    rng = np.random.default_rng([bones, dofs])
    rig = random_rig(rng, bones=bones, dofs=dofs)
    q = rng.uniform(-2, 2, size=dofs)
    np.testing.assert_allclose(rig.bone_transforms(q), oracle(rig, q)[:, :3], atol=1e-10)
    heads = rig.heads + rng.normal(size=rig.heads.shape)
    np.testing.assert_allclose(rig.bone_transforms(q, heads=heads), oracle(rig, q, heads)[:, :3], atol=1e-10)


def test_forward_kinematics_of_a_batch_is_that_of_each():
    """Leading axes are kept, and each pose is independent of the others; the last one must have a number a joint."""
    rng = np.random.default_rng(1)
    rig = random_rig(rng)
    q = rng.uniform(-2, 2, size=(2, 3, len(rig.dofs)))
    batch = rig.bone_transforms(q)
    assert batch.shape == (2, 3, rig.bone_count, 3, 4)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(batch[index], oracle(rig, q[index])[:, :3], atol=1e-10)
    with pytest.raises(RigError, match=r"\(2, 3, 6\); the last axis must be 7"):
        rig.bone_transforms(q[..., :6])


def test_pose_vector_spans_minus_one_to_one():
    """-1 at the lower limit, 0 in the middle, 1 at the upper limit and beyond, then gravity untouched."""
    rng = np.random.default_rng(4)
    rig = random_rig(rng)
    gravity = unit_rows(rng, 1)[0]
    d = len(rig.dofs)
    for positions, value in [
        (rig.lower, -1),
        ((rig.lower + rig.upper) / 2, 0),
        (rig.upper, 1),
        (0.75 * rig.upper + 0.25 * rig.lower, 0.5),
        (rig.lower - 3, -1),
        (rig.upper + 3, 1),
    ]:
        vector = pose_vector(positions, rig.lower, rig.upper, gravity)
        assert vector.shape == (d + 3,) == (rig.pose_size,)
        np.testing.assert_allclose(vector[:d], value, atol=1e-12)
        np.testing.assert_array_equal(vector[d:], gravity)
    batch = pose_vector(np.stack([rig.lower, rig.upper]), rig.lower, rig.upper, np.stack([gravity, -gravity]))
    np.testing.assert_allclose(batch[1], pose_vector(rig.upper, rig.lower, rig.upper, -gravity))


@pytest.mark.parametrize("bones, dofs", [(1, 0), (5, 7), (128, 117)])
def test_json_round_trip_is_exact(bones, dofs):
    """Through text, so that every number survives as written."""
    rig = random_rig(np.random.default_rng([5, bones]), bones=bones, dofs=dofs)
    back = Rig.from_json(json.loads(json.dumps(rig.to_json())))
    assert back.bone_names == rig.bone_names and back.dofs == rig.dofs
    for name in ("parents", "heads", "tails", "dof_bones", "dof_axes", "lower", "upper", "rest"):
        np.testing.assert_array_equal(getattr(back, name), getattr(rig, name))


def two_bones(**changes) -> Rig:
    fields = dict(
        bone_names=("root", "arm"),
        parents=np.array([-1, 0]),
        heads=np.zeros((2, 3)),
        tails=np.ones((2, 3)),
        dofs=(DegreeOfFreedom("arm_x", "arm", (1, 0, 0), -1, 1),),
    )
    return Rig(**{**fields, **changes})


def dof(**changes) -> tuple[DegreeOfFreedom]:
    return (replace(DegreeOfFreedom("arm_x", "arm", (1.0, 0.0, 0.0), -1.0, 1.0), **changes),)


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(bone_names=(), parents=[], heads=[], tails=[], dofs=()), "needs 1 to 2048 bones, got 0"),
        (dict(bone_names=("root", "root")), "bone 'root' occurs twice"),
        (dict(dofs=dof() * 2), "degree of freedom 'arm_x' occurs twice"),
        (dict(parents=np.array([-1])), r"parents \(1,\)"),
        (dict(heads=np.zeros((3, 3))), r"heads \(3, 3\)"),
        (dict(heads=np.array([[0, 0, 0], [0, np.nan, 0]])), "finite"),
        (dict(parents=np.array([0, 0])), r"bone 0 \('root'\) must be the root with parent -1, got 0"),
        (dict(parents=np.array([-1, -1])), "bone 'arm' has parent -1; a parent must come before"),
        (dict(parents=np.array([-1, 7])), "bone 'arm' has parent 7"),
        (dict(dofs=dof(bone="leg")), "'arm_x' turns unknown bone 'leg'"),
        (dict(dofs=dof(axis=(0.0, 0.0, 0.0))), "'arm_x' has a zero axis"),
        (dict(dofs=dof(axis=(1.0, 0.0))), "'arm_x': axis"),
        (dict(dofs=dof(lower=-np.inf)), "'arm_x'.*finite"),
        (dict(dofs=dof(rest=np.nan)), "'arm_x'.*finite"),
        (dict(dofs=dof(lower=1.0, upper=1.0)), "'arm_x': lower 1.0 must be below upper 1.0"),
        (dict(dofs=dof(lower=2.0)), "'arm_x': lower 2.0 must be below upper 1.0"),
    ],
)
def test_inconsistent_rig_is_refused_by_name(changes, message):
    two_bones()
    with pytest.raises(RigError, match=message):
        two_bones(**changes)


def test_joint_positions_by_name():
    """Others stay at rest, or where `start` has them; an unknown name is answered with similar ones."""
    rig = random_rig(np.random.default_rng(8))
    expected = rig.rest.copy()
    expected[[2, 5]] = 0.5, -0.25
    np.testing.assert_array_equal(rig.joint_positions({"joint5": -0.25, "joint2": 0.5}), expected)
    np.testing.assert_array_equal(rig.joint_positions({}), rig.rest)
    start = np.arange(7.0)
    np.testing.assert_array_equal(rig.joint_positions({"joint0": 9}, start=start), [9, 1, 2, 3, 4, 5, 6])
    assert start[0] == 0
    with pytest.raises(RigError, match=r"no joint 'jiont3' .*joint3.*physkin info"):
        rig.joint_positions({"jiont3": 1.0})
    with pytest.raises(RigError, match=r"no joint 'q'") as caught:
        rig.joint_positions({"q": 1.0})
    assert not any(name in str(caught.value) for name in rig.joint_names)  # not all of them
    with pytest.raises(RigError, match=r"start has shape \(6,\), expected \(7,\)"):
        rig.joint_positions({}, start=np.zeros(6))


@pytest.mark.parametrize(
    "path, value, message",
    [
        (["bones"], None, None),
        (["dofs"], None, None),
        (["bones", 1, "head"], None, None),
        (["dofs", 0, "axis"], None, None),
        (["bones"], 3, None),
        (["bones", 1, "parent"], "left", None),
        (["bones", 1, "parent"], 2**40, None),
        (["bones", 1, "parent"], 0.5, None),
        (["bones", 1, "tail"], [0, 0], None),
        (["dofs", 0, "upper"], "high", None),
        (["dofs", 0, "stiffness"], 1, None),
        (["bones", 1, "tial"], [1, 0, 0], "bone 'arm' has unknown entries 'tial'; allowed: name, parent, head, tail"),
        (["joints"], [], "rig has unknown entries 'joints'; allowed: bones, dofs"),
    ],
)
def test_malformed_json_is_a_rig_error(path, value, message):
    """An entry left out (None) or of another kind; the message names what is wrong where that has a name."""
    data = two_bones().to_json()
    Rig.from_json(data)
    at = data
    for key in path[:-1]:
        at = at[key]
    at.update({path[-1]: value}) if value is not None else at.pop(path[-1])
    with pytest.raises(RigError, match=message):
        Rig.from_json(data)
    for other in (None, [], {"bones": {"a": 1}, "dofs": []}):
        with pytest.raises(RigError):
            Rig.from_json(other)


def test_default_rig_is_the_one_described():
    """36 bones, names NAME_x, _y, _z with zero the canonical pose, left and right mirrored."""
    rig = load_body_model().rig
    assert rig.bone_count == 36 and not rig.rest.any()
    assert ((rig.lower <= 0) & (rig.upper >= 0)).all()
    sided = {dof.name: dof for dof in rig.dofs}
    for name, left in sided.items():
        if ".L_" not in name:
            continue
        right = sided[name.replace(".L_", ".R_")]
        mirror = -1 if name[-1] == "y" else 1  # an axis (pseudo-vector) mirrors in the XZ plane as (-x, y, -z)
        assert right.bone == left.bone.replace(".L", ".R")
        np.testing.assert_allclose(right.axis, np.array(left.axis) * mirror * np.array([1, -1, 1]), atol=5e-3)
        limits = (right.lower, right.upper) if name[-1] == "y" else (-right.upper, -right.lower)
        np.testing.assert_allclose(limits, (left.lower, left.upper), atol=5e-3)


def test_translations_change_as_when_joint_centres_move():
    """The same angles on two bodies: rotations agree, and `translation_change` says how translations differ."""
    rng = np.random.default_rng(3)
    rig = load_body_model().rig
    elsewhere = rng.normal(scale=0.03, size=rig.heads.shape)
    elsewhere[0] = 0
    q = rng.uniform(rig.lower, rig.upper)
    here, there = rig.bone_transforms(q), rig.bone_transforms(q, heads=rig.heads + elsewhere)
    change = np.einsum("kij,bkj->bi", here[..., :3], rig.translation_change(elsewhere))
    np.testing.assert_allclose(here[..., 3] + change, there[..., 3], atol=1e-12)
    last_turned = here[rig.turns_with][..., :3]
    np.testing.assert_allclose(here[..., :3], last_turned, atol=1e-12)
