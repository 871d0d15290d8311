"""Rotations of bones: the joint positions that they came from, and clear refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import (
    BUNDLED_AVATAR,
    BoneRotations,
    DegreeOfFreedom,
    Draper,
    Rig,
    RigError,
    load_avatar,
    load_body_model,
    load_garment_model,
)
from physkin_core.rig.vrm_bones import VRM_AXES

RIG = load_body_model().rig
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def rotations_of(positions) -> dict[str, np.ndarray]:
    """Quaternion of each bone that joint positions (d,) turn, by the rig's own definition."""
    turns = {}
    for dof, axis, value in zip(RIG.dofs, RIG.dof_axes, np.asarray(positions, dtype=np.float64)):
        turn = Rotation.from_rotvec(axis * (value - dof.rest))
        turns[dof.bone] = turns[dof.bone] * turn if dof.bone in turns else turn
    return {bone: turn.as_quat() for bone, turn in turns.items()}


def poses(count):
    random = np.random.default_rng(3)
    yield RIG.rest.astype(np.float32)
    for _ in range(count):
        pose = random.uniform(RIG.lower, RIG.upper).astype(np.float32)
        yield np.where(random.random(len(pose)) < 0.3, RIG.rest, pose).astype(np.float32)


def test_positions_come_back_to_the_bit():
    """Within the limits, in single precision, whatever the sign of the quaternions."""
    solver = BoneRotations(RIG)
    for pose in poses(300):
        found = solver.joint_positions({bone: -value for bone, value in rotations_of(pose).items()})
        np.testing.assert_array_equal(found.astype(np.float32), pose)


def test_the_same_drape_to_the_bit():
    """By bone or as one array; bones that are left out are at rest."""
    model = load_garment_model("tshirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), fit=0)
    for pose in poses(5):
        expected = draper.drape(pose)
        given = rotations_of(pose)
        np.testing.assert_array_equal(draper.drape_rotations(given), expected)
        moved = {bone: value for bone, value in given.items() if abs(value[3]) < 1}
        np.testing.assert_array_equal(draper.drape_rotations(moved), expected)
        rows = np.array([given.get(bone, IDENTITY) for bone in RIG.bone_names])
        np.testing.assert_array_equal(draper.drape_rotations(rows), expected)


def test_start_keeps_the_others():
    """Bones that are left out keep what they are told to have."""
    start = np.linspace(-0.1, 0.1, len(RIG.dofs))
    found = BoneRotations(RIG).joint_positions({"head": IDENTITY}, start=start)
    head = np.array([dof.bone == "head" for dof in RIG.dofs])
    np.testing.assert_array_equal(found[~head], start[~head])
    np.testing.assert_array_equal(found[head], 0)


def test_beyond_limits_and_without_joints():
    """Positions are not held to the limits; a turn about an axis that a bone does not have is left out."""
    solver = BoneRotations(RIG)
    index = RIG.joint_names.index("lowerleg01.L_y")
    far = solver.joint_positions({"lowerleg01.L": Rotation.from_rotvec([0, 3.0, 0]).as_quat()})
    assert far[index] == pytest.approx(3.0) and RIG.upper[index] < 3
    twisted = solver.joint_positions({"lowerleg01.L": Rotation.from_rotvec([0, 0, 0.4]).as_quat()})
    np.testing.assert_allclose(twisted, RIG.rest, atol=1e-12)
    turned = solver.joint_positions({"pelvis.L": Rotation.from_rotvec([0, 0, 0.4]).as_quat()})
    np.testing.assert_array_equal(turned, RIG.rest)


def test_vrm_bones():
    """From the T-pose: arms let down by 70 degrees hang as they do for the angle of a joint state."""
    found = BoneRotations(RIG, skeleton="vrm").joint_positions(
        {
            "leftUpperArm": Rotation.from_euler("Z", -70, degrees=True).as_quat(),
            "rightUpperArm": Rotation.from_euler("Z", 70, degrees=True).as_quat(),
            "hips": Rotation.from_euler("X", 50, degrees=True).as_quat(),
        }
    )
    transforms = RIG.bone_transforms(found)
    heads = np.einsum("bij,bj->bi", transforms[:, :, :3], RIG.heads) + transforms[:, :, 3]
    for side, sign in (("L", 1), ("R", -1)):
        arm = heads[RIG.bone_index(f"lowerarm01.{side}")] - heads[RIG.bone_index(f"upperarm01.{side}")]
        angle = np.radians(70)
        expected = VRM_AXES.T @ [sign * np.cos(angle), -np.sin(angle), 0]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), expected, atol=0.02)


@pytest.mark.parametrize(
    ("rotations", "message"),
    [
        ({"haed": IDENTITY}, "no bone 'haed'; did you mean head"),
        (
            {"head": (0, 0, 0, 2.0)},
            r"bone 'head' is \[0.0, 0.0, 0.0, 2.0\]; expected a quaternion x, y, z, w of length 1",
        ),
        ({"head": (0, 0, np.nan, 1.0)}, "expected a quaternion"),
        ({"head": (0, 0, 1.0)}, "expected a quaternion"),
        (np.zeros((3, 4)), r"bone rotations have shape \(3, 4\), expected \(36, 4\)"),
    ],
)
def test_bad_rotations(rotations, message):
    with pytest.raises(RigError, match=message):
        BoneRotations(RIG).joint_positions(rotations)


def test_rigs_that_it_is_not_for():
    """Axes that are not at right angles; VRM's bones on another rig; a skeleton that there is not."""
    ends = np.array([[0.0, 0, 0], [0, 0, 1]])
    dofs = [DegreeOfFreedom(name, "base", axis, -1, 1) for name, axis in (("a", (1, 0, 0)), ("b", (1, 1, 0)))]
    rig = Rig(("base",), np.array([-1]), ends[:1], ends[1:], tuple(dofs))
    with pytest.raises(RigError, match="joints a, b of bone 'base' turn about axes that are not at right angles"):
        BoneRotations(rig)
    with pytest.raises(RigError, match="bones of VRM are for the default rig"):
        BoneRotations(rig, skeleton="vrm")
    with pytest.raises(RigError, match="unknown skeleton 'smpl'; allowed: rig, vrm"):
        BoneRotations(rig, skeleton="smpl")
