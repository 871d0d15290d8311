"""The pace of cloth: how much time passes, and what garment nodes may do in it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrameInput
from reference.pace import PACE, REACH, Pace

import physkin_core as physkin

UNTOLD = -1.0
NO_DETAIL = np.zeros((0, 3))
ROOT = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)


def test_time_passes_between_frames():
    """A time that has passed, and, however long it is, that for the sway network."""
    rows, times = NativeFrameInput(1), (5.0, 5.1, 5.1, 5.2, 5.6, 5.6, 5.0, 5.25)
    told = np.stack([rows.rows(time, ROOT, [1.0])[0] for time in times])
    assert told[:, 3] == pytest.approx([UNTOLD, 0.1, 0.1, 0.1, UNTOLD, UNTOLD, UNTOLD, 0.25])
    assert told[:, 5] == pytest.approx([UNTOLD, 0.1, 0.0, 0.1, 0.4, 0.0, 0.0, 0.25])
    with pytest.raises(ValueError, match="time must be finite, got nan"):
        rows.rows(math.nan, ROOT, [1.0])


def transforms(*places, linear=None):
    """Garment nodes (m, 3, 4) at places, all with one linear part."""
    linear = np.eye(3) if linear is None else linear
    return np.stack([np.concatenate([linear, np.array(place, dtype=float)[:, None]], axis=1) for place in places])


def test_a_leap_is_gone_over_at_the_pace_and_what_a_bone_carries_is_free():
    pace, still = Pace(), transforms((0, 0, 0), (0, 0, 0))
    pace.kept(still, still, NO_DETAIL, UNTOLD)
    carried = transforms((0.5, 0, 0), (0.5, 0, 0))
    wanted = transforms((0.5, 0, 0), (0.5, 0.6, 0))
    first, _ = pace.kept(carried, wanted, NO_DETAIL, 0.01)
    assert (first[0] == wanted[0]).all(), "it goes with its bone"
    share = (0.5 + 0.01 * PACE) / math.hypot(0.5, 0.6)
    assert first[1, :, 3] == pytest.approx(share * wanted[1, :, 3])
    seconds = 0.01
    while not (now := pace.kept(carried, wanted, NO_DETAIL, 0.01)[0])[1] == pytest.approx(wanted[1]):
        seconds += 0.01
    assert seconds == pytest.approx(math.dist(first[1, :, 3], wanted[1, :, 3]) / PACE, abs=0.02)
    assert (now[0] == wanted[0]).all()


def test_what_turns_over_in_its_bone_takes_its_time_and_holds_back_no_motion():
    pace, still = Pace(), transforms((0, 0, 0))
    pace.kept(still, still, NO_DETAIL, UNTOLD)
    flipped = transforms((0.01, 0, 0), linear=np.diag([1.0, 1.0, -1.0]))
    kept, _ = pace.kept(still, flipped, NO_DETAIL, 0.01)
    assert kept[0, :, 3] == pytest.approx(flipped[0, :, 3])
    assert REACH * np.linalg.norm(kept[0, :, :3] - np.eye(3)) == pytest.approx(0.01 * PACE)


def test_each_detail_node_goes_over_at_the_pace():
    """In a straight line, to where it was wanted in the time that it needs by itself; at once where the time is not
    told."""
    still, pace = transforms((0, 0, 0)), Pace()
    start, wanted = np.zeros((3, 3)), np.array([[0.3, 0, 0], [0.2, -0.1, 0.2], [0, 0.01, 0]])
    pace.kept(still, still, start, UNTOLD)
    way = [start]
    while not (way[-1] == wanted).all():
        way.append(pace.kept(still, still, wanted, 0.01)[1])
    for node, distance in enumerate(np.linalg.norm(wanted, axis=1)):
        places = np.array(way)[:, node]
        expected = np.minimum(0.01 * PACE * np.arange(len(way)), distance)
        assert places == pytest.approx(expected[:, None] * wanted[node] / distance)
    assert len(way) == pytest.approx(0.3 / (0.01 * PACE), abs=2)
    assert (pace.kept(still, still, start, UNTOLD)[1] == start).all()


def test_drapes_that_are_told_the_time_end_where_those_by_themselves_are():
    """However often a second they come."""
    model = replace(physkin.load_garment_model("dress"), sway=None)
    draper, rest = physkin.Draper(model, physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig)), model.rig.rest
    tilted, late = (0.45, 0.0, -0.9), []
    by_itself = draper.drape(rest, tilted)
    for rate in (120, 480):
        draper.reset()
        draper.drape(rest, time=0.0)
        way = [draper.drape(rest, tilted, time=k / rate)[:, :3] for k in range(1, rate + 1)]
        assert (way[-1] == by_itself[:, :3]).all()
        late.append(np.abs(way[rate // 120 - 1] - by_itself[:, :3]).max())
    assert late[1] == pytest.approx(late[0], rel=0.2) and min(late) > 0.005
