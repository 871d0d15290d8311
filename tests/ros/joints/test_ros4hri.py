"""ROS4HRI joint states (REP-155): by forward kinematics, limbs point where the human URDF's do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import load_body_model
from physkin_ros.joints.joint_states import JointStateError, JointStateReader
from physkin_ros.joints.ros4hri import Ros4hriNaming

X, Y, Z = np.eye(3)
LIMBS = {
    "arm": ("upperarm01", "lowerarm01"),
    "forearm": ("lowerarm01", "wrist"),
    "thigh": ("upperleg01", "lowerleg01"),
    "shin": ("lowerleg01", "foot"),
}
SEGMENTS = {
    f"{side}_{limb}": [f"{bone}.{side.upper()}" for bone in ends] for side in "lr" for limb, ends in LIMBS.items()
}
SEGMENTS |= {"trunk": ("spine05", "neck01"), "head": ("neck01", "head")}
TOLERANCE = 0.03  # the two halves of an upper arm or thigh are not quite in line
SHIN_TOLERANCE = 0.14  # the rig's knees stand inward of the line from hip to foot


@pytest.fixture(scope="module")
def rig():
    return load_body_model().rig


@pytest.fixture(scope="module")
def reader(rig) -> JointStateReader:
    return JointStateReader(rig.joint_names, rig.rest, naming=Ros4hriNaming(rig))


def directions(rig, reader, **angles: float) -> dict[str, np.ndarray]:
    """Unit vectors along the body's segments; every joint that is not given is zero in ROS4HRI."""
    names = [f"{side}_{name}" for side in "lr" for name in ("p_shoulder", "p_hip", "elbow", "knee")]
    angles = dict.fromkeys(names, 0.0) | angles
    transforms = rig.bone_transforms(reader.read(list(angles), list(angles.values())))
    heads = np.einsum("bij,bj->bi", transforms[:, :, :3], rig.heads) + transforms[:, :, 3]
    spans = {
        name: np.subtract(*(heads[rig.bone_index(bone)] for bone in ends[::-1])) for name, ends in SEGMENTS.items()
    }
    return {name: span / np.linalg.norm(span) for name, span in spans.items()}


def test_any_pose_matches_the_urdf(rig, reader):
    """Random angles: limbs as the chain of the URDF's rotations has them, which let them hang down at zero."""
    random = np.random.default_rng(3)
    for _ in range(50):
        for side, sign in (("l", 1), ("r", -1)):
            shoulder, hip, elbow = random.uniform(-1.5, 1.5, 3), random.uniform(-1, 1, 3), random.uniform(0, 2.5)
            arm = chain((-sign * Z, sign * X, sign * Z), shoulder)
            thigh = chain((-Z, sign * X, -Y), hip)
            angles = {f"{side}_{letter}_shoulder": angle for letter, angle in zip("ypr", shoulder)}
            angles |= {f"{side}_{letter}_hip": angle for letter, angle in zip("ypr", hip)}
            found = directions(rig, reader, **angles, **{f"{side}_elbow": elbow})
            for limb, turn in (("arm", arm), ("thigh", thigh)):
                np.testing.assert_allclose(found[f"{side}_{limb}"], turn.apply(-Z), atol=TOLERANCE)
            forearm = (arm * Rotation.from_rotvec(-elbow * Y)).apply(-Z)
            np.testing.assert_allclose(found[f"{side}_forearm"], forearm, atol=TOLERANCE)
            knee = random.uniform(-2.0, 0)  # of a thigh that hangs down
            found = directions(rig, reader, **{f"{side}_knee": knee})
            shin = Rotation.from_rotvec(-knee * Y).apply(-Z)
            np.testing.assert_allclose(found[f"{side}_shin"], shin, atol=SHIN_TOLERANCE)


def test_trunk_and_head(rig, reader):
    """The waist bends forward; the head nods with its own sign."""
    upright = directions(rig, reader)
    assert directions(rig, reader, waist=0.5)["trunk"][0] > upright["trunk"][0] + 0.1
    assert directions(rig, reader, p_head=-0.5)["head"][0] > upright["head"][0] + 0.05
    assert directions(rig, reader, r_head=0.5)["head"][1] < -0.05
    assert moved(rig, reader, ["y_head"], [0.6]) == pytest.approx({"neck01_z": 0.2, "neck03_z": 0.2, "head_z": 0.2})


def test_names_with_an_id(rig, reader):
    """As bodies are published; the rig's own pass through, and limbs that are not named are left alone."""
    found = moved(rig, reader, ["l_elbow_67dd1", "tail", "foot.L_y"], [0.0, 2.0, 0.1])
    assert found.keys() == {"foot.L_y", "lowerarm01.L_z"} and found["foot.L_y"] == pytest.approx(0.1)


def test_a_ball_joint_keeps_its_place_without_an_angle(rig):
    """All of it; the other shoulder and the knees go on. So do prefixed names, with or without the body's id."""
    lost = []
    reader = JointStateReader(
        rig.joint_names, rig.rest, naming=Ros4hriNaming(rig), prefix="robot1_", on_not_finite=lost.append
    )
    names = [f"robot1_{side}_{name}" for side in "lr" for name in ("y_shoulder", "p_shoulder", "r_shoulder", "knee_7")]
    reader.positions = before = reader.read(names, [0.3] * 8)
    after = reader.read(names, [0.4, np.nan, 0.4, 0.4, 0.4, 0.4, 0.4, np.inf])
    moved = {rig.joint_names[index] for index in np.flatnonzero(after != before)}
    assert {name.split("_")[0] for name in moved} == {"upperarm01.R", "upperarm02.R", "lowerleg01.L"}
    assert lost == [["robot1_r_knee_7", "robot1_l_p_shoulder"]] and np.isfinite(after).all()
    plain = JointStateReader(rig.joint_names, rig.rest, naming=Ros4hriNaming(rig))
    with pytest.raises(JointStateError, match="they match without 'robot1_'"):
        plain.read(names, [0.3] * 8)


def test_bad_values_are_refused(reader):
    """By the name that came in; nor may two names drive one joint of the rig."""
    with pytest.raises(JointStateError, match="'l_p_hip_7' is nan"):
        reader.read(["l_p_hip_7"], [np.nan])
    with pytest.raises(JointStateError, match="'l_knee_8' is the second 'l_knee'"):
        reader.read(["l_knee_7", "l_knee_8"], [0.0, 0.0])
    with pytest.raises(JointStateError, match="'upperarm01.L_x' and 'l_p_shoulder' are the same joint"):
        reader.read(["upperarm01.L_x", "l_p_shoulder"], [0.0, 0.0])


def moved(rig, reader, names, values) -> dict[str, float]:
    """Joints that a joint state moves away from rest."""
    read = reader.read(names, values)
    return {name: float(value) for name, value, rest in zip(rig.joint_names, read, rig.rest) if value != rest}


def chain(axes, angles) -> Rotation:
    """Rotations about fixed axes, outermost first."""
    turn = Rotation.identity()
    for axis, angle in zip(axes, angles):
        turn = turn * Rotation.from_rotvec(angle * axis)
    return turn
