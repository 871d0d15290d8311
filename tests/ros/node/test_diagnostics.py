"""What the drape node reports about itself."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import load_body_model
from physkin_ros.node.diagnostics import COUNTED, TROUBLES, AvatarStatistics, PoseRange, diagnostic_status

SECOND = 1_000_000_000


def report(counts, beyond=(), now=SECOND):
    health = counts.health(now, beyond)
    return (*health.summary(), health.values(now_ns=now))


def test_counts_rates_times_and_age():
    """Counts go on from the start, rates and times are those since the last report; in the message they are the same
    as in the diagnostics."""
    counts = AvatarStatistics()
    report(counts, now=0)
    for evaluation_ns in (10_000, 20_000, 30_000):
        counts.count("received")
        counts.draped(SECOND, evaluation_ns)
    health = counts.health(2 * SECOND)
    values = health.values(2 * SECOND)
    assert health.summary() == (True, "draping")
    assert (values["joint states received"], values["clouds published"]) == ("3", "3")
    assert (values["joint states [Hz]"], values["clouds [Hz]"]) == ("1.5", "1.5")
    assert (values["evaluation p50 [us]"], values["evaluation p99 [us]"]) == ("20.0", "29.8")
    assert values["last stamp age [s]"] == "1.000"
    messages = pytest.importorskip("physkin_msgs.msg", reason="needs physkin_msgs")
    message = messages.GarmentStatistics(avatar="ann")
    health.fill(message)
    assert (message.received, message.published, message.rejected, message.received_rate) == (3, 3, 0, 1.5)
    assert message.evaluation_p50 == pytest.approx(20) and message.avatar == "ann"
    _, summary, values = report(counts, now=3 * SECOND)
    assert values["clouds published"] == "3" and values["evaluation p50 [us]"] == "none"
    assert summary == "no joint states in the last second" and values["clouds [Hz]"] == "0.0"
    counts.health(4 * SECOND).fill(message)
    assert np.isnan(message.evaluation_p99)


def test_no_trouble_hides_another():
    """A swap that failed warns once, beside what else went wrong; the last error stays readable."""
    counts = AvatarStatistics()
    for what, reason in (("swaps_failed", "no such body"), ("rejected", "too odd"), ("implausible", "97 rad")):
        counts.count(what, reason)
    counts.count("not_ready", number=2)
    well, summary, values = report(counts)
    assert not well and summary == (
        "1 joint states rejected: too odd; 2 joint states before a garment was ready; 1 joint states that look like "
        "degrees: 97 rad; 1 swaps failed: no such body"
    )
    assert values["last rejection"] == "too odd"
    well, summary, values = report(counts)
    assert well and values["last error"] == "no such body" and values["swaps failed"] == "1"


def test_joint_states_without_positions():
    """Are no trouble beside others."""
    counts = AvatarStatistics()
    for what in ("received", "without_positions"):
        counts.count(what, number=3)
    assert report(counts)[:2] == (False, "none of the joint states has positions")
    counts.count("received", number=2)
    counts.count("without_positions")
    counts.draped(SECOND, 10_000)
    assert report(counts)[:2] == (True, "draping")


def test_poses_outside_the_trained_range():
    """The farthest joint is named first, with where it was and what was trained, until reported."""
    rig = load_body_model().rig
    pose = rig.rest.astype(np.float32)
    found = PoseRange(rig, pose)
    found.add()
    assert found.beyond() == []
    pose[3], pose[7] = rig.upper[3] + 0.5, rig.lower[7] - 0.25
    found.add()
    pose[:] = rig.rest
    found.add()
    beyond = found.beyond()
    assert [text.split()[0] for text in beyond] == [rig.joint_names[3], rig.joint_names[7]]
    assert f"{rig.upper[3] + 0.5:.2f} rad (trained {rig.lower[3]:.2f} to {rig.upper[3]:.2f})" in beyond[0]
    assert found.beyond() == []
    counts = AvatarStatistics()
    counts.draped(1, 1000)
    well, summary, values = report(counts, beyond)
    assert not well and beyond[0] in summary and beyond[1] in values["outside the trained range"]


def test_what_strangers_write_is_shortened_and_escaped():
    """In each reason, and in what else a status says."""
    hostile = "\x1b[2J\nERROR " + "x" * 10**6
    counts = AvatarStatistics()
    for what in COUNTED:
        counts.count(what, hostile)
    _, summary, values = report(counts)
    pytest.importorskip("diagnostic_msgs", reason="needs diagnostic_msgs: pip install 'physkin[ros]'")
    status = diagnostic_status(hostile, hostile, False, summary, values | {"model": hostile})
    texts = [status.name, status.hardware_id, status.message, *(each.value for each in status.values)]
    most = len(TROUBLES) * 360  # each trouble has a count, its name and a sentence of 300 characters
    assert all(text.isprintable() and len(text) < most for text in texts)
    assert sum("\\x1b[2J ERROR x" in text for text in texts) >= 5
