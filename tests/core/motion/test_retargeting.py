"""Retargeting: poses made up of turned joints come out on the rig as the same poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.retargeting import retarget

RIG = load_body_model().rig
PARENTS = {"root": None, "chest": "root", "neck": "chest"}
for _side in "LR":
    PARENTS |= {f"hip.{_side}": "root", f"knee.{_side}": f"hip.{_side}", f"ankle.{_side}": f"knee.{_side}"}
    PARENTS |= {f"shoulder.{_side}": "chest", f"elbow.{_side}": f"shoulder.{_side}"}


def posed_heads(positions):
    """(T, b, 3) joint centres in the root frame."""
    transforms = RIG.bone_transforms(positions)
    return np.einsum("tbij,bj->tbi", transforms[..., :3], RIG.heads) + transforms[..., 3]


def limb(positions, start, end):
    """(T, 3) unit direction between two bones' heads."""
    heads = posed_heads(positions)
    direction = heads[:, RIG.bone_index(end)] - heads[:, RIG.bone_index(start)]
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def angle(first, second):
    """Largest angle between directions, in degrees."""
    return np.degrees(np.arccos(np.clip(np.sum(first * np.asarray(second), axis=-1), -1, 1))).max()


def retargeted(**turns):
    """Joint positions (2, d) and the report of a source that stands still, joints turned by (axis, degrees). A joint's
    point is written as `_`."""
    turns = {joint.replace("_", "."): turn for joint, turn in turns.items()}
    rotations = {}
    for joint, parent in PARENTS.items():
        axis, degrees = turns.get(joint, ("x", 0.0))
        local = Rotation.from_euler(axis, np.full((2, 1), degrees), degrees=True)
        rotations[joint] = local if parent is None else rotations[parent] * local
    return retarget(RIG, rotations)


def test_standing_lets_arms_and_legs_hang():
    """The source's zero on the rig: all limbs straight down."""
    positions, report = retargeted()
    for side in "LR":
        for start, end in (
            ("upperarm01", "lowerarm01"),
            ("lowerarm01", "wrist"),
            ("upperleg01", "lowerleg01"),
            ("lowerleg01", "foot"),
        ):
            assert angle(limb(positions, f"{start}.{side}", f"{end}.{side}"), [0, 0, -1]) < 2
    assert report["spine02"][1] < 1


@pytest.mark.parametrize(
    ("joint", "turn", "start", "end", "expected"),
    [
        ("shoulder_L", ("x", 90), "upperarm01.L", "wrist.L", [0, 1, 0]),
        ("shoulder_R", ("x", -90), "upperarm01.R", "wrist.R", [0, -1, 0]),
        ("shoulder_L", ("y", -60), "upperarm01.L", "wrist.L", [np.sin(np.pi / 3), 0, -0.5]),
        ("hip_R", ("y", -60), "upperleg01.R", "lowerleg01.R", [np.sin(np.pi / 3), 0, -0.5]),
        ("hip_L", ("x", 40), "upperleg01.L", "lowerleg01.L", [0, np.sin(np.radians(40)), -np.cos(np.radians(40))]),
        ("knee_L", ("y", 90), "lowerleg01.L", "foot.L", [-1, 0, 0]),
        ("elbow_R", ("y", -90), "lowerarm01.R", "wrist.R", [1, 0, 0]),
    ],
    ids=["arm left", "arm right", "arm ahead", "leg ahead", "leg aside", "knee", "elbow"],
)
def test_single_turns(joint, turn, start, end, expected):
    """One source joint turned by hand: the rig's limb points where it must, within two degrees."""
    positions, _ = retargeted(**{joint: turn})
    assert angle(limb(positions, start, end), expected) < 2


def test_chest_turn_is_shared_by_the_spine():
    """Thirty degrees of bending become about ten at each of three spine bones."""
    positions, report = retargeted(chest=("y", 30))
    shares = [positions[0, RIG.joint_names.index(f"{bone}_y")] for bone in ("spine05", "spine03", "spine02")]
    np.testing.assert_allclose(np.degrees(shares), 10, atol=0.5)
    assert report["spine02"][1] < 1


def test_limits_hold_and_are_reported():
    """A head turned backwards cannot be followed: limits hold, the report says by how much it is missed."""
    positions, report = retargeted(neck=("z", 150))
    assert (positions >= RIG.lower).all()
    assert (positions <= RIG.upper).all()
    assert report["head"][0] > 80
    assert report["at_limit"] > 0
