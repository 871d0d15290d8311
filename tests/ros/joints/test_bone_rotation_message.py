"""Names and quaternions of a message as joint positions, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import load_body_model
from physkin_ros.joints.bone_rotation_message import BoneRotationReader
from physkin_ros.joints.joint_states import JointStateError, JointStateReader

RIG = load_body_model().rig
KNEE = RIG.joint_names.index("lowerleg01.L_y")
BENT = Rotation.from_rotvec([0, 0.5, 0]).as_quat().tolist()
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def reader(**more):
    states = JointStateReader(RIG.joint_names, RIG.rest)
    return states, BoneRotationReader(RIG, states, **more)


def test_bones_that_are_left_out():
    """They keep their last positions, as joints of joint states do."""
    states, bones = reader()
    states.positions[0] = 0.1
    out = np.empty(len(RIG.dofs), dtype=np.float32)
    bones.read(["lowerleg01.L"], [BENT], out)
    assert out[KNEE] == np.float32(0.5)
    assert out[0] == np.float32(0.1)


def test_unknown_bones_are_told_and_ignored():
    told = []
    _, bones = reader(on_unknown=told.append)
    out = np.empty(len(RIG.dofs), dtype=np.float32)
    bones.read(["tail", "lowerleg01.L"], [[9.0] * 4, BENT], out)
    assert told == [["tail"]] and out[KNEE] == np.float32(0.5)


def test_bones_of_vrm():
    _, bones = reader(skeleton="vrm")
    out = np.empty(len(RIG.dofs), dtype=np.float32)
    bones.read(["leftLowerLeg"], [Rotation.from_rotvec([0.5, 0, 0]).as_quat()], out)
    assert out[KNEE] > 0.3


@pytest.mark.parametrize(
    ("names", "rotations", "message"),
    [
        ([], [], "0 names and 0 transforms"),
        (["head"], [], "1 names and 0 transforms; allowed are equal numbers from 1 to 4096"),
        (["b"] * 5000, [IDENTITY] * 5000, "5000 names"),
        (["head", "head"], [IDENTITY, IDENTITY], "name a bone twice"),
        (["tail"], [IDENTITY], r"no bone is known among 'tail'"),
        (["head"], [[0.0, 0, 0, 0]], "the rotation of bone 'head'"),
        (["head"], [[np.nan, 0, 0, 1]], "the rotation of bone 'head'"),
    ],
)
def test_what_is_refused(names, rotations, message):
    """Nothing has changed then."""
    _, bones = reader()
    out = np.full(len(RIG.dofs), 7, dtype=np.float32)
    with pytest.raises(JointStateError, match=message):
        bones.read(names, rotations, out)
    assert (out == 7).all()
