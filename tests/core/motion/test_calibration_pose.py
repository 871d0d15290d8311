"""The calibration pose that a clip opens with: of the whole body or of one limb, held or for one frame."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.motion.amc_file import read_amc
from physkin_core.motion.bvh_file import read_bvh
from physkin_core.motion.calibration_pose import LIMBS, calibration_frames
from physkin_core.motion.clip_retargeting import find_joints
from physkin_core.motion.source_clip import SourceClip, posed_clip

RATE_HZ = 120.0
CLIPS = Path(__file__).parents[4] / "shared/assets/motion"
HELD_FRAMES = 48  # 0.4 s
JOINTS = {part: k for k, part in enumerate(dict.fromkeys(part for _, parts in LIMBS.values() for part in parts))}
CARRIED_BY = {parts[0]: carrier for carrier, parts in LIMBS.values()} | {"chest": "root", "neck": "chest"}


@pytest.fixture
def walker() -> dict[str, np.ndarray]:
    """Angles [degrees] of one second, by joint: all swing by 30 degrees."""
    seconds = np.arange(120) / RATE_HZ
    return {part: 30 * np.sin(seconds + k)[:, None] * [1.0, 0.3, 0.2] for part, k in JOINTS.items()}


def posed(angles: dict[str, np.ndarray]) -> SourceClip:
    """Of the joints that calibration is looked for in."""
    above = dict(zip(list(JOINTS)[1:], JOINTS, strict=False)) | {"root": None} | CARRIED_BY
    parents = [-1 if above[part] is None else JOINTS[above[part]] for part in JOINTS]
    turns = [Rotation.from_euler("ZXY", angles[part], degrees=True) for part in JOINTS]
    return posed_clip(list(JOINTS), parents, np.zeros((len(JOINTS), 3)), turns, {}, len(turns[0]), RATE_HZ)


def held(angles: dict[str, np.ndarray], limb: str, frames: int) -> dict[str, np.ndarray]:
    """The same with a limb stretched out in the first frames, from where it drops at once."""
    first = LIMBS[limb][1][0]
    its = angles[first].copy()
    its[:frames] = its[frames] + [80.0, 0.0, 0.0]
    return angles | {first: its}


def test_motion_has_no_calibration_pose(walker):
    """Also where it holds still, and then sets out as fast as a body can."""
    assert calibration_frames(posed(walker), JOINTS) == (0, [])
    still = walker | {"shoulder.L": np.maximum(np.arange(120)[:, None] - 60, 0) * [10.0, 0.0, 0.0]}  # 1200 degrees/s
    assert calibration_frames(posed(still), JOINTS) == (0, [])


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("frames", [1, HELD_FRAMES])
def test_one_limb_is_found(limb, frames, walker):
    """The rest of the body is in motion, and that is kept from the frame on in which the limb drops."""
    assert calibration_frames(posed(held(walker, limb, frames)), JOINTS) == (frames, [limb])


def test_the_last_limb_counts(walker):
    """Arms that drop in different frames are both gone."""
    angles = held(held(walker, "left arm", HELD_FRAMES), "right arm", HELD_FRAMES + 3)
    assert calibration_frames(posed(angles), JOINTS) == (HELD_FRAMES + 3, ["left arm", "right arm"])


def test_blending_that_pauses_is_left_out_to_its_end(walker):
    """Some files blend with a curve that overshoots, and so stands still for a frame on its way."""
    angles = held(walker, "right arm", 1)
    its = angles["shoulder.R"]
    its[1:7] = its[7] + np.array([60.0, 30.0, 4.0, 4.0, 8.0, 4.0])[:, None] * [1.0, 0.0, 0.0]
    assert calibration_frames(posed(angles), JOINTS) == (7, ["right arm"])


def test_clip_that_ends_with_the_jump_is_kept(walker):
    """Nothing would be left of it."""
    angles = {part: its[: HELD_FRAMES + 4] for part, its in held(walker, "left arm", HELD_FRAMES).items()}
    assert calibration_frames(posed(angles), JOINTS) == (0, [])


@pytest.mark.skipif(not CLIPS.is_dir(), reason="clips of the CMU database beside the repository are absent")
@pytest.mark.parametrize("name", ["02_02.amc", "01_01.amc.xz"])
def test_recorded_motion_is_kept_and_arms_held_in_it_are_found(name):
    """Anywhere in a clip, were it cut there."""
    clip, joints = recorded(name)
    starts = [clip.at(slice(k, None)) for k in range(0, clip.frame_count - 100, 170)]
    assert all(calibration_frames(each, joints) == (0, []) for each in starts)
    arms = {joint for side in "LR" for joint in (joints[f"shoulder.{side}"], joints[f"elbow.{side}"])}
    frozen = np.maximum(np.arange(clip.frame_count) - HELD_FRAMES, 0) + HELD_FRAMES
    turns = []
    for k, parent in enumerate(clip.parents):
        turn = (clip.turned(parent).inv() * clip.turned(k) if parent >= 0 else clip.turned(k))[frozen]
        held_turns = np.where(np.arange(len(frozen))[:, None] < HELD_FRAMES, [0.0, 0.0, 0.0, 1.0], turn.as_quat())
        turns.append(Rotation.from_quat(held_turns) if k in arms else turn)
    offsets = np.zeros((len(turns), 3))
    frozen_clip = posed_clip(clip.names, clip.parents, offsets, turns, {}, len(frozen), clip.rate_hz)
    count, limbs = calibration_frames(frozen_clip, joints)
    assert count in (HELD_FRAMES, HELD_FRAMES + 1) and limbs == ["left arm", "right arm"]


@pytest.mark.skipif(not CLIPS.is_dir(), reason="clips of the CMU database beside the repository are absent")
@pytest.mark.parametrize("name", ["salsa_01", "indian_06", "martial_03"])
def test_recorded_calibration_is_left_out(name):
    """The release for DAZ opens with a T-pose, which it blends into the motion with a curve that overshoots."""
    clip, joints = recorded(f"cmu_daz_{name}.bvh.xz")
    count, limbs = calibration_frames(clip, joints)
    assert count == 8 and "trunk" in limbs
    assert calibration_frames(clip.at(slice(count, None)), joints) == (0, [])


def recorded(name: str) -> tuple[SourceClip, dict[str, int]]:
    path = CLIPS / name
    text = lzma.open(path, "rt").read() if path.suffix == ".xz" else path.read_text()
    clip = read_bvh(text) if ".bvh" in name else read_amc(text, (CLIPS / f"{name[:2]}.asf").read_text())
    return clip, find_joints(clip)[0]
