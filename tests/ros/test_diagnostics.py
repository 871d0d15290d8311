"""What the drape node reports about itself."""

from __future__ import annotations

from physkin_core.push_out import ContactResidual
from physkin_ros.diagnostics import DrapeStatistics, contact_values


def test_before_the_first_joint_state():
    """Nothing is wrong, there is only nothing to say."""
    well, summary, values = DrapeStatistics().report(now_ns=5)
    assert well and summary == "waiting for joint states"
    assert values["evaluation p50 [us]"] == "none" and values["last stamp age [s]"] == "none"


def test_counts_times_and_age():
    """Counts go on from the start, times are those since the last report."""
    statistics = DrapeStatistics()
    for evaluation_ns in (10_000, 20_000, 30_000):
        statistics.received += 1
        statistics.draped(stamp_ns=1_000_000_000, evaluation_ns=evaluation_ns)
    well, summary, values = statistics.report(now_ns=1_250_000_000)
    assert well and summary == "draping"
    assert (values["joint states received"], values["clouds published"]) == ("3", "3")
    assert (values["evaluation p50 [us]"], values["evaluation p99 [us]"]) == ("20.0", "29.8")
    assert values["last stamp age [s]"] == "0.250"
    _, _, values = statistics.report(now_ns=1_250_000_000)
    assert values["clouds published"] == "3" and values["evaluation p50 [us]"] == "none"


def test_rejections_warn_until_reported():
    """The last reason stays readable after the warning has gone."""
    statistics = DrapeStatistics()
    statistics.reject("too odd")
    well, summary, _ = statistics.report(now_ns=0)
    assert not well and summary == "1 messages rejected: too odd"
    well, _, values = statistics.report(now_ns=0)
    assert well and values["joint states rejected"] == "1" and values["last rejection"] == "too odd"


def test_gravity_rejections_are_counted_apart():
    """They warn as well, but are no joint states."""
    statistics = DrapeStatistics()
    statistics.reject_gravity("no direction")
    well, summary, values = statistics.report(now_ns=0)
    assert not well and summary == "1 messages rejected: no direction"
    assert (values["gravity messages rejected"], values["joint states rejected"]) == ("1", "0")
    assert values["last rejection"] == "no direction"


def test_contact_left_is_told_in_millimetres():
    """The push-out's residual as text."""
    values = contact_values(ContactResidual(deepest=0.00123, left_inside=4))
    assert values == {"vertices left inside": "4", "deepest left inside [mm]": "1.23"}
