"""What a frame is given of a root, draped beside outfits that are told the same times and roots."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest
from random_models import random_avatar, random_model, tube
from root_messages import header, odometry, vector
from root_messages import pose as pose_message
from scipy.spatial.transform import Rotation

from physkin_core import FrameInput, Outfit
from physkin_core.runtime.frame_input import STANDARD_GRAVITY
from physkin_ros.root.gravity import FRESH, EffectiveGravity
from physkin_ros.root.quaternions import OrientationError
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


class State(RootState):
    """A root's state of so many garments, at a time that does not pass by itself."""

    def __init__(self, garments: int = 1, down=DOWN) -> None:
        self.now = 0
        super().__init__(down, FrameInput(garments), clock=lambda: self.now)

    def move(self, stamp: int, place, turn) -> None:
        self.on_pose(pose_message(1e-9 * stamp, place, turn))

    def fall(self, stamp: int, down) -> None:
        self.on_direction(Message(header=header(1e-9 * stamp), vector=vector([float(number) for number in down])))

    def feel(self, stamp: int, felt, at_rest=STANDARD_GRAVITY * DOWN) -> None:
        """As an IMU says it."""
        self._motions.add(EffectiveGravity(np.array(felt), np.array(at_rest)), stamp, self.now)


class Worn:
    """An outfit that is draped by what a root's state says."""

    def __init__(self, outfit: Outfit) -> None:
        self.outfit, self.state = outfit.twin(), State(len(outfit.layers))
        self._pose = np.zeros(len(outfit.joint_names), dtype=np.float32)
        self._outs = [np.zeros((layer.vertex_count, 6), dtype=np.float32) for layer in outfit.layers]
        self._step = self.outfit.bind_frame(self._pose, self.state.frame_input.rows, self._outs)

    def drape(self, stamp: int, pose) -> list[np.ndarray]:
        self.state.take(stamp)
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
        worn.state.move(stamp, place, turn)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, time=1e-9 * stamp, root=(*place, *turn))):
            np.testing.assert_array_equal(cloud, expected)
        moved = max(moved, difference(clouds, alone.drape(pose, worn.state.direction(0))))
    assert moved > 0.005, "nothing moves"


def test_without_a_root_joints_alone_swing_it(outfit):
    worn, told, alone, swung = Worn(outfit), outfit.twin(), outfit.twin(), 0.0
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        down = np.array([0.6 * (k > 9), 0, -0.8 - 0.2 * (k <= 9)])
        worn.state.fall(stamp, down)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, np.float32(down), time=1e-9 * stamp)):
            np.testing.assert_array_equal(cloud, expected)
        swung = max(swung, difference(clouds, alone.drape(pose, down)))
    assert swung > 0.01


def test_effective_gravity_swings_cloth_as_that_of_an_outfit(outfit):
    """Bit for bit, as it changes; when it is old, gravity alone counts again."""
    worn, told, alone, swung = Worn(outfit), outfit.twin(), outfit.twin(), 0.0
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        felt = np.array([2.0 * np.sin(k), 1.0, -10.8])
        worn.state.feel(stamp, felt)
        clouds = worn.drape(stamp, pose)
        for cloud, expected in zip(clouds, told.drape(pose, effective_gravity=felt, time=1e-9 * stamp)):
            np.testing.assert_allclose(cloud, expected, atol=1e-6)  # the share of 1 is taken in another order
        swung = max(swung, difference(clouds, alone.drape(pose, effective_gravity=felt)))
    assert swung > 0.01
    worn.state.now += FRESH + 1
    np.testing.assert_array_equal(worn.state.take(stamp)[0], DOWN)


def test_an_acceleration_is_felt_as_much_as_garments_sway():
    state, at_rest = State(2), STANDARD_GRAVITY * np.array([0.6, 0, -0.8])
    state.frame_input.sway, felt = (1.0, 0.25), at_rest + np.array([4.0, 0.0, 2.0])
    state.feel(0, felt, at_rest)
    expected = [(at_rest + share * (felt - at_rest)) / STANDARD_GRAVITY for share in (1, 0.25)]
    np.testing.assert_allclose(state.take(0), expected, rtol=1e-6)


def test_without_sway_every_frame_is_draped_by_itself(outfit):
    """Bit for bit, also right after the amount has changed; and without stamps."""
    worn, alone = Worn(outfit), outfit.twin()
    for k, (stamp, pose, place, turn) in enumerate(frames(outfit.rig)):
        worn.state.move(stamp, place, turn)
        if k in (10, 20):
            worn.state.frame_input.sway = (float(k == 20),) * 2
        clouds = worn.drape(stamp if k < 20 else 0, pose)
        expected = alone.drape(pose, worn.state.frame_input.rows[0, :3])
        assert np.array_equal(clouds[0], expected[0]) == (k >= 10)
        if k != 13:  # a doubled stamp says again what it said
            np.testing.assert_allclose(worn.state.frame_input.rows[0, :3], worn.state.direction(0), atol=1e-6)


def test_directions_go_with_joint_states_by_their_stamps():
    """The last known where none has come; another as of now ends those before; how the root moves counts first."""
    state = State(down=[0.0, 0.0, -3.0])
    assert state.take(5)[0].tolist() == state.direction(5).tolist() == [0, 0, -1]
    state.fall(1000, [2, 0, 0])
    state.fall(2000, [0, 0.1, 0])
    assert state.take(1500)[0].tolist() == [1, 0, 0]
    state.set_direction([0.0, -7.0, 0.0])
    assert state.take(1500)[0].tolist() == [0, -1, 0]
    state.feel(1500, [0, 0, 0], [0, 0, 0])
    assert state.motion() is not None and not state.take(1500).any()
    state.now += FRESH + 1
    assert state.motion() is None and state.take(1500)[0].tolist() == [0, -1, 0]


def test_gravity_of_a_frame_between_two_joint_states():
    """Wind is added to it, in each frame once; what was taken goes on."""
    state = State(2)
    state.frame_input.wind = (3.0, 0.0, 0.0)
    state.take(1)
    for _ in range(3):
        state.begin_frame(0, 0, np.float32([[0, 0, -0.5], [0, 0, -0.25]]))
        np.testing.assert_allclose(state.frame_input.rows[:, 0] * STANDARD_GRAVITY, 6, rtol=1e-6)
        np.testing.assert_allclose(state.frame_input.rows[:, 2], [-0.5, -0.25])


def row_of(state: State) -> np.ndarray:
    """What a garment is given (13,) of the latest motion."""
    state.take(0)
    return state.frame_input.rows[0].copy()


LEANING = (0.0, np.sin(0.2), 0.0, np.cos(0.2))
LEANING_DOWN = [np.sin(0.4), 0, -np.cos(0.4)]


def test_a_pose_or_odometry_is_the_same_as_time_and_root():
    """Bit for bit; a quaternion a little off is taken as it is meant; without stamp, or when the root is to be still,
    the direction alone."""
    state, told = State(), FrameInput(1)
    for k in range(30):
        stamp, place = 10**9 + k * 10**9 // 60, (k * k / 900, 0.0, 1.0)
        if k % 2:
            state.move(stamp, place, LEANING)
        else:
            state.on_odometry(odometry(1e-9 * stamp, place, LEANING))
        told.set_root(1e-9 * stamp, np.array([*place, *LEANING]))
        np.testing.assert_array_equal(row_of(state), told.rows[0])
        np.testing.assert_allclose(state.direction(0), LEANING_DOWN, rtol=1e-6)
    assert told.rows[0, 7] > 1, "it is fast by now"
    state.move(stamp, place, tuple(1.01 * number for number in LEANING))
    np.testing.assert_allclose(state.direction(0), LEANING_DOWN, rtol=1e-6)
    state.now += FRESH + 1
    state.move(0, place, LEANING)
    assert state.motion() is None
    state.still()
    state.move(2 * 10**9, place, LEANING)
    assert state.motion() is None


def test_stamps_of_poses():
    """A doubled message says the same again; a late one is told; a clock that begins anew is followed."""
    state = State()
    for place in ((0, 0, 0), (1, 0, 0)):
        rows = []
        for _ in range(2):
            state.move(10 * 10**9, place, LEANING)
            rows.append(row_of(state))
        np.testing.assert_array_equal(*rows)
    with pytest.raises(OrientationError, match="stamped 0.250 s back"):
        state.move(9_750_000_000, (0, 0, 0), LEANING)
    for seconds in (10.1, 5, 0, 5.1):
        state.move(round(1e9 * seconds), (0, 0, 0), LEANING)


@pytest.mark.parametrize(
    ("place", "turn", "told"),
    [
        ((np.nan, 0, 0), LEANING, "position is"),
        ((0, 0, np.inf), LEANING, "position is"),
        ((0, 0, 2e9), LEANING, "within 1e"),
        ((0, 0, 0), (0, 0, 0, 0), "unit quaternion"),
        ((0, 0, 0), (0, np.nan, 0, 1), "unit quaternion"),
    ],
)
def test_what_is_no_pose_changes_nothing(place, turn, told):
    state, other = State(), State()
    for k in range(20):
        stamp = 10**9 + k * 10**9 // 50
        if k == 10:
            with pytest.raises(ValueError, match=told):
                state.move(stamp - 1000, place, turn)
        for each in (state, other):
            each.move(stamp, (k * k / 400, 0, 0), LEANING)
        np.testing.assert_array_equal(row_of(state), row_of(other))
