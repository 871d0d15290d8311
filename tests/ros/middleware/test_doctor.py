"""What `physkin doctor` says of ROS 2: this machine's, and ones that are made to be broken."""

import shutil
import sys
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_ros.middleware import doctor
from physkin_ros.middleware.transport import FASTDDS_PROFILE, PROFILE_VARIABLES, free_domain_id


@pytest.fixture(autouse=True)
def private(monkeypatch):
    """A domain of its own and no profile chosen; what is looked at leaves this environment as it was."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    for variable in PROFILE_VARIABLES:
        monkeypatch.setenv(variable, "")


def found():
    return {finding.subject: finding for finding in doctor.look()}


def test_machine_that_takes_part(monkeypatch):
    """A node can be made; the profile is the shipped one, also where it is chosen by its path."""
    findings = found()
    assert findings["rclpy"].state == "good" and "rmw_" in findings["rclpy"].found
    assert findings["Fast DDS"].state == "good" and str(FASTDDS_PROFILE) in findings["Fast DDS"].found
    monkeypatch.setenv(PROFILE_VARIABLES[0], str(FASTDDS_PROFILE))
    assert doctor._profile().found.startswith("the shipped one")


def test_profiles_of_ones_own(monkeypatch, tmp_path):
    """One that is not there is broken; another one is left alone."""
    monkeypatch.setenv(PROFILE_VARIABLES[0], str(tmp_path / "mine.xml"))
    assert doctor._profile().state == "broken" and "no such file" in doctor._profile().found
    (tmp_path / "mine.xml").write_text("<dds/>")
    assert doctor._profile().state == "good" and "segment_size" in doctor._profile().remedy


def test_middleware_that_refuses(monkeypatch):
    monkeypatch.setattr("rclpy.create_node", lambda *_, **__: 1 / 0)
    finding = doctor._participant()
    assert finding.state == "broken" and "division" in finding.found and "RMW_IMPLEMENTATION" in finding.remedy


def test_rclpy_that_is_too_old(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy.experimental", None)
    assert "older than 7.1.4" in doctor._participant().found and doctor._participant().state == "broken"


@pytest.mark.parametrize("module", ["physkin_msgs.srv", "tf2_msgs.msg"])
def test_messages_that_are_missing(monkeypatch, module):
    """They cost topics, not clouds: absent, with the command that installs them."""
    monkeypatch.setitem(sys.modules, module, None)
    finding = found()[module.partition(".")[0]]
    assert (finding.state, "is not installed" in finding.found) == ("note", True)
    assert "build.py --install" in finding.remedy


def test_shared_memory_that_is_too_small_or_littered(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "SHARED_MEMORY", tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=64_000_000))
    (tmp_path / "fastrtps_1").write_bytes(bytes(2_000_000))
    monkeypatch.setattr(doctor, "leftovers", lambda: {"fastrtps_1"})
    small, littered = doctor._shared_memory()
    assert small.state == "broken" and "64 MB free" in small.found and "--shm-size" in small.remedy
    assert littered.found == "2 MB left by processes that were killed" and "fastdds shm clean" in littered.remedy
