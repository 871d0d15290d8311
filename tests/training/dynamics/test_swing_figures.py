"""Figures of swinging points, against motions that are known."""

import numpy as np
import pytest

from physkin_training.dynamics.swing_figures import hem_velocity, octaves, turning


def test_a_hem_that_twists_and_flares():
    """The lowest third alone counts: it turns by 20 degrees against the clock and swings out by 30 mm."""
    around = np.arange(12) * np.pi / 6
    still = np.stack([0.2 * np.cos(around), 0.2 * np.sin(around), -0.1 * (np.arange(12) % 3)], axis=1)
    hem = still[:, 2] < -0.15
    frames = np.repeat(still[None], 5, axis=0)
    angle, wide = around[hem] - np.radians(20), 0.23
    frames[2, hem, :2] = wide * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert turning(frames) == pytest.approx({"twist_degrees": 20, "flare_mm": 30})
    assert turning(frames[:1]) == pytest.approx({"twist_degrees": 0, "flare_mm": 0}, abs=1e-9)


def test_octaves_tell_slow_motion_from_quick_one():
    """Half of a slow swing and twice a quick one, which nothing else moves."""
    times = np.arange(600) / 60
    still = np.zeros((600, 3, 3)) + [[0, 0, 0], [0, 0, -1], [0, 0, -2]]
    slow, quick = (np.sin(2 * np.pi * rate * times)[:, None, None] * [1, 0, 0] for rate in (0.75, 3.0))
    own, simulated = (hem_velocity(points) for points in (still + 0.5 * slow + 2 * quick, still + slow + quick))
    found = octaves(own, simulated, 60.0)
    assert list(found) == ["0.5", "1", "2", "4"]
    assert found["0.5"] == pytest.approx(0.5, rel=0.01) and found["2"] == pytest.approx(2, rel=0.01)
