"""Plots of the ablations: where lines and bars end, and what cannot be plotted."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from physkin_studies.ablation_plots import bars, curves


def test_curves_go_down_with_the_logarithm():
    """A decade is as high anywhere; names are escaped; points that have no logarithm are left out."""
    picture = curves({"a < b": [(0, 100.0), (1, 10.0), (2, 1.0), (3, -1.0)]}, title="t", x="minutes", y="J")
    ElementTree.fromstring(picture)
    (path,) = re.findall(r'points="([^"]*)"', picture)
    heights = [float(point.split(",")[1]) for point in path.split()]
    assert len(heights) == 3 and heights[1] - heights[0] > 0
    assert heights[1] - heights[0] == pytest.approx(heights[2] - heights[1], abs=0.2)
    assert "a &lt; b" in picture


def test_bars_are_as_high_as_their_values():
    picture = bars({"one": {"edge": 2.0, "area": 4.0}, "two": {"edge": 1.0}}, title="t")
    ElementTree.fromstring(picture)
    heights = [float(h) for h in re.findall(r'height="([0-9.]+)" fill="#[^"]*"/>', picture)]
    tallest = max(heights)
    assert sorted(height for height in heights if height > 11) == pytest.approx(
        [tallest / 4, tallest / 2, tallest], abs=0.1
    )


@pytest.mark.parametrize(
    ("highest", "ticks"),
    [
        (2.67, ["0", "0.5", "1", "1.5", "2", "2.5"]),
        (15.2, ["0", "5", "10", "15"]),
        (0.8, ["0", "0.2", "0.4", "0.6", "0.8"]),
    ],
)
def test_ticks_are_round_numbers(highest, ticks):
    picture = curves({"a": [(0, 1.0), (highest, 10.0)]}, title="t", x="x", y="y")
    assert re.findall(r'text-anchor="middle"[^>]*>([0-9.]+)<', picture) == ticks


def test_nothing_to_plot_is_an_error():
    with pytest.raises(ValueError, match="no point"):
        curves({"a": [(0, -1.0)]}, title="t", x="x", y="y")
    with pytest.raises(ValueError, match="no bar"):
        bars({"one": {}}, title="t")
