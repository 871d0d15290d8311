"""Figures of swinging points, against motions that are known."""

import numpy as np
import pytest

from physkin_training.dynamics.swing_figures import turning


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
