"""Retargeting: poses made up in the source's format come out on the rig as the same poses."""

import json

import numpy as np
import pytest

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.retargeting import retarget
from physkin_prepare.motion import FRAME_SIZE, JOINTS, prepare_motion, read_clip

RIG = load_body_model().rig
STANDING = np.zeros(FRAME_SIZE)
STANDING[0], STANDING[2] = 1 / 30, 0.9
for _, _columns in JOINTS.values():
    if isinstance(_columns, slice):
        STANDING[_columns] = [1, 0, 0, 0]


def turn(joint, axis, degrees):
    """Columns and value that turn a source joint (quaternion) by an angle about a source axis (x, y or z)."""
    half = np.radians(degrees) / 2
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + "xyz".index(axis)] = np.cos(half), np.sin(half)
    return JOINTS[joint][1], quaternion


def clip(path, *frames, loop="none"):
    """Write a clip of standing frames with the given (columns, value) changes each."""
    rows = []
    for changes in frames:
        rows.append(STANDING.copy())
        for columns, value in changes:
            rows[-1][columns] = value
    path.write_text(json.dumps({"Loop": loop, "Frames": np.array(rows).tolist()}))
    return path


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


def retargeted(tmp_path, changes):
    """Joint positions (2, d) and the report of a clip that stands still with these changes."""
    rotations, *_ = read_clip(clip(tmp_path / "a.txt", changes, changes))
    return retarget(RIG, rotations)


def test_standing_lets_arms_and_legs_hang(tmp_path):
    """The source's zero on the rig: all limbs straight down."""
    positions, report = retargeted(tmp_path, [])
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
    ("change", "start", "end", "expected"),
    [
        (turn("shoulder.L", "x", 90), "upperarm01.L", "wrist.L", [0, 1, 0]),
        (turn("shoulder.R", "x", -90), "upperarm01.R", "wrist.R", [0, -1, 0]),
        (turn("shoulder.L", "z", 60), "upperarm01.L", "wrist.L", [np.sin(np.pi / 3), 0, -0.5]),
        (turn("hip.R", "z", 60), "upperleg01.R", "lowerleg01.R", [np.sin(np.pi / 3), 0, -0.5]),
        (turn("hip.L", "x", 40), "upperleg01.L", "lowerleg01.L", [0, np.sin(np.radians(40)), -np.cos(np.radians(40))]),
        ((JOINTS["knee.L"][1], -np.pi / 2), "lowerleg01.L", "foot.L", [-1, 0, 0]),
        ((JOINTS["elbow.R"][1], np.pi / 2), "lowerarm01.R", "wrist.R", [1, 0, 0]),
    ],
    ids=["arm left", "arm right", "arm ahead", "leg ahead", "leg aside", "knee", "elbow"],
)
def test_single_turns(tmp_path, change, start, end, expected):
    """One source joint turned by hand: the rig's limb points where it must, within two degrees."""
    positions, _ = retargeted(tmp_path, [change])
    assert angle(limb(positions, start, end), expected) < 2


def test_chest_turn_is_shared_by_the_spine(tmp_path):
    """Thirty degrees of bending become about ten at each of three spine bones."""
    bend = turn("chest", "z", -30)
    positions, report = retargeted(tmp_path, [bend])
    shares = [positions[0, RIG.joint_names.index(f"{bone}_y")] for bone in ("spine05", "spine03", "spine02")]
    np.testing.assert_allclose(np.degrees(shares), 10, atol=0.5)
    assert report["spine02"][1] < 1


def test_limits_hold_and_are_reported(tmp_path):
    """A head turned backwards cannot be followed: limits hold, the report says by how much it is missed."""
    turned = turn("neck", "y", 150)
    positions, report = retargeted(tmp_path, [turned])
    assert (positions >= RIG.lower).all()
    assert (positions <= RIG.upper).all()
    assert report["head"][0] > 80
    assert report["at_limit"] > 0


def test_clip_faces_x_stands_on_the_floor_and_closes(tmp_path):
    """A cycle that starts turned away: its first frame faces X, the lowest vertex is near Z = 0, the ends meet."""
    leaning = [turn("root", "y", 90), turn("hip.L", "z", 20)]
    straight = [turn("root", "y", 90)]
    path = clip(
        tmp_path / "a.txt", leaning, straight, straight, [turn("root", "y", 90), turn("hip.L", "z", 25)], loop="wrap"
    )
    motion, _ = prepare_motion(path, "sway", rig=RIG)
    assert motion.rate_hz == 60.0
    assert motion.frame_count == 7
    np.testing.assert_allclose(np.abs(motion.root_orientation[0]), [0, 0, 0, 1], atol=1e-5)
    assert motion.is_cycle
    assert 0.8 < motion.root_position[0, 2] < 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"Loop": "wrap"}', "not a DeepMimic clip"),
        ('{"Frames": [[1, 2], [3, 4]]}', r"\(2, 2\); expected \(T, 44\)"),
        (json.dumps({"Frames": [STANDING.tolist()]}), "T > 1"),
        (json.dumps({"Frames": [[t, *STANDING[1:]] for t in (0.1, 0.2, 0.1)]}), "durations differ"),
    ],
)
def test_clips_that_cannot_be_read(tmp_path, text, message):
    """Foreign content, frames of another size, one frame, an uneven rate."""
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_clip(path)
