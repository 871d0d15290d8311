"""Evaluation: the figures of the run time's own drapes, the same for a seed, every pair counted, and all JSON keys."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
import trimesh
from random_models import random_rig
from training.small_runs import networks_alone, waist_band_model

from physkin_core import (
    LimbSeparator,
    avatar_from_body,
    load_body_model,
    load_garment_model,
    load_motion,
    quality,
    save_garment_model,
)
from physkin_core.cli import main
from physkin_core.motion.loading import save_motion
from physkin_core.motion.motion import MotionError
from physkin_training.evaluate import evaluate, minimum
from physkin_training.evaluate.evaluate import Evaluation, evaluate_model
from physkin_training.evaluate.score_table import table
from physkin_training.sampling.chosen_bodies import bodies_by_girth

CPU = torch.device("cpu")
BODY = load_body_model()
FIGURES = set(
    "edge_strain_percent area_strain_percent inside_percent inside_worn_percent "
    "within_3mm_percent stretch_j bend_j collision_j gravity_j energy_j max_depth_mm max_depth_p999_mm pairs".split()
)


@pytest.fixture(scope="module")
def model():
    """A band about the waist, tight enough to be inside some bodies in places."""
    return waist_band_model()


@pytest.fixture(autouse=True)
def few_looks(monkeypatch):
    """Cameras look at one drape a row."""
    monkeypatch.setattr(evaluate, "LOOKED_AT", 1)


def rows_of(text):
    """Cells of a Markdown table, without head and rule."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def signed_distance(points, vertices, faces):
    """To the exact closest point; negative where that point's surface (the mean of the faces that meet there, weighted
    by angle at a corner) faces away. Bodies in these poses run through themselves, so no ray can tell the side."""
    body = trimesh.Trimesh(vertices, faces, process=False)
    closest, distance, face = trimesh.proximity.closest_point(body, points)
    share = trimesh.triangles.points_to_barycentric(body.triangles[face], closest)
    sides = {tuple(edge): pair for edge, pair in zip(body.face_adjacency_edges.tolist(), body.face_adjacency)}
    sign = np.empty(len(points))
    for index in range(len(points)):
        corners = sorted(body.faces[face[index]][share[index] > 1e-6].tolist())
        if len(corners) == 1:
            outward = body.vertex_normals[corners[0]]
        elif len(corners) == 2:
            outward = body.face_normals[sides[tuple(corners)]].sum(axis=0)
        else:
            outward = body.face_normals[face[index]]
        sign[index] = np.sign((points[index] - closest[index]) @ outward)
    return sign * distance


def test_figures_are_those_of_the_run_time(model):
    """Each pair draped by the Draper and measured without Warp or torch, by `quality` and exact closest points."""
    evaluation = Evaluation(model, CPU, bodies=2, poses=2, seed=3, fit=0.0)
    rows = evaluation.figures(upright=False)
    (batch,) = evaluation.batches(evaluation.uniform(upright=False))
    avatars = [avatar_from_body(BODY, coefficients) for coefficients in BODY.held_out_bodies[:2]]
    expected = []
    for index, (q, gravity) in enumerate(zip(batch.positions.numpy(), batch.gravity.numpy())):
        avatar = avatars[index % 2]
        draper = networks_alone(model, avatar, fit=0.0)
        vertices = draper.drape(q, gravity)[:, :3].astype(np.float64)
        body = avatar.posed_vertices(draper.bone_transforms(q))
        contact = quality.contact_figures(signed_distance(vertices, body, avatar.faces))
        weight = model.garment.vertex_areas * model.material.density * 9.81
        expected.append(
            [
                quality.edge_strain(model.garment, vertices),
                quality.area_strain(model.garment, vertices),
                contact["inside_percent"],
                contact["within_3mm_percent"],
                contact["max_depth_mm"],
                -(weight * (vertices @ gravity)).sum(),
            ]
        )
    edge, area, inside, within, depth, gravity = np.transpose(expected)
    row = rows["model"]
    assert row["edge_strain_percent"] == pytest.approx(edge.mean(), rel=1e-3)
    assert row["area_strain_percent"] == pytest.approx(area.mean(), rel=1e-3)
    assert row["gravity_j"] == pytest.approx(gravity.mean(), rel=1e-3)
    one_vertex = 100 / len(model.garment.vertices) / len(expected)
    assert row["inside_percent"] == pytest.approx(inside.mean(), abs=1.01 * one_vertex) and inside.mean() > 1
    assert row["within_3mm_percent"] == pytest.approx(within.mean(), abs=1.01 * one_vertex)
    assert row["max_depth_mm"] == pytest.approx(depth.max(), abs=0.1)
    assert row["energy_j"] == pytest.approx(row["stretch_j"] + row["bend_j"] + row["collision_j"])


def test_plain_skinning_is_the_model_without_correctives(model):
    """The same bodies and poses; on a model that corrects nothing both rows are equal."""
    weight, bias = model.node_deformer[-1]
    plain = replace(model, node_deformer=(*model.node_deformer[:-1], (0 * weight, 0 * bias)))
    evaluation = Evaluation(plain, CPU, bodies=1, poses=2, seed=0)
    rows = evaluation.figures(upright=True)
    assert rows["model"] == pytest.approx(rows["skinning"])
    moving = evaluation.motion([replace(clip("walk", 4), rate_hz=30.0)])
    assert moving["jitter_ratio"] == pytest.approx(1) and moving["counts"]["frames"] == 7, "measured at 60 Hz"
    corrected = Evaluation(model, CPU, bodies=1, poses=2, seed=0).figures(upright=True)
    assert corrected["skinning"] == pytest.approx(rows["skinning"])
    assert corrected["model"]["edge_strain_percent"] != pytest.approx(rows["model"]["edge_strain_percent"], rel=1e-3)


def test_the_same_seed_gives_the_same_scores(model):
    """Bit for bit, whatever was drawn before; another seed, or tilted roots, give others."""
    torch.manual_seed(0)
    first = evaluate_model(model, CPU, bodies=2, poses=2, seed=3)
    torch.manual_seed(1)
    assert evaluate_model(model, CPU, bodies=2, poses=2, seed=3) == first
    assert evaluate_model(model, CPU, bodies=2, poses=2, seed=4)["model"] != first["model"]
    assert first["tilted"]["gravity_j"] != pytest.approx(first["model"]["gravity_j"], rel=1e-3)


def test_a_model_made_to_measure_is_measured_both_ways(model):
    """Rows of the template, and rows of their own, which the table shows."""
    scores = evaluate_model(model, CPU, bodies=2, poses=2, seed=3, motions=[clip("walk", 4)])
    plain = Evaluation(model, CPU, bodies=2, poses=2, seed=3, fit=0.0).figures(upright=True, only=["model"])
    assert scores["model"] == plain["model"]
    made = scores["made_to_measure"]
    assert set(made) == {"model", "skinning", "tilted", "motion"}
    assert made["model"]["edge_strain_percent"] != scores["model"]["edge_strain_percent"]
    own = Evaluation(model, CPU, bodies=2, poses=2, seed=3, fit=1.0).figures(upright=True, only=["model"])
    assert own["model"] == made["model"]
    labels = [row[0] for row in rows_of(table(scores))]
    assert {"the model, made to measure", "plain skinning, motion, made to measure"} <= set(labels)
    assert len(labels) == len(set(labels))


def test_full_space_minima_are_of_each_bodys_own_rest_shape(model):
    """Made to measure on two bodies at the canonical pose, cloth starting at rest: the solver converges for both. On
    every third body or so it stops where a vertex lies on an edge of the skin, and contact has a kink."""
    fitted = replace(model, hyper_modulator={**model.hyper_modulator, "fit": np.zeros(8, dtype=np.float32)})
    evaluation = Evaluation(fitted, CPU, bodies=[4, 5], poses=1, seed=0, fit=1.0)
    pairs = evaluation.uniform(upright=True)
    rest = torch.as_tensor(model.rig.rest.astype(np.float32)).expand(2, -1)
    (batch,) = evaluation.batches(replace(pairs, positions=rest))
    assert evaluation.losses.rest_row.tolist() == [1, 2]
    start = torch.stack([torch.tensor(evaluation.rest_garment(b).vertices) for b in (0, 1)]).float()
    energies = evaluation.energy(start, batch)[1]
    solution = evaluation.full_space_minimum(start, batch)
    assert energies.stretch.max() < 1e-6, "each starts at its own rest shape"
    assert solution.converged.all() and (solution.energy < energies.total).all(), solution


@pytest.mark.parametrize("bodies, poses, batch", [(3, 2, 4), (2, 3, 5)])
def test_every_pair_counts(model, bodies, poses, batch):
    evaluation = Evaluation(model, CPU, bodies=bodies, poses=poses, seed=2, batch=batch, fit=0.0)
    whole = Evaluation(model, CPU, bodies=bodies, poses=poses, seed=2, batch=bodies * poses, fit=0.0)
    expected = whole.figures(upright=True)["model"]
    # A sample's place on the grid rounds, so that of two faces meeting at an edge the other may be the closest one,
    # and contact leaves out deep faces that look away from the garment.
    assert evaluation.figures(upright=True)["model"] == pytest.approx(expected, rel=5e-3)
    assert expected["pairs"] == bodies * poses


@pytest.mark.parametrize("count, expected", [(1, 1), (100, 4)])
def test_minima_on_fewer_or_more_pairs_than_a_batch(model, count, expected, rough_minima, monkeypatch):
    """Only as many pairs count as were asked for, or as there are."""
    monkeypatch.setattr(minimum, "STEPS", 2)
    evaluation = Evaluation(model, CPU, bodies=2, poses=2, seed=0, batch=2)
    pairs = evaluation.uniform(upright=True).spread(count)
    rows = evaluation.minima(pairs)
    assert {row["pairs"] for row in rows.values()} == {expected}
    assert evaluation.minima(pairs) == rows, "the same again"


def clip(name, frames, *, every=4):
    """Some frames of a shipped clip, `every` apart, as a clip at 60 Hz."""
    motion = load_motion(name)
    chosen = {
        k: getattr(motion, k)[: frames * every : every] for k in ("positions", "root_orientation", "root_position")
    }
    return replace(motion, **chosen)


def test_motion_is_measured_on_the_run_times_own_frames(model):
    """Two clips on two bodies, draped by the Draper and measured by `quality`: every frame counts once, and jitter is
    of frames of one clip on one body. Cartwheel turns gravity."""
    clips = [clip("cartwheel", 6), clip("walk", 5)]
    rows = Evaluation(model, CPU, bodies=2, poses=2, seed=0, fit=0.0).motion(clips)
    assert rows["counts"] == {"clips": 2, "frames": 11, "bodies": 2, "rate_hz": 60.0}
    edge, jitter, gravity, weight = [], {}, [], model.garment.vertex_areas * model.material.density * 9.81
    drapers = [networks_alone(model, avatar_from_body(BODY, c), fit=0.0) for c in BODY.held_out_bodies[:2]]
    for motion in clips:
        positions = motion.positions_for(model.rig)
        for draper in drapers:
            frames = [draper.drape(q, g)[:, :3].copy() for q, g in zip(positions, motion.gravity)]
            edge += [quality.edge_strain(model.garment, frame) for frame in frames]
            gravity += [-(weight * (frame @ g)).sum() for frame, g in zip(frames, motion.gravity)]
            jitter.setdefault(motion.name, []).append(quality.jitter(np.stack(frames)))
    assert rows["model"]["pairs"] == 22
    assert rows["model"]["edge_strain_percent"] == pytest.approx(np.mean(edge), rel=1e-3)
    assert rows["model"]["gravity_j"] == pytest.approx(np.mean(gravity), rel=1e-3)
    per_clip = {name: 1000 * np.mean(values) for name, values in jitter.items()}
    for name, value in per_clip.items():
        assert rows["clips"][name]["model"]["jitter_mm"] == pytest.approx(value, rel=1e-3)
    expected = (4 * per_clip["cartwheel"] + 3 * per_clip["walk"]) / 7
    assert rows["model"]["jitter_mm"] == pytest.approx(expected, rel=1e-3)
    assert rows["jitter_ratio"] == pytest.approx(rows["model"]["jitter_mm"] / rows["skinning"]["jitter_mm"])
    assert set(rows["model"]) == set(rows["skinning"]) == FIGURES | {"jitter_mm", "snaps_percent"}
    assert rows["jitter_ratio"] != pytest.approx(1, abs=1e-3)


def test_clips_and_bodies_that_cannot_be_measured_are_refused(model):
    for bodies in (0, -1, 1000):
        with pytest.raises(ValueError, match=f"bodies .*got {bodies}"):
            Evaluation(model, CPU, bodies=bodies, poses=2, seed=0)
    evaluation = Evaluation(model, CPU, bodies=1, poses=1, seed=0)
    with pytest.raises(ValueError, match="'walk'.* 3 frames"):
        evaluation.motion([clip("walk", 2)])
    still = replace(clip("walk", 5), positions=clip("walk", 5).positions[[0] * 5])
    with pytest.raises(ValueError, match="'walk' stands still"):
        evaluation.motion([still])
    with pytest.raises(ValueError, match="different names, got walk, walk"):
        evaluation.motion([clip("walk", 5), clip("walk", 6)])
    walk = clip("walk", 5)
    foreign = replace(walk, joint_names=tuple(f"other{k}" for k in range(len(walk.joint_names))))
    with pytest.raises(MotionError, match="no joint of the rig"):
        evaluation.motion([foreign])


def test_a_model_for_another_rig_is_refused(model, tmp_path, capsys):
    """Fewer bones would be read out of bounds, other limits silently give other poses."""
    rig = BODY.rig
    fewer = random_rig(np.random.default_rng(0), dofs=len(rig.dofs))
    wider = replace(rig, dofs=(replace(rig.dofs[0], upper=rig.dofs[0].upper + 0.1), *rig.dofs[1:]))
    moved = replace(rig, heads=rig.heads + 0.01)
    for other, message in ((fewer, "5 bones, expected"), (wider, "axes or limits"), (moved, "in other places")):
        foreign = replace(model, rig=other, node_bone=np.zeros_like(model.node_bone))
        with pytest.raises(ValueError, match=f"for another rig than the body model's: .*{message}"):
            Evaluation(foreign, CPU, bodies=1, poses=1, seed=0)
    save_garment_model(foreign, tmp_path / "foreign.safetensors")
    command = ["evaluate", str(tmp_path / "foreign.safetensors"), "--bodies", "1", "--poses", "1"]
    assert main([*command, "--device", "cpu"]) == 2
    assert capsys.readouterr().err.startswith("error: garment model 'random' is for another rig")


def test_skinning_for_engines_is_that_model(model):
    """The row is the figures of the model that engines get."""
    scores = evaluate_model(model, CPU, bodies=1, poses=2, seed=0)
    expected = evaluate_model(model.for_engines(), CPU, bodies=1, poses=2, seed=0)
    assert scores["fewer_influences"] == expected["model"]
    assert scores["fewer_influences"]["edge_strain_percent"] != pytest.approx(scores["model"]["edge_strain_percent"])
    assert "4 -> 4 influences" in [row[0] for row in rows_of(table(scores))]


def test_a_garment_that_has_left_the_body_is_warned_of(model):
    """Strain looks excellent on a dress that hangs over the head."""
    scores = evaluate_model(model, CPU, bodies=1, poses=1, seed=0)
    weight = (model.garment.vertex_areas * model.material.density * 9.81).sum()
    assert scores["weight_n"] == pytest.approx(weight)
    rows = {"model", "skinning", "fewer_influences", "tilted", "made_to_measure", "groups", "counts", "material"}
    assert set(scores) == rows | {"weight_n"}, "no rows of minima"
    for lift, warned in ((0.19, False), (0.21, True)):
        scores["model"]["gravity_j"] = scores["skinning"]["gravity_j"] + lift * weight
        assert ("WARNING: the garment lies 0.21 m higher" in table(scores)) == warned


def test_the_command_prints_a_table_and_writes_all_scores(model, tmp_path, capsys, rough_minima, monkeypatch):
    """Five rows and the subset's, made to measure too, counts and material; stored in the model, readable again."""
    monkeypatch.setattr(minimum, "STEPS", 20)
    save_garment_model(model, tmp_path / "band.safetensors")
    arguments = ["--bodies", "1", "--poses", "2", "--minimum", "2"]
    short, alone = clip("run", 4), clip("jump", 3)
    save_motion(short, tmp_path / "short.safetensors")
    save_motion(alone, tmp_path / "alone.safetensors")
    arguments += ["--motion", str(tmp_path / "short.safetensors"), str(tmp_path / "alone.safetensors")]
    outputs = ["--json", str(tmp_path / "scores.json"), "--save-model", str(tmp_path / "scored.safetensors")]
    assert main(["evaluate", str(tmp_path / "band.safetensors"), *arguments, *outputs, "--device", "cpu"]) == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    rows = {"model", "skinning", "fewer_influences", "tilted", "subspace_minimum", "minimum", "model_on_subset"}
    assert set(scores) == rows | {
        "counts",
        "material",
        "energy_ratio",
        "weight_n",
        "motion",
        "made_to_measure",
        "groups",
    }
    assert set(scores["groups"]) == {"adults", "lean", "stout", "children", "elders"}
    on_subset = {"subspace_minimum", "minimum", "model_on_subset"}
    of_motion = {"model", "skinning", "fewer_influences", "jitter_ratio", "clips", "counts"}
    of_measured_motion = scores["made_to_measure"]["motion"]
    assert set(scores["motion"]) == set(of_measured_motion) == of_motion | on_subset
    scored = [(row, scores[row]) for row in rows]
    scored += [(row, motion[row]) for motion in (scores["motion"], of_measured_motion) for row in on_subset]
    for sets in scores["groups"].values():
        assert set(sets) == {"uniform", "everyday", "separated"}
        assert all(set(each) == FIGURES for each in sets.values())
        assert [each["pairs"] for each in sets.values()] == [2, 7, 7]
    alike = {key: scores["groups"]["adults"]["uniform"][key] for key in FIGURES}
    assert alike == pytest.approx({key: scores["made_to_measure"]["model"][key] for key in FIGURES})
    for row, figures in scored:
        more = {"converged_percent"} if row == "minimum" else set()
        assert set(figures) == FIGURES | more
        assert all(np.isfinite(value) for value in figures.values()), row
        assert figures["pairs"] == 2
    counts = {"bodies": 1, "poses": 2, "seed": 0, "pairs": 2, "influences": 4, "minimum_pairs": 2}
    assert scores["counts"] == counts and scores["material"] == asdict(model.material)
    ratio = scores["model_on_subset"]["energy_j"] / scores["minimum"]["energy_j"]
    assert scores["energy_ratio"] == pytest.approx(ratio)
    assert table(scores).strip() in capsys.readouterr().out
    lines = {row[0]: row for row in rows_of(table(scores))}
    assert len(lines) == len(rows) + 4 + len(on_subset) + len(("model", "skinning", "tilted")) + 4 + len(on_subset) + 15
    for seen in ("skin_seen_percent", "in_itself_percent"):
        assert f"{of_measured_motion['model'][seen]:.3f}" in lines["the model, motion, made to measure"]
    assert "full-space minimum, subset of motion" in lines and "the model, jump, made to measure" in lines
    assert f"model / full-space minimum: {scores['energy_ratio']:.2f} (2 pairs)" in table(scores)
    assert f"{scores['tilted']['edge_strain_percent']:.3f}" in table(scores)
    jump = scores["motion"]["clips"]["jump"]
    ends = [jump["model"]["jitter_mm"], jump["jitter_ratio"], jump["model"]["snaps_percent"]]
    assert lines["the model, jump"][-3:] == [f"{value:.3f}" for value in ends]
    jitter = f"{scores['motion']['jitter_ratio']:.2f} (2 clips, 7 frames at 60 Hz, 1 bodies)"
    assert f"Jitter, model / plain skinning: {jitter}" in table(scores)
    stored = load_garment_model(tmp_path / "scored.safetensors")
    assert stored.scores == scores and stored.training == model.training


def test_minima_of_motion_are_of_frames_spread_over_clips_and_bodies(model, monkeypatch):
    """From the first frame on the first body to the last one on the last."""
    given, rows, measured = [], ("model_on_subset", "minimum"), {"pairs": 2, "energy_j": 1.0}
    monkeypatch.setattr(Evaluation, "minima", lambda self, pairs: given.append(pairs) or dict.fromkeys(rows, measured))
    clips = [clip("kick", 4), clip("walk", 4)]
    evaluate_model(model, CPU, bodies=2, poses=1, seed=0, minimum=4, motions=clips)
    uniform, motion, measured = given
    assert torch.equal(motion.positions, measured.positions) and torch.equal(motion.body, measured.body)
    kick, walk = (torch.as_tensor(motion.positions_for(model.rig)) for motion in clips)
    assert len(uniform) == 2 and motion.body.tolist() == [0, 1, 0, 1]
    assert torch.equal(motion.positions, torch.stack([kick[0], kick[1], walk[2], walk[3]]))


def test_progress_is_shown_on_a_terminal(model, monkeypatch, capsys):
    """What is measured and the share that is done, gone at the end; nothing elsewhere."""
    options = dict(bodies=1, poses=2, seed=0, motions=[clip("walk", 4)])
    evaluate_model(model, CPU, **options)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr("physkin_core.progress.PATIENCE", 0.0)
    evaluate_model(model, CPU, **options)
    shown = capsys.readouterr().err
    assert f"measuring {model.name}: 3%, " in shown and " left" in shown and shown.endswith("\x1b[K")


def test_limbs_are_separated_for_each_body_by_itself(model):
    """As `LimbSeparator` separates them; on the stoutest body it has more to do in a walk than on the leanest."""
    body_model = load_body_model()
    lean, stout = bodies_by_girth(body_model, 2, of=body_model.held_out_bodies)
    evaluation = Evaluation(model, CPU, bodies=[lean, stout], poses=1, seed=0)
    pairs = evaluation.frames(load_motion("walk")).spread(8)
    apart = evaluation.separated(pairs)
    assert torch.equal(apart.body, pairs.body) and torch.equal(apart.gravity, pairs.gravity)
    separator = LimbSeparator(model.rig, avatar_from_body(body_model, body_model.held_out_bodies[stout]))
    for pose, own in zip(pairs.positions[4:], apart.positions[4:]):
        assert np.array_equal(own, separator.separate(pose.numpy())[0])
    moved = (apart.positions - pairs.positions).abs().amax(dim=1)
    assert moved[4:].mean() > 2 * moved[:4].mean()
