"""The wardrobe's sewing patterns, and a garment sewn from one."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="garments are sewn with what training needs")
from physkin_core.model.garment import load_garment
from physkin_prepare.wardrobe import EDGE_LENGTHS, PATTERNS, main
from physkin_training.sewing.pattern import load_pattern


def test_every_pattern_is_a_garment():
    assert {path.stem for path in PATTERNS.glob("*.json")} == set(EDGE_LENGTHS)
    for name, edge_length in EDGE_LENGTHS.items():
        outlines = [
            np.concatenate([edge.curve[:-1] for edge in panel.edges])
            for panel in load_pattern(PATTERNS / f"{name}.json").panels.values()
        ]
        area = sum((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2 for x, y in (outline.T for outline in outlines))
        assert 3500 < area / (np.sqrt(0.75) * edge_length**2) < 6600, f"vertices of {name}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, openings", [("tshirt", 4), ("trousers", 3), ("hoodie", 4), ("maxidress", 4), ("longsleeve", 4)]
)
def test_a_garment_is_sewn_and_hangs(name, openings, tmp_path):
    main(["--names", name, "--output", str(tmp_path), "--device", "cpu"])
    garment = load_garment(tmp_path / f"{name}.obj")
    assert garment.panel_places is not None and len(garment.vertices) < 6600
    euler = len(garment.vertices) - len(garment.edges) + len(garment.faces)
    assert euler == 2 - openings
    lengths = np.linalg.norm(np.diff(garment.vertices[garment.edges], axis=1)[:, 0], axis=1)
    assert np.abs(lengths / garment.edge_lengths - 1).mean() < 0.015, "hardly stretched where it hangs"
    assert np.abs(garment.vertices[:, 1].max() + garment.vertices[:, 1].min()) < 0.02, "left is as right"
