"""Strain parted by how much of the skin under the garment another part of the body covers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from training.small_runs import waist_band_model

from physkin_core.avatar.body_model import load_body_model
from physkin_studies import strain_by_overlap
from physkin_studies.strain_by_overlap import LIMITS, main, measure_strain_by_overlap
from physkin_training.evaluate.body_overlap import SkinPoints
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

BODY = load_body_model()


def test_a_forearm_through_the_belly_covers_it():
    """Nothing is covered at the canonical pose; with an arm turned through the trunk some of the front is, in that
    sample alone, and nothing of the back of the head."""
    bodies = BodySet(BODY, BODY.held_out_bodies[:1], torch.device("cpu"))
    posed = PosedBodies(BODY, bodies, 2)
    both = torch.zeros(2, dtype=torch.int64)
    rest = torch.tensor(BODY.rig.rest, dtype=torch.float32)
    surface = BODY.vertices(BODY.held_out_bodies[0])
    trunk = surface[np.linalg.norm(surface - [0.12, 0.0, 0.15], axis=1) < 0.15]
    head = surface[surface[:, 2] > surface[:, 2].max() - 0.05]
    posed.pose(rest.expand(2, -1).contiguous(), both)
    seats = SkinPoints.under(surface, BODY.faces, np.concatenate([trunk, head]))
    assert seats.overlapped(posed).shape == (2, len(trunk) + len(head)) and not seats.overlapped(posed).any()
    rng = np.random.default_rng(0)
    poses = torch.tensor(rng.uniform(BODY.rig.lower, BODY.rig.upper, size=(24, len(rest))), dtype=torch.float32)
    share = np.zeros(len(trunk) + len(head))
    for pose in poses:
        posed.pose(torch.stack([rest, pose]), both)
        covered = seats.overlapped(posed).numpy()
        assert not covered[0].any()
        share += covered[1] / len(poses)
    assert share[: len(trunk)].mean() > 0.01, "arms run through the belly in some poses"
    assert share[len(trunk) :].mean() < 0.5 * share[: len(trunk)].mean()


def test_rows_part_all_poses(monkeypatch, capsys):
    """Counts and means of the parts add up to those of all poses, of either kind; the table holds them."""
    monkeypatch.setattr(strain_by_overlap, "bundled_motions", lambda: ["kick"])
    monkeypatch.setattr(strain_by_overlap, "BODIES", 2)
    monkeypatch.setattr(strain_by_overlap, "POSES", 12)
    model = waist_band_model()
    rows = measure_strain_by_overlap(model)
    for kind in ("uniform", "motion"):
        whole, *parts = [row for row in rows if (row.fit, row.kind) == (0.0, kind)]
        assert len(parts) == len(LIMITS) + 1 and whole.count == whole.of == sum(part.count for part in parts)
        for figure in ("edge_strain", "area_strain"):
            mean = sum(part.count * getattr(part, figure) for part in parts if part.count) / whole.count
            assert getattr(whole, figure) == pytest.approx(mean) and mean > 0
    assert [row.of for row in rows if row.kind == "uniform"] == [24] * 10
    monkeypatch.setattr(strain_by_overlap, "load_garment_model", lambda path: model)
    assert main(["band"]) == 0
    uniform = rows[0]
    table = " ".join(capsys.readouterr().out.split())
    assert f"| **band** | {uniform.edge_strain:.2f} / {uniform.area_strain:.2f} (100 %) |" in table
