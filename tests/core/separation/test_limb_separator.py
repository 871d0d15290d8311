"""Limbs are separated on the body that is there: as much as needed, smoothly, within limits, where they meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_rig

from physkin_core import AvatarWarning, LimbSeparator, load_motion
from physkin_core.check.likeness import body_overlap
from physkin_core.separation.limb_separator import separated_motion


@pytest.fixture(scope="module")
def separators(bodies, rig):
    return {name: LimbSeparator(rig, avatar) for name, avatar in bodies.items()}


def test_forearms_leave_a_stout_belly(bodies, separators, rig, arms_down):
    """They are inside it hardly more than at rest afterwards; a lean body in the same pose is moved less."""
    shares = {}
    for name, avatar in bodies.items():
        after, change = separators[name].separate(arms_down)
        poses = rig.rest, arms_down, after
        shares[name] = [body_overlap(avatar, rig, [pose]) for pose in poses]
        assert change == pytest.approx(np.abs(after - arms_down).max())
    rest, before, after = shares["stout"]
    assert before > rest + 2 and after < rest + 0.25 * (before - rest)
    lean, stout = (np.abs(separators[name].separate(arms_down)[0] - arms_down).max() for name in ("lean", "stout"))
    assert lean < 0.3 * stout and 0.05 < stout < 0.6


def test_only_arms_and_legs_are_moved(separators, rig, arms_down):
    """The trunk, the head and the wrists stay as they were given."""
    after, _ = separators["stout"].separate(arms_down)
    moved = {rig.joint_names[joint] for joint in np.flatnonzero(after != arms_down)}
    assert moved and all(name.startswith(("upperarm", "lowerarm", "upperleg", "lowerleg")) for name in moved)
    assert not any(name.startswith("lowerarm02") for name in moved)


def test_free_poses_stay_as_they_are(separators, rig):
    """The canonical pose, which may touch, on every body; raised arms on a stout one. To the last bit."""
    for separator in separators.values():
        after, change = separator.separate(rig.rest)
        assert change == 0 and np.array_equal(after, rig.rest.astype(np.float32))
    raised = rig.joint_positions({"upperarm01.L_x": 0.8, "upperarm01.R_x": -0.8}).astype(np.float32)
    after, change = separators["stout"].separate(raised)
    assert change == 0 and np.array_equal(after, raised)


def test_legs_give_way_to_legs_alone(separators, rig):
    """Legs that cross are parted by both; a hand in a thigh is taken out by the arm."""
    crossed = rig.joint_positions({"upperleg01.L_x": -0.15, "upperleg01.R_x": 0.15}).astype(np.float32)
    after, _ = separators["stout"].separate(crossed)
    left, right = (after[rig.joint_names.index(f"upperleg01.{side}_x")] for side in "LR")
    assert left > -0.15 and right < 0.15 and left == pytest.approx(-right, abs=0.05)
    sitting = rig.joint_positions(
        {"upperleg01.L_y": -1.5, "lowerleg01.L_y": 1.5, "upperarm01.L_x": -0.6, "lowerarm01.L_z": -0.6}
    ).astype(np.float32)
    after, change = separators["stout"].separate(sitting)
    moved = {rig.joint_names[joint] for joint in np.flatnonzero(np.abs(after - sitting) > 0.01)}
    assert change > 0.01 and not any("leg" in name for name in moved)


def test_limits_are_kept(separators, rig):
    """In any pose; a position that was given beyond its limits does not go farther."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        pose = rng.uniform(rig.lower - 0.1, rig.upper + 0.1).astype(np.float32)
        after, _ = separators["stout"].separate(pose)
        assert (after >= np.minimum(rig.lower, pose) - 1e-6).all() and (
            after <= np.maximum(rig.upper, pose) + 1e-6
        ).all()


def test_smooth_motion_stays_smooth(separators, rig):
    """Second differences at 60 Hz grow by a tenth at most, though the arms are moved far; and no step jumps."""
    motion = load_motion("walk")
    given = motion.positions_for(rig).astype(np.float32)
    after = np.array([separators["stout"].separate(pose)[0] for pose in given])
    rough, smooth = (np.abs(np.diff(poses, n=2, axis=0)) for poses in (after, given))
    assert np.abs(after - given).max() > 0.1
    assert rough.mean() < 1.1 * smooth.mean() and np.abs(np.diff(after - given, axis=0)).max() < 0.1


def test_the_result_is_continuous(separators, rig, arms_down):
    """A small change of the pose makes a small change of the result, on the way from free to deep inside."""
    way = np.linspace(0, 1, 2000)[:, None]
    poses = (rig.rest + way * (arms_down - rig.rest)).astype(np.float32)
    after = np.array([separators["stout"].separate(pose)[0] for pose in poses])
    assert np.abs(np.diff(after, axis=0)).max() < 6 * np.abs(np.diff(poses, axis=0)).max()


def test_bad_input_is_refused(bodies, rig):
    """Naming it; what was in `out` stays."""
    separator = LimbSeparator(rig, bodies["average"])
    bad = rig.rest.astype(np.float32).copy()
    bad[3] = np.nan
    out = np.full(len(bad), 7, dtype=np.float32)
    with pytest.raises(ValueError, match=r"joint_positions\[3\] is nan"):
        separator.separate(bad, out=out)
    assert (out == 7).all()
    with pytest.raises(ValueError, match=r"have shape \(3,\), expected \(52,\)|have shape \(3,\)"):
        separator.separate(np.zeros(3))


def test_a_body_of_another_rig_is_refused(bodies):
    with pytest.raises(ValueError, match="36 bones, the rig 5"):
        LimbSeparator(random_rig(np.random.default_rng(0)), bodies["average"])


def test_a_motion_is_separated_frame_by_frame(bodies, separators, rig):
    """For the rig's joints, in their order; time and root are as they were."""
    walk = load_motion("walk")
    short = replace(
        walk, **{name: getattr(walk, name)[:20] for name in ("positions", "root_position", "root_orientation")}
    )
    apart = separated_motion(short, rig, bodies["stout"])
    assert apart.joint_names == rig.joint_names and apart.rate_hz == walk.rate_hz
    np.testing.assert_array_equal(apart.root_orientation, short.root_orientation)
    expected = [separators["stout"].separate(pose)[0] for pose in short.positions_for(rig)]
    np.testing.assert_array_equal(apart.positions, expected)
    assert np.abs(apart.positions - short.positions_for(rig)).max() > 0.1


def test_limbs_that_are_left_out_are_told(bodies, rig):
    """A limb without joints: kept by the separator, issued for a motion."""
    stiff = replace(rig, dofs=tuple(dof for dof in rig.dofs if not dof.bone.startswith(("upperleg", "lowerleg"))))
    told = LimbSeparator(stiff, bodies["average"]).warnings
    assert len(told) == 2 and "left leg is not separated" in told[0]
    with pytest.warns(AvatarWarning, match="left leg is not separated"):
        separated_motion(load_motion("walk"), stiff, bodies["average"])
