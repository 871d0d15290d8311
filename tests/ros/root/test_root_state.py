"""What a frame is given of a root, draped beside outfits that are told the same times and roots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_avatar, random_model, tube
from root_messages import pose as pose_message
from scipy.spatial.transform import Rotation

from physkin_core import FrameInput, Outfit
from physkin_core.sway.frame_input import STANDARD_GRAVITY
from physkin_ros.root.gravity import FRESH, EffectiveGravity
from physkin_ros.root.root_orientation import RootOrientation
from physkin_ros.root.root_state import RootState

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)
MILLISECOND = 1_000_000
TIMES = np.cumsum([1000, *[16] * 12, 0, 16, 16, 50, 7, 400, *[16] * 6, -5000, *[33] * 8]) * MILLISECOND
"""Stamps [ns]: frames at several rates, a doubled one, a gap, a clock that goes back."""


@pytest.fixture(scope="module")
def outfit():
    """Two garments over each other, the inner one with a sway network."""
    rng = np.random.default_rng(4)
    inner = random_model(rng, garment=tube(radius=0.1), learnt_sway=True)
    outer = random_model(rng, rig=inner.rig, garment=tube(radius=0.4))
    models = [replace(model, name=f"radius {k}") for k, model in enumerate((inner, outer))]
    return Outfit(models, random_avatar(rng, inner.rig), precision="fp32", hide_covered=False)


class Worn:
    """An outfit that is draped by what a root's state says. down: the last direction that its poses gave."""

    def __init__(self, outfit: Outfit) -> None:
        self.outfit, self.down = outfit.twin(), DOWN
        self.state = RootState(DOWN, FrameInput(len(outfit.layers)))
        self._orientation = RootOrientation(
            self._on_down, lambda motion, stamp: self.state.add_motion(motion, stamp, 0)
        )
        self._pose = np.zeros(len(outfit.joint_names), dtype=np.float32)
        self._outs = [np.zeros((layer.vertex_count, 6), dtype=np.float32) for layer in outfit.layers]
        self._step = self.outfit.bind_frame(self._pose, self.state.frame_input.rows, self._outs)

    def _on_down(self, down, stamp) -> None:
        self.down = down

    def move(self, stamp: int, place, turn) -> None:
        self._orientation.pose(pose_message(1e-9 * stamp, place, turn))

    def drape(self, stamp: int, pose) -> list[np.ndarray]:
        self.state.take(stamp, 0)
        self.state.begin_frame(*divmod(stamp, 10**9))
        self._pose[:] = pose
        self._step()
        return [out.copy() for out in self._outs]


def frames(rig):
    """Stamp [ns], joint positions (d,), place and quaternion of a root that moves on, and is put elsewhere once."""
    for k, stamp in enumerate(TIMES.tolist()):
        turn = Rotation.from_euler("zyx", (0.05 * k, 0.3 * np.sin(0.2 * k), 0.1)).as_quat().tolist()
        positions = rig.rest + 0.1 * np.sin(0.3 * k + np.arange(len(rig.rest)))
        yield stamp, positions.astype(np.float32), (0.02 * k + 5.0 * (k > 6), 0.1 * np.sin(0.4 * k), 0.9), turn


def difference(clouds, others) -> float:
    return max(np.abs(cloud - other)[:, :3].max() for cloud, other in zip(clouds, others))


@pytest.mark.parametrize("windy", [False, True])
@pytest.mark.parametrize("amounts", [[(1.0, 1.0)], [(0.4, 1.0)], [(1.0, 0.3), (0.3, 1.0), (0.0, 0.0)]])
def test_cloth_moves_as_that_of_an_outfit_told_time_and_root(outfit, amounts, windy):
    """Bit for bit, with a network and without; each garment sways by itself, and amount and wind may change."""
    worn, told, alone, moved = Worn(outfit), outfit.twin(), outfit.twin(), 0.0
    for k, (stamp, pose, place, turn) in enumerate(frames(outfit.rig)):
        worn.state.frame_input.sway = told.sway = amounts[k // 4 % len(amounts)]
        worn.state.frame_input.wind = told.wind = (-5.0 * windy, 2.0 * np.sin(k) * windy, 0.0)
        worn.move(stamp, place, turn)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, time=1e-9 * stamp, root=(*place, *turn))):
            np.testing.assert_array_equal(cloud, expected)
        moved = max(moved, difference(clouds, alone.drape(pose, worn.down)))
    assert moved > 0.005, "nothing moves"


def test_without_a_root_joints_alone_swing_it(outfit):
    worn, told, alone, swung = Worn(outfit), outfit.twin(), outfit.twin(), 0.0
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        down = np.array([0.6 * (k > 9), 0, -0.8 - 0.2 * (k <= 9)], dtype=np.float32)
        worn.state.add_direction(down, stamp)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, down, time=1e-9 * stamp)):
            np.testing.assert_array_equal(cloud, expected)
        swung = max(swung, difference(clouds, alone.drape(pose, down)))
    assert swung > 0.01


def test_effective_gravity_swings_cloth_as_that_of_an_outfit(outfit):
    """Bit for bit, as it changes; when it is old, gravity alone counts again."""
    worn, told, alone, swung = Worn(outfit), outfit.twin(), outfit.twin(), 0.0
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        felt = np.array([2.0 * np.sin(k), 1.0, -10.8])
        worn.state.add_motion(EffectiveGravity(felt, STANDARD_GRAVITY * DOWN), stamp, now_ns=0)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, effective_gravity=felt, time=1e-9 * stamp)):
            np.testing.assert_allclose(cloud, expected, atol=1e-6)  # the share of 1 is taken in another order
        swung = max(swung, difference(clouds, alone.drape(pose, effective_gravity=felt)))
    assert swung > 0.01
    np.testing.assert_array_equal(worn.state.take(stamp, FRESH + 1)[0], DOWN)


def test_an_acceleration_is_felt_as_much_as_garments_sway(outfit):
    state, at_rest = Worn(outfit).state, STANDARD_GRAVITY * np.array([0.6, 0, -0.8])
    state.frame_input.sway, felt = (1.0, 0.25), at_rest + np.array([4.0, 0.0, 2.0])
    state.add_motion(EffectiveGravity(felt, at_rest), 0, now_ns=0)
    expected = [(at_rest + share * (felt - at_rest)) / STANDARD_GRAVITY for share in (1, 0.25)]
    np.testing.assert_allclose(state.take(0, 0), expected, rtol=1e-6)


def test_without_sway_every_frame_is_draped_by_itself(outfit):
    """Bit for bit, also right after the amount has changed; and without stamps."""
    worn, alone = Worn(outfit), outfit.twin()
    for k, (stamp, pose, place, turn) in enumerate(frames(outfit.rig)):
        worn.move(stamp, place, turn)
        if k in (10, 20):
            worn.state.frame_input.sway = (float(k == 20),) * 2
        clouds = worn.drape(stamp if k < 20 else 0, pose)
        expected = alone.drape(pose, worn.state.frame_input.rows[0, :3])
        assert np.array_equal(clouds[0], expected[0]) == (k >= 10)
        if k != 13:  # a doubled stamp says again what it said
            np.testing.assert_allclose(worn.state.frame_input.rows[0, :3], worn.down, atol=1e-6)


def test_directions_go_with_joint_states_by_their_stamps():
    """The last known where none has come; another as of now ends those before; how the root moves counts first."""
    state = RootState(np.array([0.0, 0.0, -3.0]), FrameInput(1))
    assert state.take(5, 0)[0].tolist() == state.direction(5).tolist() == [0, 0, -1]
    state.add_direction(np.float32([1, 0, 0]), 1000)
    state.add_direction(np.float32([0, 1, 0]), 2000)
    assert state.take(1500, 0)[0].tolist() == [1, 0, 0]
    state.set_direction(np.array([0.0, -7.0, 0.0]))
    assert state.take(1500, 0)[0].tolist() == [0, -1, 0]
    state.add_motion(EffectiveGravity(np.zeros(3), np.zeros(3)), 1500, now_ns=0)
    assert state.motion(0) is not None and state.motion(FRESH + 1) is None
    assert not state.take(1500, 0).any()
    assert state.take(1500, FRESH + 1)[0].tolist() == [0, -1, 0]


def test_gravity_of_a_frame_between_two_joint_states():
    """Wind is added to it, in each frame once; what was taken goes on."""
    state = RootState(DOWN, FrameInput(2))
    state.frame_input.wind = (3.0, 0.0, 0.0)
    state.take(1, 0)
    for _ in range(3):
        state.begin_frame(0, 0, np.float32([[0, 0, -0.5], [0, 0, -0.25]]))
        np.testing.assert_allclose(state.frame_input.rows[:, 0] * STANDARD_GRAVITY, 6, rtol=1e-6)
        np.testing.assert_allclose(state.frame_input.rows[:, 2], [-0.5, -0.25])
