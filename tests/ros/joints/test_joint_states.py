"""Joint states to joint positions."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from physkin_ros.joints.joint_map import MappedJoint
from physkin_ros.joints.joint_states import JointStateError, JointStateReader, MappedNames, NoPositionsError

NAMES = ("hip", "knee", "ankle", "neck")
REST = np.array([0.1, 0.2, 0.3, 0.4])


def positions(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float32)


def test_unknown_joints_are_reported_once_for_each_set_of_names():
    """Two publishers that take turns on one topic are told apart by their names."""
    reported = []
    reader = JointStateReader(NAMES, REST, on_unknown=reported.append)
    for _ in range(3):
        np.testing.assert_array_equal(reader.read(["tail", "hip"], [9.0, 1.0]), positions(1, 0.2, 0.3, 0.4))
        reader.read(["hip", "left_ear", "right_ear"], [1.0, 2.0, 3.0])
    assert reported == [["tail"], ["left_ear", "right_ear"]]


@pytest.mark.parametrize(
    ("names", "values", "reason"),
    [
        ([], [], "names no joints"),
        (["hip", "knee"], [1.0], "2 names but 1 positions"),
        (["hip"], [], "1 names but 0 positions"),
        (["hip", "knee"], [np.nan, np.inf], "'hip' is nan"),
        (["tail", "knee"], [1.0, np.inf], "'knee' is inf"),
        (["hip"], [1e300], "'hip' is 1e"),
        (["hip", "knee", "hip"], [1.0, 2.0, 3.0], "'hip' and 'hip' are the same joint"),
        (["tail", "fin"], [1.0, 2.0], "no joint is known among 'tail', 'fin'"),
        (["\x1b[2J\n" + "x" * 10**6], [1.0], r"among '\\x1b\[2J\\nx+\.\.\.x+'; the rig has 'hip',"),
    ],
)
def test_bad_joint_states_are_refused(names, values, reason):
    """Each says what is wrong, every time it comes, and changes nothing."""
    reader = JointStateReader(NAMES, REST)
    for _ in range(2):
        with pytest.raises(JointStateError, match=reason):
            reader.read(names, values)
    np.testing.assert_array_equal(reader.positions, REST.astype(np.float32))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
def test_a_joint_that_is_not_finite_keeps_its_position(value):
    """The others move, doubts about degrees included, and it goes on once it is finite again."""
    lost, doubts = [], []
    reader = JointStateReader(NAMES, REST, on_not_finite=lost.append, on_degrees=lambda *doubt: doubts.append(doubt))
    reader.positions = reader.read(["hip", "knee"], [1.0, 2.0])
    reader.positions = reader.read(["knee", "hip", "neck"], [value, 1.5, 97.0])
    np.testing.assert_array_equal(reader.positions, positions(1.5, 2, 0.3, 97))
    assert lost == [["knee"]] and doubts == [("neck", 97.0)]
    np.testing.assert_array_equal(reader.read(["knee", "tail"], [3.0, np.nan]), positions(1.5, 3, 0.3, 97))
    assert lost == [["knee"]]


def test_joint_states_without_positions_are_told_apart():
    """As joints with velocities alone are published."""
    with pytest.raises(NoPositionsError):
        JointStateReader(NAMES, REST).read(["hip"], [])
    with pytest.raises(JointStateError) as refused:
        JointStateReader(NAMES, REST).read(["hip", "knee"], [1.0])
    assert not isinstance(refused.value, NoPositionsError)


@pytest.mark.parametrize("prefix", ["robot1_", "robot1/", "/a/b/", "r2::"])
def test_names_with_a_prefix(prefix):
    """They are refused with the hint, and read once it is given; names without it are read, too."""
    names = [f"{prefix}wheel", f"{prefix}hip", f"{prefix}knee"]
    with pytest.raises(
        JointStateError, match=f"; they match without '{prefix}', which joint_prefix leaves out; the rig"
    ):
        JointStateReader(NAMES, REST).read(names, [0.0, 1.0, 2.0])
    unknown = []
    reader = JointStateReader(NAMES, REST, prefix=prefix, on_unknown=unknown.append)
    np.testing.assert_array_equal(reader.read([*names, "neck"], [0.0, 1.0, 2.0, 3.0]), positions(1, 2, 0.3, 3))
    assert unknown == [[f"{prefix}wheel"]]
    with pytest.raises(JointStateError, match="'knee'.* are the same joint"):
        reader.read([*names, "knee"], [0.0, 1.0, 2.0, 3.0])
    with pytest.raises(JointStateError) as refused:
        JointStateReader(NAMES, REST).read([f"{prefix}wheel_{'_' * 200}"] * 3000, [0.0] * 3000)
    assert "match" not in str(refused.value)


@pytest.mark.parametrize(("value", "doubted"), [(9.4, False), (9.5, True), (-97.0, True), (1e25, True)])
def test_degrees_are_doubted_and_taken(value, doubted):
    """By the name and value that came in; many joints within a turn are no reason for doubt."""
    doubts = []
    reader = JointStateReader(NAMES, REST, on_degrees=lambda *doubt: doubts.append(doubt))
    np.testing.assert_array_equal(reader.read(["knee", "tail"], [value, 500.0]), positions(0.1, value, 0.3, 0.4))
    reader.read(NAMES, [6.0] * 4)
    assert doubts == ([("knee", value)] if doubted else [])
    scaled = MappedNames(NAMES, {"Knee": MappedJoint("knee", scale=np.pi / 180)})
    JointStateReader(NAMES, REST, naming=scaled, on_degrees=lambda *doubt: doubts.append(doubt)).read(["Knee"], [97.0])
    assert len(doubts) == doubted


def test_joint_map_renames_and_scales():
    """Mapped names drive the rig's joints; the rig's own names go on working."""
    naming = MappedNames(NAMES, {"Knee_L": MappedJoint("knee", scale=-2.0, offset=0.5)})
    reader = JointStateReader(NAMES, REST, naming=naming)
    np.testing.assert_allclose(reader.read(["neck", "Knee_L"], [7.0, 1.0]), positions(0.1, -1.5, 0.3, 7))
    with pytest.raises(JointStateError, match="'knee' and 'Knee_L' are the same joint"):
        reader.read(["knee", "Knee_L"], [1.0, 1.0])


@pytest.mark.parametrize(("names", "length"), [(3000, 10), (2, 100_000)])
def test_invented_names_fill_no_memory(names, length):
    """Many short ones, few long ones."""
    reader = JointStateReader(NAMES, REST)
    tracemalloc.start()
    try:
        for k in range(20):
            reader.read(["hip", *(f"{k}-{n}-".ljust(length, "x") for n in range(names))], [0.0] * (names + 1))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 10e6
