"""The joint map file."""

from __future__ import annotations

import json
import time

import pytest
from fuzzing import check_refusals

from physkin_core.file_reading import LONGEST_SENTENCE
from physkin_ros.joints.joint_map import JointMapError, MappedJoint, load_joint_map

JOINTS = ("hip", "knee")


def test_names_and_objects(tmp_path):
    """A plain name means scale 1 and offset 0."""
    path = tmp_path / "map.json"
    path.write_text(json.dumps({"LeftHip": "hip", "LeftKnee": {"joint": "knee", "scale": -1, "offset": 0.25}}))
    assert load_joint_map(path, JOINTS) == {"LeftHip": MappedJoint("hip"), "LeftKnee": MappedJoint("knee", -1.0, 0.25)}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "it is not JSON"),
        ('{"a":' * 10**5, "is nested too deeply"),
        (" " * (1 << 20) + "{}", "has 1048578 bytes, allowed are 1048576"),
        ('{"a": {"joint": "hip", "offset": 1%s}}' % ("0" * 400), "malformed: OverflowError"),
        ('{"%s": "elbow"}' % ("\\u001b" * 10**4), "the rig has no joint 'elbow'"),
        ('{"a": "%s"}' % ("x" * 10**5), "the rig has no joint"),
        ("[]", "must be a JSON object"),
        ('{"a": "elbow"}', "entry 'a': the rig has no joint 'elbow'"),
        ('{"a": "Kneee"}', "the rig has no joint 'Kneee'; did you mean 'knee'"),
        ('{"a": 3}', "must be a rig joint name or an object, got 3"),
        ('{"a": {"joint": "hip", "gain": 2}}', "unknown key 'gain'; allowed: joint, scale, offset"),
        ('{"a": {"scale": 2}}', "the rig has no joint None"),
        ('{"a": {"joint": "hip", "scale": "2"}}', "scale must be a finite number, got '2'"),
        ('{"a": {"joint": "hip", "offset": NaN}}', "offset must be a finite number, got nan"),
        ('{"a": {"joint": "hip", "scale": 0}}', "scale must not be zero"),
        ('{"a": "hip", "b": "hip"}', "two entries drive hip"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, reason):
    """The error names the file, the entry and what was allowed."""
    path = tmp_path / "map.json"
    path.write_text(text)
    with pytest.raises(JointMapError, match=reason) as error:
        load_joint_map(path, JOINTS)
    assert str(path) in str(error.value)
    assert len(str(error.value)) <= LONGEST_SENTENCE and str(error.value).isprintable()


def test_many_entries_are_refused_at_once(tmp_path):
    """In linear time: it took minutes."""
    path = tmp_path / "map.json"
    path.write_text(json.dumps({f"{k}": JOINTS[k % 2] for k in range(60_000)}))
    started = time.perf_counter()
    with pytest.raises(JointMapError, match="two entries drive hip, knee; a rig joint takes one"):
        load_joint_map(path, JOINTS)
    assert time.perf_counter() - started < 5


@pytest.mark.slow
def test_a_thousand_damages(tmp_path):
    """Each file is read, or refused in one sentence."""
    path = tmp_path / "map.json"
    path.write_text(json.dumps({"LeftHip": "hip", "LeftKnee": {"joint": "knee", "scale": -1, "offset": 0.25}}))
    assert check_refusals(lambda copy: load_joint_map(copy, JOINTS), path, JointMapError, range(1000)) > 300
