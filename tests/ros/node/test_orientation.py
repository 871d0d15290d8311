"""Gravity in the root frame, against rotation matrices."""

from __future__ import annotations

from types import SimpleNamespace as Message

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_ros.node.orientation import (
    FRESH,
    MOST_DIRECTIONS,
    EffectiveGravity,
    GravityByStamp,
    OrientationError,
    TransformTree,
    gravity_from_imu,
    gravity_from_quaternion,
    gravity_from_tilt,
)
from physkin_ros.node.orientation_source import OrientationSource

DOWN = np.array([0.0, 0.0, -1.0])


def vector(values):
    return Message(x=values[0], y=values[1], z=values[2])


def turned(values):
    return Message(x=values[0], y=values[1], z=values[2], w=values[3])


def transform(parent: str, child: str, rotation: Rotation):
    return Message(
        header=Message(frame_id=parent), child_frame_id=child, transform=Message(rotation=turned(rotation.as_quat()))
    )


def test_any_orientation():
    """The world's down, seen from the root; a quaternion a little off unit length is taken as it is meant."""
    for rotation in Rotation.random(50, rng=np.random.default_rng(1)):
        expected = rotation.inv().apply(DOWN)
        np.testing.assert_allclose(gravity_from_quaternion(rotation.as_quat()), expected, atol=1e-12)
        np.testing.assert_allclose(gravity_from_quaternion(1.01 * rotation.as_quat()), expected, atol=1e-12)


@pytest.mark.parametrize("wrong", [(0, 0, 0, 0), (0, 0, 0, 2), (np.nan, 0, 0, 1), (0, np.inf, 0, 1), (1e200, 0, 0, 0)])
def test_what_is_no_rotation_is_refused(wrong):
    """Among them the message nobody filled in."""
    with pytest.raises(OrientationError, match="must be a unit quaternion"):
        gravity_from_quaternion(wrong)


def test_roll_and_pitch():
    """As REP-103's fixed-axis angles."""
    for roll, pitch in np.random.default_rng(2).uniform(-3, 3, (20, 2)):
        expected = Rotation.from_euler("xy", [roll, pitch]).inv().apply(DOWN)
        np.testing.assert_allclose(gravity_from_tilt(roll, pitch), expected, atol=1e-12)
    with pytest.raises(OrientationError, match="roll is nan"):
        gravity_from_tilt(float("nan"), 0.0)


def test_imu():
    """Its orientation; without one, what it feels at rest."""
    rotation = Rotation.from_euler("xyz", [0.3, -0.4, 2.0])
    expected = rotation.inv().apply(DOWN)
    message = Message(
        orientation=turned(rotation.as_quat()), orientation_covariance=[0.0] * 9, linear_acceleration=vector([0.0] * 3)
    )
    np.testing.assert_allclose(gravity_from_imu(message), expected, atol=1e-12)
    message.orientation_covariance = [-1.0] + [0.0] * 8
    with pytest.raises(OrientationError, match="no orientation"):
        gravity_from_imu(message)
    message.linear_acceleration = vector(-9.81 * expected)
    np.testing.assert_allclose(gravity_from_imu(message), expected, atol=1e-12)


def test_chain_of_transforms():
    """The latest of each; frames may bear a slash."""
    tree, world, hips = TransformTree(), Rotation.from_euler("x", 0.7), Rotation.from_euler("yz", [0.4, 1.0])
    tree.update([transform("map", "person", Rotation.identity())])
    tree.update(
        [transform("/map", "/person", world), transform("person", "root", hips), transform("root", "arm", hips)]
    )
    np.testing.assert_allclose(tree.gravity("root", "map"), (world * hips).inv().apply(DOWN), atol=1e-12)
    np.testing.assert_allclose(tree.gravity("map", "map"), DOWN)
    with pytest.raises(OrientationError, match="no transform from 'odom' to 'root': nothing is known above 'map'"):
        tree.gravity("root", "odom")
    tree.update([transform("root", "map", hips)])
    with pytest.raises(OrientationError, match="go round in a circle"):
        tree.gravity("root", "odom")


SECOND = 1_000_000_000


def test_directions_pair_by_stamp():
    """Whatever the order they come in; where no stamps tell, the last that came; a restarted clock starts anew."""
    gravity = GravityByStamp(np.float32([9, 9, 9]))
    at = lambda seconds: gravity.at(round(seconds * SECOND))[0]  # noqa: E731
    assert at(5) == 9
    for direction, seconds in ((1, 10), (3, 10.2), (2, 10.1)):
        gravity.add(np.float32([direction, 0, 0]), round(seconds * SECOND))
    asked = {10: 1, 10.15: 2, 10.2: 3, 99: 3, 9.5: 1, 8: 2, 0: 2}
    assert {seconds: at(seconds) for seconds in asked} == asked
    gravity.add(np.float32([4, 0, 0]), 0)
    assert at(10.05) == 4
    for direction, seconds in ((5, 2_000_000_000), (6, 20)):
        gravity.add(np.float32([direction, 0, 0]), seconds * SECOND)
    assert at(20.01) == at(3e9) == 6


def test_only_so_many_directions_are_kept():
    """The earliest go."""
    gravity = GravityByStamp(np.zeros(3))
    for index in range(2 * MOST_DIRECTIONS):
        gravity.add(np.full(3, index), SECOND + index)
    assert gravity.at(SECOND + 5)[0] == MOST_DIRECTIONS


def test_effective_gravity_counts_while_it_is_fresh():
    """By when it came, whatever its stamps; paired by stamps as directions are, but never with what was stale."""
    felt = EffectiveGravity()
    assert felt.at(5, 0) is None
    for size, seconds in ((1, 10), (2, 10.2)):
        felt.add(np.float32([size, 0, 0]), round(seconds * SECOND), 1000)
    for stamp, size in ((10.1, 1), (10.2, 2), (0, 2)):
        assert felt.at(round(stamp * SECOND), 1000 + FRESH)[0] == size
        assert felt.at(round(stamp * SECOND), 1001 + FRESH) is None
    felt.add(np.float32([3, 0, 0]), 12 * SECOND, 2000 + FRESH)
    assert felt.at(round(11.5 * SECOND), 2000 + FRESH)[0] == 3


class Wired:
    """An orientation source without a node: what it is sent, and what it then says."""

    def __init__(self, **settings):
        self.callbacks, self.gravity, self.felt, self.bad = {}, [], [], []
        avatar = Message(
            id="", prefix="", orientation="pose", orientation_topic="", effective_gravity_topic="", **settings
        )
        node = Message(create_subscription=lambda kind, topic, take, **_: self.callbacks.setdefault(topic, take))
        takers = (lambda down, stamp: self.gravity.append(down), lambda felt, stamp: self.felt.append(felt))
        self.source = OrientationSource(node, avatar, *takers, self.bad.append)

    def pose(self, seconds, position):
        whole = int(seconds)
        stamp = Message(sec=whole, nanosec=round(1e9 * (seconds - whole)))
        pose = Message(position=vector(position), orientation=turned((0.0, 0.0, 0.0, 1.0)))
        self.callbacks["pose"](Message(header=Message(stamp=stamp), pose=pose))


def test_a_root_that_sets_off_lets_cloth_trail():
    wired, still = Wired(sway=1.0), Wired(sway=0.0)
    for k in range(60):
        for source in (wired, still):
            source.pose(1000 + k / 60, (1.5 * (k / 60) ** 2, 0, 0))
    assert wired.felt[0] == pytest.approx(DOWN) and wired.felt[-1][0] < -0.3
    assert len(wired.gravity) == 60 and wired.gravity[-1] == pytest.approx(DOWN)
    assert still.felt == [] and len(still.gravity) == 60


def test_effective_gravity_that_is_told_takes_the_place_of_sway():
    wired = Wired(sway=1.0)
    wired.pose(1.0, (0, 0, 0))
    header = Message(stamp=Message(sec=1, nanosec=0))
    wired.callbacks["~/effective_gravity"](Message(header=header, vector=vector((0, 0, -4.905))))
    wired.pose(1.1, (9, 0, 0))
    assert [felt.tolist() for felt in wired.felt] == [[0, 0, -1], [0, 0, -0.5]]
    assert wired.bad == []


def test_poses_nowhere_are_told():
    wired = Wired(sway=1.0)
    wired.pose(1.0, (np.nan, 0, 0))
    assert len(wired.bad) == 1 and "finite" in wired.bad[0]
