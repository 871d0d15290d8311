"""What the page shows, without a page."""

from __future__ import annotations

import os
import shutil
import signal
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest

from physkin_core import (
    BUNDLED_AVATAR,
    Draper,
    LimbSeparator,
    Outfit,
    avatar_from_body,
    load_avatar,
    load_body_model,
    load_garment_model,
    load_motion,
)
from physkin_core.runtime.bound_garment import plain_skinning
from physkin_core.view.pose_tab import joint_groups
from physkin_core.view.scene import scene_state
from physkin_core.view.scene.motion_player import MotionPlayer
from physkin_core.view.scene.scene_state import SceneState


@pytest.fixture(scope="module")
def shared(asset_loader):
    """One T-shirt, for tests that set all that they need."""
    shared = SceneState(asset_loader, ["tshirt"])
    assert shared.separate_limbs
    shared.wear(separate_limbs=False)
    return shared


@pytest.fixture
def state(shared):
    shared.choose_motion("walk")
    shared.show_plain, shared.speed = False, 1.0
    return shared


def test_frame_is_what_the_core_drapes(state):
    """At a frame of the motion: cloth, body, garment nodes, the root's place in the world, and plain skinning where it
    is asked for."""
    motion = load_motion("walk")
    state.sway = 0.0
    state.scrub(20 / motion.rate_hz)
    frame = state.advance(4.0)
    draper = Draper(load_garment_model("tshirt"), load_avatar(BUNDLED_AVATAR, state.rig))
    positions = motion.positions_for(state.rig)[20]
    np.testing.assert_allclose(frame.cloth[0], draper.drape(positions, motion.gravity[20]), atol=1e-5)
    bones = draper.bone_transforms(positions)
    body = state.outfit.body_to_draw.posed_vertices(bones)
    np.testing.assert_allclose(frame.body, body, atol=1e-5)
    np.testing.assert_allclose(frame.nodes[0], draper.node_transforms()[..., 3], atol=1e-5)
    np.testing.assert_allclose(frame.pose.root_orientation, motion.root_orientation[20], atol=1e-5)
    way = frame.pose.root_position / motion.root_position[20]
    assert way[0] == pytest.approx(way[2], abs=1e-3) and 0.8 < way[2] < 1.2
    assert frame.plain == () and frame.microseconds > 0
    assert abs(frame.body[:, 2].min() + frame.pose.root_position[2]) < 0.04, "soles stay on the floor"
    assert state.advance(0.1) is None, "nothing is drawn twice"
    state.show_plain = True
    state.redraw()
    np.testing.assert_allclose(state.advance(0.1).plain[0], plain_skinning(draper.bound, bones), atol=1e-5)


def test_motion_plays_at_its_speed_and_begins_anew(state):
    state.play()
    state.speed = 0.5
    state.advance(0.4)
    assert state.seconds == pytest.approx(0.2)
    state.advance(2 * state.duration)
    assert state.seconds == pytest.approx(0.2, abs=1e-6)
    state.choose_motion(None)
    with pytest.raises(ValueError, match="choose a motion"):
        state.play()
    assert state.duration == 0 and state.motion is None and not state.playing


def test_cloth_sways_and_settles(state):
    """Playing, as an outfit that is told time and root; paused, it moves on for some seconds, then no more is given."""
    motion = load_motion("walk")
    state.scrub(0.0)
    state.speed, state.sway = 1.0, 1.0
    state.outfit.reset()
    state.play()
    frames = [state.advance(1 / motion.rate_hz).cloth[0].copy() for _ in range(12)]
    same = Outfit([load_garment_model("tshirt")], load_avatar(BUNDLED_AVATAR, state.rig))
    scale = state.pose.root_position[2] / motion.root_position[12, 2]
    for k in range(1, 13):
        root = [*(scale * motion.root_position[k]), *motion.root_orientation[k]]
        cloth = same.drape(motion.positions_for(state.rig)[k], time=motion.times[k], root=root)[0]
    np.testing.assert_allclose(frames[-1], cloth, atol=2e-4)
    state.pause()
    moved = [state.advance(0.1) for _ in range(40)]
    assert moved[5] is not None and moved[-1] is None
    state.sway = 0.0


def test_wind_blows_along_the_floor_though_the_motion_stands(state):
    """Until cloth has settled in it, then no more frames are given."""
    state.pause(), state.rest()
    still = state.advance(10.0).cloth[0].copy()
    state.blow(-6.0)
    moved = [state.advance(0.1) for _ in range(40)]
    assert (moved[20].cloth[0] - still)[:, 0].mean() < -0.0005
    assert state.outfit.wind == (-6.0, 0.0, 0.0) and moved[-1] is None
    state.blow(0.0)


def test_player_is_smooth_between_frames():
    """Halfway between two frames lies the mean of both; times beyond the ends are the ends."""
    motion, model = load_motion("dance"), load_garment_model("tshirt")
    player = MotionPlayer(motion, model.rig, load_avatar(BUNDLED_AVATAR, model.rig))
    halfway = player.pose(10.5 / motion.rate_hz)
    np.testing.assert_allclose(halfway.positions, motion.positions[10:12].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(halfway.root_orientation), 1.0, atol=1e-9)
    np.testing.assert_allclose(player.pose(5 / motion.rate_hz).root_orientation, motion.root_orientation[5], atol=1e-6)
    np.testing.assert_array_equal(player.pose(-1.0).positions, motion.positions[0])
    np.testing.assert_array_equal(player.pose(99.0).positions, motion.positions[-1])


def test_joint_moves_the_cloth_and_stops_the_motion(state):
    joint = state.rig.joint_names.index("upperarm01.L_x")
    state.play()
    before = state.advance(0.1).cloth[0].copy()
    state.set_joint(joint, state.rig.upper[joint])
    after = state.advance(0.1)
    assert not state.playing and state.posed_by_hand
    assert np.linalg.norm(after.cloth[0] - before, axis=1).max() > 0.02
    state.set_joint(joint, 99.0)
    assert state.pose.positions[joint] == pytest.approx(state.rig.upper[joint], abs=1e-6)
    state.rest()
    np.testing.assert_allclose(state.pose.positions, state.rig.rest, atol=1e-6)


def test_outfit_in_order_with_colours(asset_loader):
    """Garments from the skin outwards, one tucked; a colour that was chosen for a garment stays with it, in another
    place and of another fabric."""
    state = SceneState(asset_loader, ["tshirt", "trousers"], tucked=["tshirt"])
    assert isinstance(state.outfit, Outfit) and [layer.name for layer in state.outfit.layers] == ["tshirt", "trousers"]
    state.recolour(body=(0.1, 0.2, 0.3), cloth=[(1.0, 0.0, 0.0), state.cloth_colours[1]])
    state.wear(["trousers", "tshirt:denim"])
    frame = state.advance(0.0)
    assert state.tucked == frozenset() and frame.colours[2] == (1.0, 0.0, 0.0) and frame.colours[0] == (0.1, 0.2, 0.3)
    assert len(frame.cloth) == 2 and frame.outfit is state.outfit


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda state, folder: state.wear([]), "choose at least one garment"),
        (lambda state, folder: state.wear(["tshirt", "tshirt"]), "tshirt"),
        (lambda state, folder: state.wear(["tshirt"], tucked=["skirt"]), "--tucked skirt: none of the garments"),
        (lambda state, folder: state.wear(["nosuch"]), "no garment model 'nosuch'"),
        (lambda state, folder: state.wear(body=folder / "me.dae"), "the extension '.dae' is unknown"),
        (lambda state, folder: state.wear(body=folder / "broken.glb"), "broken.glb"),
        (lambda state, folder: state.choose_motion(folder / "broken.bvh"), "broken.bvh"),
        (lambda state, folder: state.choose_motion("nosuch"), "no bundled motion 'nosuch'"),
    ],
)
def test_what_cannot_be_shown_changes_nothing(state, change, reason, tmp_path):
    for name in ("broken.glb", "broken.bvh"):
        (tmp_path / name).write_text("nothing of that kind")
    before = (state.outfit, state.garments, state.body, state.motion)
    with pytest.raises(ValueError, match=reason):
        change(state, tmp_path)
    assert (state.outfit, state.garments, state.body, state.motion) == before


def test_another_body(state, tmp_path):
    """A file of one's own under another name; the motion goes on with it."""
    own = tmp_path / "me.glb"
    shutil.copy(BUNDLED_AVATAR, own)
    before = state.outfit
    state.play()
    state.wear(body=own)
    frame = state.advance(0.1)
    assert state.body == own and frame.outfit is state.outfit is not before and state.motion.name == "walk"
    assert state.playing and frame.outfit.avatar.source.endswith("me.glb")
    state.wear(body=BUNDLED_AVATAR)


def test_a_body_that_ends_the_process_that_reads_it_is_refused(asset_loader, shared):
    """In one sentence; what is worn goes on, and the next body is read by another process."""
    told, worn = [], shared.outfit

    def put_on() -> None:
        try:
            shared.wear(body=BUNDLED_AVATAR)
        except ValueError as error:
            told.append(str(error))

    os.kill(asset_loader.pid, signal.SIGSTOP)
    changing = Thread(target=put_on)
    changing.start()
    shared.set_joint(0, 0.1)
    assert shared.advance(0.0).outfit is worn
    os.kill(asset_loader.pid, signal.SIGKILL)
    changing.join(10)
    assert len(told) == 1 and "(SIGKILL)" in told[0]
    shared.set_joint(0, 0.2)
    assert shared.advance(0.0).outfit is worn
    shared.wear(body=BUNDLED_AVATAR)
    assert shared.advance(0.0).outfit is not worn


def test_limbs_are_separated_and_those_left_out_are_told(asset_loader, monkeypatch):
    """What is drawn is the separated pose, of body and cloth."""
    state = SceneState(asset_loader, ["tanktop"])
    state.wear(separate_limbs=True)
    assert state.warnings == state.outfit.warnings
    joint = state.rig.joint_names.index("upperarm01.L_x")
    state.set_joint(joint, -0.9)
    frame = state.advance(0.0)
    expected, change = LimbSeparator(state.rig, state.outfit.avatar).separate(state.pose.positions)
    assert change > 0.05
    np.testing.assert_array_equal(frame.pose.positions, expected)
    np.testing.assert_allclose(frame.body, state.outfit.posed_body(expected), atol=1e-6)
    (alone,) = Outfit([load_garment_model("tanktop")], state.outfit.avatar).drape(expected)
    np.testing.assert_allclose(frame.cloth[0], alone, atol=1e-5)
    from_bound = lambda _: SimpleNamespace(warnings=("a leg is not separated",))  # noqa: E731
    monkeypatch.setattr(scene_state, "LimbSeparator", SimpleNamespace(from_bound=from_bound))
    state.wear(separate_limbs=True)
    assert state.warnings == (*state.outfit.warnings, "a leg is not separated")


def test_tall_bodies_take_longer_steps():
    """By as much as their hips are higher."""
    body, motion = load_body_model(), load_motion("walk")
    height = [-body.vertices(shape)[:, 2].min() for shape in (body.garment_body, 1.5 * body.garment_body)]
    steps = []
    for shape in (body.garment_body, 1.5 * body.garment_body):
        player = MotionPlayer(motion, body.rig, avatar_from_body(body, shape))
        steps.append(player.pose(player.duration).root_position - player.pose(0.0).root_position)
    assert np.linalg.norm(steps[1]) / np.linalg.norm(steps[0]) == pytest.approx(height[1] / height[0], rel=1e-4)
    assert abs(height[1] / height[0] - 1) > 0.005


def test_joints_by_part_of_the_body(shared):
    """Every joint once, collar bones with their arm."""
    groups = joint_groups(shared.rig)
    assert list(groups) == ["trunk", "head and neck", "left arm", "right arm", "left leg", "right leg"]
    assert sorted(joint for joints in groups.values() for joint in joints) == list(range(len(shared.rig.dofs)))
    names = {part: {shared.rig.joint_names[joint] for joint in joints} for part, joints in groups.items()}
    assert "clavicle.L_x" in names["left arm"] and "foot.R_y" in names["right leg"]
    assert "spine03_x" in names["trunk"] and "neck01_x" in names["head and neck"]
