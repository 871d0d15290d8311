"""Gaps in even stamps."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_ros.joints.missing_messages import CERTAIN, MissingMessages

STEP = 16_666_667
"""[ns] of 60 Hz."""


def counted(stamps, arrived=None) -> list[int]:
    """What is missing before each message; `arrived` as stamped unless given [ns]."""
    found = MissingMessages()
    return [found.count(int(stamp), int(at)) for stamp, at in zip(stamps, stamps if arrived is None else arrived)]


@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_each_gap_is_counted(jitter):
    """Of any length below a second, at the place where it is, with stamps that tremble, too."""
    random = np.random.default_rng(2)
    stamps = 1e18 + STEP * (np.arange(400) + random.uniform(-jitter, jitter, 400))
    lost = {50, 51, 52, 90, 200, 201, *range(300, 340)}
    kept = [k for k in range(400) if k not in lost]
    missing = counted(stamps[kept])
    assert {k: count for k, count in zip(kept, missing) if count} == {53: 3, 91: 1, 202: 2, 340: 40}


def test_a_queue_that_runs_over_is_counted():
    """Stamps of a second each come in milliseconds: what time it is does not matter."""
    stamps = np.delete(np.arange(100) * 1_000_000_000, range(40, 70))
    assert sum(counted(stamps, np.arange(len(stamps)) * 1000)) == 30


def test_what_is_no_gap():
    """A pause, stamps that are not even, two publishers in turns, stamps that are none, that stand, or go back."""
    even = np.arange(40) * STEP
    random = np.random.default_rng(3)
    streams = {
        "a pause": np.concatenate([even, even + 40 * STEP + 7_000_000_000]),
        "uneven": np.cumsum(random.uniform(1, 9, 300) * 1e6),
        "in turns": np.sort(np.concatenate([even, even + 5_000_000])),
        "without stamps": np.zeros(40),
        "doubled": np.repeat(even, 2),
        "a bag that begins anew": np.concatenate([even, even]),
        "too few": np.delete(even, CERTAIN // 2),
    }
    assert {name: sum(counted(stamps)) for name, stamps in streams.items()} == dict.fromkeys(streams, 0)


def test_another_pace_is_no_loss_for_long():
    """Half the rate looks like every second one missing, until it is clear that it is the pace."""
    slower = np.concatenate([np.arange(40), 40 + 2 * np.arange(100)]) * STEP
    assert 0 < sum(counted(slower)) <= CERTAIN + 1


def test_what_came_but_could_not_be_read_is_not_missing():
    found, even = MissingMessages(), np.arange(40) * STEP
    for stamp in even[:20]:
        found.count(int(stamp), int(stamp))
    found.pass_over()
    found.pass_over()
    assert found.count(int(even[24]), int(even[24])) == 2
    assert found.count(int(even[27]), int(even[27])) == 2
