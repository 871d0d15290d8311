"""ROS4HRI joint states (REP-155): by forward kinematics, limbs point where the human URDF's do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import load_body_model
from physkin_ros.joints.joint_states import JointStateError, JointStateReader
from physkin_ros.joints.ros4hri import Ros4hriNaming

X, Y, Z = np.eye(3)
SEGMENTS = {
    "l_arm": ("upperarm01.L", "lowerarm01.L"),
    "l_forearm": ("lowerarm01.L", "wrist.L"),
    "r_arm": ("upperarm01.R", "lowerarm01.R"),
    "r_forearm": ("lowerarm01.R", "wrist.R"),
    "l_thigh": ("upperleg01.L", "lowerleg01.L"),
    "l_shin": ("lowerleg01.L", "foot.L"),
    "r_thigh": ("upperleg01.R", "lowerleg01.R"),
    "r_shin": ("lowerleg01.R", "foot.R"),
    "trunk": ("spine05", "neck01"),
    "head": ("neck01", "head"),
}
TOLERANCE = 0.03  # the two halves of an upper arm or thigh are not quite in line
SHIN_TOLERANCE = 0.12  # the rig's knees stand inward of the line from hip to foot


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


def test_zero_hangs_straight_down(rig, reader):
    """The URDF's zero: limbs along -Z."""
    found = directions(rig, reader)
    for name in SEGMENTS.keys() - {"trunk", "head"}:
        np.testing.assert_allclose(found[name], -Z, atol=tolerance(name), err_msg=name)


@pytest.mark.parametrize(
    ("angles", "segment", "direction"),
    [
        ({"l_p_shoulder": 90}, "l_arm", Y),
        ({"r_p_shoulder": 90}, "r_arm", -Y),
        ({"l_p_shoulder": 180}, "l_arm", Z),
        ({"l_y_shoulder": 90, "l_p_shoulder": 90}, "l_arm", X),
        ({"r_y_shoulder": 90, "r_p_shoulder": 90}, "r_arm", X),
        ({"l_elbow": 90}, "l_forearm", X),
        ({"r_elbow": 90}, "r_forearm", X),
        ({"l_r_shoulder": 90, "l_elbow": 90}, "l_forearm", Y),
        ({"l_y_shoulder": 60, "l_r_shoulder": 60, "l_elbow": 90}, "l_forearm", X),
        ({"l_knee": -90}, "l_shin", -X),
        ({"r_knee": -90}, "r_shin", -X),
        ({"l_r_hip": 90}, "l_thigh", X),
        ({"r_r_hip": 90, "r_knee": -90}, "r_shin", -Z),
        ({"l_p_hip": 40}, "l_thigh", np.cos(0.698132) * -Z + np.sin(0.698132) * Y),
        ({"r_p_hip": 40}, "r_thigh", np.cos(0.698132) * -Z - np.sin(0.698132) * Y),
    ],
)
def test_limbs_go_where_they_should(rig, reader, angles, segment, direction):
    """Arms to the side, overhead and ahead, elbows and knees bent, thighs raised and spread; angles in degrees."""
    found = directions(rig, reader, **{name: np.radians(angle) for name, angle in angles.items()})
    np.testing.assert_allclose(found[segment], direction, atol=tolerance(segment))


def test_any_pose_matches_the_urdf(rig, reader):
    """Random angles: arms and thighs as the chain of the URDF's rotations has them."""
    random = np.random.default_rng(3)
    for _ in range(50):
        for side, sign in (("l", 1), ("r", -1)):
            shoulder, hip, elbow = random.uniform(-1.5, 1.5, 3), random.uniform(-1, 1, 3), random.uniform(0, 2.5)
            arm = chain((-sign * Z, sign * X, sign * Z), shoulder)
            thigh = chain((-Z, sign * X, -Y), hip)
            angles = {f"{side}_{letter}_shoulder": angle for letter, angle in zip("ypr", shoulder)}
            angles |= {f"{side}_{letter}_hip": angle for letter, angle in zip("ypr", hip)}
            found = directions(rig, reader, **angles, **{f"{side}_elbow": elbow})
            np.testing.assert_allclose(found[f"{side}_arm"], arm.apply(-Z), atol=TOLERANCE)
            forearm = (arm * Rotation.from_rotvec(-elbow * Y)).apply(-Z)
            np.testing.assert_allclose(found[f"{side}_forearm"], forearm, atol=TOLERANCE)
            np.testing.assert_allclose(found[f"{side}_thigh"], thigh.apply(-Z), atol=TOLERANCE)


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


def tolerance(segment: str) -> float:
    return SHIN_TOLERANCE if segment.endswith("shin") else TOLERANCE


def chain(axes, angles) -> Rotation:
    """Rotations about fixed axes, outermost first."""
    turn = Rotation.identity()
    for axis, angle in zip(axes, angles):
        turn = turn * Rotation.from_rotvec(angle * axis)
    return turn
