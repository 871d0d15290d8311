"""What the drape node reports about itself."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import load_body_model
from physkin_ros.node.diagnostics import (
    AvatarStatistics,
    GarmentStatistics,
    HealthReporter,
    PoseRange,
    diagnostic_status,
)

SECOND = 1_000_000_000


def report(reporter, counts, garment, beyond=(), now=SECOND):
    (health,) = reporter.report(counts, [garment], beyond, now)
    return (*health.summary(), health.values(now_ns=now))


def test_counts_rates_times_and_age():
    """Counts go on from the start, rates and times are those since the last report."""
    reporter, counts, garment = HealthReporter(), AvatarStatistics(), GarmentStatistics()
    report(reporter, counts, garment, now=0)
    for evaluation_ns in (10_000, 20_000, 30_000):
        counts.received += 1
        garment.draped(evaluation_ns)
    counts.last_stamp_ns = SECOND
    well, summary, values = report(reporter, counts, garment, now=2 * SECOND)
    assert well and summary == "draping"
    assert (values["joint states received"], values["clouds published"]) == ("3", "3")
    assert (values["joint states [Hz]"], values["clouds [Hz]"]) == ("1.5", "1.5")
    assert (values["evaluation p50 [us]"], values["evaluation p99 [us]"]) == ("20.0", "29.8")
    assert values["last stamp age [s]"] == "1.000"
    _, summary, values = report(reporter, counts, garment, now=3 * SECOND)
    assert values["clouds published"] == "3" and values["evaluation p50 [us]"] == "none"
    assert summary == "no joint states in the last second" and values["clouds [Hz]"] == "0.0"


def test_no_trouble_hides_another():
    """A swap that failed warns once, beside what else went wrong; the last error stays readable."""
    reporter, counts, garment = HealthReporter(), AvatarStatistics(), GarmentStatistics()
    counts.fail_swap("no such body")
    counts.reject("too odd")
    counts.doubt("97 rad")
    counts.deadline_missed, counts.not_ready = 3, 2
    well, summary, _ = report(reporter, counts, garment)
    texts = ("no such body", "too odd", "97 rad", "3 joint", "2 joint")
    assert not well and all(text in summary for text in texts)
    well, summary, values = report(reporter, counts, garment)
    assert well and values["last error"] == "no such body" and values["swaps failed"] == "1"


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
    garment = GarmentStatistics()
    garment.draped(1000)
    well, summary, values = report(HealthReporter(), AvatarStatistics(), garment, beyond)
    assert not well and beyond[0] in summary and beyond[1] in values["outside the trained range"]


def test_what_strangers_write_is_shortened_and_escaped():
    """In each reason, and in what else a status says."""
    hostile = "\x1b[2J\nERROR " + "x" * 10**6
    counts = AvatarStatistics()
    for told in (counts.reject, counts.reject_gravity, counts.reject_wind, counts.fail_swap, counts.doubt):
        told(hostile)
    _, summary, values = report(HealthReporter(), counts, GarmentStatistics())
    pytest.importorskip("diagnostic_msgs", reason="needs diagnostic_msgs: pip install 'physkin[ros]'")
    status = diagnostic_status(hostile, hostile, False, summary, values | {"model": hostile})
    texts = [status.name, status.hardware_id, status.message, *(each.value for each in status.values)]
    assert all(text.isprintable() and len(text) < 1200 for text in texts)
    assert sum("\\x1b[2J ERROR x" in text for text in texts) >= 5
