"""The calibration pose that a clip opens with: of the whole body or of one limb, held or for one frame."""

from __future__ import annotations

import lzma
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physkin_core.motion.calibration_pose import LIMBS, calibration_frames
from physkin_core.motion.clip_retargeting import find_joints
from physkin_core.motion.mocap_files import Joint, Skeleton, read_amc, read_bvh
from physkin_core.motion.source_clip import SourceClip

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


def skeleton(angles: dict[str, np.ndarray]) -> Skeleton:
    """Of the joints that calibration is looked for in."""
    above = dict(zip(list(JOINTS)[1:], JOINTS, strict=False)) | {"root": None} | CARRIED_BY
    return Skeleton(
        tuple(
            Joint(part, -1 if above[part] is None else JOINTS[above[part]], np.zeros(3), "ZXY", angles[part])
            for part in JOINTS
        ),
        RATE_HZ,
    )


def held(angles: dict[str, np.ndarray], limb: str, frames: int) -> dict[str, np.ndarray]:
    """The same with a limb stretched out in the first frames, from where it drops at once."""
    first = LIMBS[limb][1][0]
    its = angles[first].copy()
    its[:frames] = its[frames] + [80.0, 0.0, 0.0]
    return angles | {first: its}


def test_motion_has_no_calibration_pose(walker):
    """Also where it holds still, and then sets out as fast as a body can."""
    assert calibration_frames(skeleton(walker).clip(), JOINTS) == (0, [])
    still = walker | {"shoulder.L": np.maximum(np.arange(120)[:, None] - 60, 0) * [10.0, 0.0, 0.0]}  # 1200 degrees/s
    assert calibration_frames(skeleton(still).clip(), JOINTS) == (0, [])


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("frames", [1, HELD_FRAMES])
def test_one_limb_is_found(limb, frames, walker):
    """The rest of the body is in motion, and that is kept from the frame on in which the limb drops."""
    assert calibration_frames(skeleton(held(walker, limb, frames)).clip(), JOINTS) == (frames, [limb])


def test_the_last_limb_counts(walker):
    """Arms that drop in different frames are both gone."""
    angles = held(held(walker, "left arm", HELD_FRAMES), "right arm", HELD_FRAMES + 3)
    assert calibration_frames(skeleton(angles).clip(), JOINTS) == (HELD_FRAMES + 3, ["left arm", "right arm"])


def test_blending_that_pauses_is_left_out_to_its_end(walker):
    """Some files blend with a curve that overshoots, and so stands still for a frame on its way."""
    angles = held(walker, "right arm", 1)
    its = angles["shoulder.R"]
    its[1:7] = its[7] + np.array([60.0, 30.0, 4.0, 4.0, 8.0, 4.0])[:, None] * [1.0, 0.0, 0.0]
    assert calibration_frames(skeleton(angles).clip(), JOINTS) == (7, ["right arm"])


def test_clip_that_ends_with_the_jump_is_kept(walker):
    """Nothing would be left of it."""
    angles = {part: its[: HELD_FRAMES + 4] for part, its in held(walker, "left arm", HELD_FRAMES).items()}
    assert calibration_frames(skeleton(angles).clip(), JOINTS) == (0, [])


@pytest.mark.skipif(not CLIPS.is_dir(), reason="clips of the CMU database beside the repository are absent")
@pytest.mark.parametrize("name", ["02_02.amc", "01_01.amc.xz"])
def test_recorded_motion_is_kept_and_arms_held_in_it_are_found(name):
    """Anywhere in a clip, were it cut there."""
    skeleton, clip, joints = recorded(name)
    starts = [clip.at(slice(k, None)) for k in range(0, clip.frame_count - 100, 170)]
    assert all(calibration_frames(each, joints) == (0, []) for each in starts)
    arms = {joint for side in "LR" for joint in (joints[f"shoulder.{side}"], joints[f"elbow.{side}"])}
    frozen = np.maximum(np.arange(clip.frame_count) - HELD_FRAMES, 0) + HELD_FRAMES
    posed = []
    for k, joint in enumerate(skeleton.joints):
        angles = joint.angles[frozen]
        angles[:HELD_FRAMES] = 0.0 if k in arms else joint.angles[:HELD_FRAMES]
        posed.append(replace(joint, angles=angles))
    count, limbs = calibration_frames(Skeleton(tuple(posed), clip.rate_hz).clip(), joints)
    assert count in (HELD_FRAMES, HELD_FRAMES + 1) and limbs == ["left arm", "right arm"]


@pytest.mark.skipif(not CLIPS.is_dir(), reason="clips of the CMU database beside the repository are absent")
@pytest.mark.parametrize("name", ["salsa_01", "indian_06", "martial_03"])
def test_recorded_calibration_is_left_out(name):
    """The release for DAZ opens with a T-pose, which it blends into the motion with a curve that overshoots."""
    _, clip, joints = recorded(f"cmu_daz_{name}.bvh.xz")
    count, limbs = calibration_frames(clip, joints)
    assert count == 8 and "trunk" in limbs
    assert calibration_frames(clip.at(slice(count, None)), joints) == (0, [])


def recorded(name: str) -> tuple[Skeleton, SourceClip, dict[str, int]]:
    path = CLIPS / name
    text = lzma.open(path, "rt").read() if path.suffix == ".xz" else path.read_text()
    is_bvh, bones = ".bvh" in name, CLIPS / f"{name[:2]}.asf"
    skeleton = read_bvh(text) if is_bvh else read_amc(text, bones.read_text(), RATE_HZ)
    clip = skeleton.clip()
    return skeleton, clip, find_joints(clip)[0]
