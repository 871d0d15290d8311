"""VRM humanoid bones: by forward kinematics, the rig's limbs point where those of a VRM skeleton do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import load_body_model
from physkin_ros.joints.joint_states import JointStateError, JointStateReader
from physkin_ros.joints.vrm_naming import VrmNaming

TO_ROOT = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
"""From VRM's axes (X left, Y up, Z forward) to the root frame's."""
CHAINS = {  # VRM bones of a limb -> rig bones between which it points
    ("leftShoulder", "leftUpperArm"): ("upperarm01.L", "lowerarm01.L"),
    ("leftShoulder", "leftUpperArm", "leftLowerArm"): ("lowerarm01.L", "wrist.L"),
    ("rightUpperArm",): ("upperarm01.R", "lowerarm01.R"),
    ("rightUpperArm", "rightLowerArm"): ("lowerarm01.R", "wrist.R"),
    ("leftUpperLeg",): ("upperleg01.L", "lowerleg01.L"),
    ("leftUpperLeg", "leftLowerLeg"): ("lowerleg01.L", "foot.L"),
    ("rightUpperLeg",): ("upperleg01.R", "lowerleg01.R"),
}
SPREADS = {"UpperArm": 0.9, "UpperLeg": 0.6}


@pytest.fixture(scope="module")
def rig():
    return load_body_model().rig


@pytest.fixture(scope="module")
def reader(rig) -> JointStateReader:
    return JointStateReader(rig.joint_names, rig.rest, naming=VrmNaming(rig))


def direction(rig, positions, start: str, end: str) -> np.ndarray:
    transforms = rig.bone_transforms(positions)
    heads = np.einsum("bij,bj->bi", transforms[:, :, :3], rig.heads) + transforms[:, :, 3]
    way = heads[rig.bone_index(end)] - heads[rig.bone_index(start)]
    return way / np.linalg.norm(way)


def at_rest(bone: str) -> np.ndarray:
    """Where a VRM bone points in the T-pose, in VRM's axes."""
    if "Leg" in bone:
        return np.array([0, -1.0, 0])
    return np.array([1.0 if bone.startswith("left") else -1.0, 0, 0])


def test_any_pose_points_where_the_vrm_does(rig, reader):
    """Ball joints at random, elbows and knees bent about the axes they have."""
    random = np.random.default_rng(4)
    worst = 0.0
    for _ in range(60):
        angles = {}
        for side in ("left", "right"):
            for bone, spread in SPREADS.items():
                angles |= {f"{side}{bone}": random.uniform(-spread, spread, 3)}
            angles[f"{side}LowerArm"] = np.array([0, random.uniform(0, 1.5) * (-1 if side == "left" else 1), 0])
            angles[f"{side}LowerLeg"] = np.array([random.uniform(0, 1.5), 0, 0])
        names = [f"{bone}_{axis}" for bone in angles for axis in "xyz"]
        positions = reader.read(names, np.concatenate(list(angles.values())))
        for chain, ends in CHAINS.items():
            turn = Rotation.identity()
            for bone in chain:
                turn = turn * Rotation.from_euler("XYZ", angles.get(bone, np.zeros(3)))
            expected = TO_ROOT @ turn.apply(at_rest(chain[-1]))
            worst = max(worst, np.linalg.norm(direction(rig, positions, *ends) - expected))
    assert worst < 0.14


def test_trunk(rig, reader):
    """Nodding is about the model's X, which points to its left."""
    positions = reader.read(["spine_x", "head.y"], [0.2, 0.3])
    assert positions[rig.joint_names.index("spine05_y")] == pytest.approx(0.2)
    assert positions[rig.joint_names.index("head_z")] == pytest.approx(0.3)


def test_bad_names_are_refused(reader):
    """Two names for one angle; a name that is neither the rig's nor VRM's."""
    with pytest.raises(JointStateError, match="'leftHand_x' and 'leftHand.x' are the same angle"):
        reader.read(["leftHand_x", "leftHand.x"], [0.0, 0.0])
    with pytest.raises(JointStateError, match="no joint is known among 'leftThumb_x'"):
        reader.read(["leftThumb_x"], [0.0])
    with pytest.raises(JointStateError, match="'leftHand_x' is nan"):
        reader.read(["leftHand_x"], [np.nan])


def test_degrees_are_doubted(rig):
    """Of a ball joint the angles that came in, for the joints found from them never show it."""
    doubts = []
    reader = JointStateReader(
        rig.joint_names, rig.rest, naming=VrmNaming(rig), on_degrees=lambda *doubt: doubts.append(doubt)
    )
    reader.read(["leftUpperArm_y", "leftUpperArm_z"], [0.1, 80.0])
    assert doubts == [("leftUpperArm_z", 80.0)]
