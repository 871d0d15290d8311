"""TF's frames, against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from root_messages import transform
from scipy.spatial.transform import Rotation

from physkin_ros.root import transform_tree
from physkin_ros.root.quaternions import OrientationError
from physkin_ros.root.transform_tree import KEPT, TransformTree

SECOND = 1_000_000_000


def test_chain_of_transforms():
    """The latest of each; frames may bear a slash; stamps do not matter where nothing moves."""
    tree, generator = TransformTree(), np.random.default_rng(4)
    turns, places = Rotation.random(3, rng=generator), generator.normal(size=(3, 3))
    first, *others = [
        transform(parent, child, place=place.tolist(), quaternion=turn.as_quat().tolist())
        for parent, child, turn, place in zip(("/map", "person", "root"), ("/person", "root", "arm"), turns, places)
    ]
    assert tree.update([transform("map", "person", place=(9, 9, 9))]) == {}
    tree.update([first])
    tree.update(others, static=True)
    stamp, place, turn = tree.pose("root", "map")
    assert stamp == 0
    np.testing.assert_allclose(place, places[0] + turns[0].apply(places[1]), atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(turn).as_matrix(), (turns[0] * turns[1]).as_matrix(), atol=1e-12)
    assert tree.pose("map", "map") == (0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert tree.chain("arm", "map") == ["arm", "root", "person"]
    assert tree.top("arm") == "map" and tree.top("nowhere") == "nowhere"


def test_frames_without_a_way_are_told():
    tree = TransformTree()
    tree.update([transform("map", "person"), transform("person", "root")])
    with pytest.raises(OrientationError, match="no transform from 'odom' to 'root': nothing is known above 'map'"):
        tree.pose("root", "odom")
    tree.update([transform("root", "map")])
    with pytest.raises(OrientationError, match="form a loop"):
        tree.pose("root", "odom")
    with pytest.raises(OrientationError, match="loop"):
        tree.top("root")


def test_all_frames_are_taken_at_one_time():
    """The latest that both are known at, between messages by a straight line; one that stands still is not waited
    for."""
    tree = TransformTree()
    half = Rotation.from_euler("z", 20, degrees=True).as_quat().tolist()
    tree.update([transform("map", "odom", seconds=10.0, place=(0, 0, 0))])
    tree.update([transform("map", "odom", seconds=10.1, place=(2, 0, 0), quaternion=half)])
    tree.update([transform("odom", "root", seconds=10.05, place=(0, 1, 0))])
    stamp, place, turn = tree.pose("root", "map")
    assert stamp == round(10.05 * SECOND)
    expected = Rotation.from_euler("z", 10, degrees=True)
    np.testing.assert_allclose(turn, expected.as_quat(), atol=1e-4)
    np.testing.assert_allclose(place, [1, 0, 0] + expected.apply([0, 1, 0]), atol=1e-3)
    tree.update([transform("odom", "root", seconds=11.0, place=(0, 3, 0))])
    stamp, place, _ = tree.pose("root", "map")
    assert stamp == 11 * SECOND
    np.testing.assert_allclose(place, [2, 0, 0] + Rotation.from_quat(half).apply([0, 3, 0]))


def followed(correction_hz: float, ahead: float = 0.0):
    """Stamps that a root of 100 Hz is told at for two seconds, and where, under a corrected frame (x of both: time)."""
    tree, told = TransformTree(), []
    period = round(100 / correction_hz)
    for k in range(200):
        now = 50 + k / 100
        if k % period == 0:
            tree.update([transform("map", "odom", seconds=now + ahead, place=(now, 0, 0))])
        tree.update([transform("odom", "root", seconds=now, place=(0, now, 0))])
        stamp, place, _ = tree.pose("root", "map")
        told.append((round(stamp / SECOND - 50, 3), place))
    return told


@pytest.mark.parametrize("ahead", [0.0, 1.0, -0.5])
def test_corrections_do_not_hold_up_the_root(ahead):
    """Ones that are slow, stamped ahead as AMCL does, or late: the root is told at its own stamps."""
    told = followed(5.0, ahead)
    assert [stamp for stamp, _ in told[5:]] == [round(k / 100, 3) for k in range(5, 200)]
    stamp, place = told[-1]
    assert place[1] == pytest.approx(50 + stamp) and 50 <= place[0] <= 50 + stamp
    told = followed(50.0, ahead)
    assert len({stamp for stamp, _ in told}) >= 99 and told[-1][0] >= 1.98


def test_a_clock_that_goes_back_is_followed_at_once():
    """As a bag that loops; also by frames that never come again, which stay where they were last."""
    tree = TransformTree()
    tree.update([transform("map", "site", seconds=109.0, place=(0, 0, 5))])
    for start in (100, 3):
        for k in range(100):
            now = start + k / 100
            if start == 100:
                tree.update([transform("site", "odom", seconds=now, place=(k, 0, 0))])
            tree.update([transform("odom", "root", seconds=now, place=(0, now, 0))])
            stamp, place, _ = tree.pose("root", "map")
            assert stamp == round(now * SECOND) or k == 0
            assert place == pytest.approx((k if start == 100 else 99, now, 5)) or k == 0


def test_a_frame_near_the_root_that_stops_is_not_waited_for():
    tree = TransformTree()
    for k in range(100):
        if k < 10:
            tree.update([transform("base", "root", seconds=k / 100 + 1)])
        tree.update([transform("map", "base", seconds=k / 100 + 1)])
    assert tree.pose("root", "map")[0] == round(1.99 * SECOND)


def test_late_messages_change_nothing_and_a_new_clock_begins_anew():
    tree = TransformTree()
    for seconds, x in ((10.0, 1), (9.9, 5), (10.0, 2)):
        tree.update([transform("map", "root", seconds=seconds, place=(x, 0, 0))])
    assert tree.pose("root", "map")[:2] == (10 * SECOND, (2, 0, 0))
    tree.update([transform("map", "root", seconds=3.0, place=(7, 0, 0))])
    assert tree.pose("root", "map")[:2] == (3 * SECOND, (7, 0, 0))
    for k in range(3 * KEPT):
        tree.update([transform("map", "root", seconds=4 + k / 100)])
    assert len(tree._frames["root"].stamps) == len(tree._frames["root"].places) == KEPT


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"quaternion": (0, 0, 0, 0)}, "unit quaternion"),
        ({"quaternion": (np.nan, 0, 0, 1)}, "unit quaternion"),
        ({"place": (0, np.inf, 0)}, "must be finite"),
    ],
)
def test_what_is_no_place_leaves_the_last_good_one(wrong, told):
    tree = TransformTree()
    tree.update([transform("map", "root", seconds=1.0, place=(1, 2, 3))])
    answer = tree.update([transform("map", "root", seconds=2.0, **wrong), transform("root", "arm", seconds=2.0)])
    assert list(answer) == ["root"] and told in answer["root"] and "'map' to 'root'" in answer["root"]
    assert tree.pose("arm", "root")[0] == 2 * SECOND and tree.pose("root", "map")[1] == (1, 2, 3)


def test_invented_frames_fill_no_memory(monkeypatch):
    monkeypatch.setattr(transform_tree, "MOST_FRAMES", 3)
    tree = TransformTree()
    tree.update([transform("map", f"frame{k}") for k in range(9)])
    assert len(tree._frames) == 3 and tree.left_out == "'frame3' and further ones: 3 are known"
    tree.update([transform("map", "frame0", place=(1, 0, 0))])
    assert tree.pose("frame0", "map")[1] == (1, 0, 0)


@pytest.mark.parametrize("names", [("map", "n" * 1_000_000), ("n" * 1_000_000, "root")])
def test_names_that_are_too_long_fill_no_memory(names):
    tree = TransformTree()
    assert tree.update([transform(*names), transform("map", "arm")]) == {}
    assert list(tree._frames) == ["arm"] and len(tree.left_out) < 120
    assert tree.left_out.endswith("names of frames have up to 256 characters")
