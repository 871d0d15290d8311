"""The contact sheet: which bodies and poses, the model's own drapes beside lower energies, cells in their places."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from training.small_runs import networks_alone, waist_band_model

from physkin_core import avatar_from_body, cli, load_body_model, load_motion, quality
from physkin_core import save_garment_model as save
from physkin_training.evaluate import contact_sheet
from physkin_training.evaluate.contact_sheet import BODIES, chosen_poses, drape_all
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.sampling.chosen_bodies import bodies_by_girth

BODY = load_body_model()


@pytest.fixture(scope="module")
def model():
    return waist_band_model()


def test_bodies_are_the_leanest_the_middle_and_the_heaviest():
    """By girth at the height of the root, which was not what they were chosen by."""
    bodies = bodies_by_girth(BODY, len(BODIES))

    def depth(index):
        vertices = BODY.vertices(BODY.held_out_bodies[index])
        waist = vertices[(np.abs(vertices[:, 2] - 0.1) < 0.03) & (np.abs(vertices[:, 1]) < 0.1)]
        return np.ptp(waist[:, 0])

    depths = np.array([depth(index) for index in range(len(BODY.held_out_bodies))])
    ranks = [(depths < depths[index]).mean() for index in bodies]
    assert ranks[0] < 0.15 and 0.25 < ranks[1] < 0.75 and ranks[2] > 0.85


def test_poses_are_half_uniform_half_motion_and_seeded():
    pairs, names = chosen_poses(BODY.rig, count=5, seed=3)
    again, same = chosen_poses(BODY.rig, count=5, seed=3)
    assert names == same and torch.equal(pairs.positions, again.positions)
    assert names[:3] == ["uniform 1", "uniform 2", "uniform 3"] and len(set(names)) == len(pairs) == 5
    for index in (3, 4):
        clip, frame = names[index].split()
        motion = load_motion(clip)
        np.testing.assert_array_equal(pairs.positions[index].numpy(), motion.positions_for(BODY.rig)[int(frame)])
        np.testing.assert_array_equal(pairs.gravity[index].numpy(), motion.gravity[int(frame)])
    assert chosen_poses(BODY.rig, count=5, seed=4)[1] != names
    with pytest.raises(ValueError, match="poses must be at least 1, got 0"):
        chosen_poses(BODY.rig, count=0, seed=0)


def test_poses_of_clips_are_spread_over_them():
    """Evenly over the frames of both, 93 and 77 of them, and no more poses than those."""
    clips = [load_motion(name) for name in ("kick", "walk")]
    pairs, names = chosen_poses(BODY.rig, count=2, seed=0, motions=clips)
    assert names == ["kick 42", "walk 34"]
    for pair, (clip, frame) in enumerate(zip(clips, (42, 34))):
        np.testing.assert_array_equal(pairs.positions[pair].numpy(), clip.positions_for(BODY.rig)[frame])
    assert len(set(chosen_poses(BODY.rig, count=170, seed=0, motions=clips)[1])) == 170
    with pytest.raises(ValueError, match="poses must be at most 170.* 171"):
        chosen_poses(BODY.rig, count=171, seed=0, motions=clips)


def test_drapes_are_the_run_times_and_the_minimum_is_lower(model, monkeypatch):
    """Pose by pose, body by body; the surfaces under them are the avatars'. A batch holds three of the four."""
    monkeypatch.setattr(contact_sheet, "ITERATIONS", 4)
    bodies = [5, 2]
    evaluation = Evaluation(model, torch.device("cpu"), bodies=bodies, poses=2, seed=0, batch=3, fit=0.0)
    poses, _ = chosen_poses(model.rig, count=2, seed=0)
    drapes = drape_all(evaluation, poses, minimum=True)
    assert list(drapes.garments) == ["model", "minimum"]
    for pair in (1, 3):
        avatar = avatar_from_body(BODY, BODY.held_out_bodies[bodies[pair % 2]])
        draper = networks_alone(model, avatar, fit=0.0)
        q, gravity = poses.positions[pair // 2].numpy(), poses.gravity[pair // 2].numpy()
        np.testing.assert_allclose(drapes.garments["model"][pair], draper.drape(q, gravity)[:, :3], atol=1e-4)
        under = avatar.posed_vertices(draper.bone_transforms(q))
        np.testing.assert_allclose(drapes.bodies[pair], under, atol=1e-4)
    for row, vertices in drapes.garments.items():
        np.testing.assert_allclose(drapes.strains[row], quality.edge_strain(model.garment, vertices), rtol=1e-3)
    assert (drapes.strains["minimum"] < drapes.strains["model"]).all()
    assert list(drape_all(evaluation, poses, minimum=False).garments) == ["model"]


def test_made_to_measure_is_drawn_with_its_own_strain(model):
    """The run time's drape, made to measure by default in both, within what finding the body's shape costs, against its
    own rest shape."""
    evaluation = Evaluation(model, torch.device("cpu"), bodies=[5, 2], poses=1, seed=0)
    poses, _ = chosen_poses(model.rig, count=1, seed=0)
    drapes = drape_all(evaluation, poses, minimum=False)
    q, gravity = poses.positions[0].numpy(), poses.gravity[0].numpy()
    for pair, body in enumerate([5, 2]):
        draper = networks_alone(model, avatar_from_body(BODY, BODY.held_out_bodies[body]))
        assert draper.fit == 1.0
        apart = np.linalg.norm(drapes.garments["model"][pair] - draper.drape(q, gravity)[:, :3], axis=1)
        assert apart.mean() < 3e-3
        expected = quality.edge_strain(draper.rest_garment, draper.drape(q, gravity)[:, :3].astype(float))
        assert drapes.strains["model"][pair] == pytest.approx(float(expected), rel=0.03)
    template = quality.edge_strain(model.garment, drapes.garments["model"]).mean()
    assert abs(template - drapes.strains["model"].mean()) > 1


@pytest.fixture
def drawn(monkeypatch):
    """What is drawn, in order: pictures are 40 pixels wide, and each is as bright as its number."""
    pytest.importorskip("PIL.Image", reason="needs pillow: pip install 'physkin[view]'")
    calls = []

    def render(meshes, *, size, bounds, azimuth, samples):
        calls.append(SimpleNamespace(body=meshes[0], cloth=meshes[1], bounds=bounds, azimuth=azimuth))
        return np.full((size[1], size[0], 3), len(calls), dtype=np.uint8)

    monkeypatch.setattr(contact_sheet, "render", render)
    monkeypatch.setattr(contact_sheet, "WIDTH", 40)
    monkeypatch.setattr(contact_sheet, "CLOSE_WIDTH", 40)
    monkeypatch.setattr(Evaluation, "full_space_minimum", lambda _, start, batch, **__: SimpleNamespace(vertices=start))
    return calls


def cells(path, columns, rows):
    """Which picture is in each cell (rows, columns) of a sheet of those."""
    sheet = np.asarray(pytest.importorskip("PIL.Image").open(path))
    assert sheet.shape[1] == 4 + 44 * columns
    return sheet[20 :: 4 + 50 + 24, 24::44, 0][:rows, :columns]


def test_the_command_draws_every_cell(model, tmp_path, drawn, capsys):
    """Two poses on three bodies: one row of six pairs of pictures."""
    save(model, tmp_path / "band.safetensors")
    arguments = ["contact-sheet", str(tmp_path / "band.safetensors"), "-o", str(tmp_path / "sheet.png")]
    options = ["--poses", "2", "--minimum", "--device", "cpu"]
    assert cli.main([*arguments, *options]) == 0
    np.testing.assert_array_equal(cells(tmp_path / "sheet.png", 12, 1), [range(1, 13)])
    assert all(len(picture.body.vertices) == len(BODY.mean_vertices) for picture in drawn)
    assert drawn[0].cloth.colour == drawn[2].cloth.colour != drawn[1].cloth.colour
    assert all(np.all(picture.bounds[0] <= picture.body.vertices.min(axis=0)) for picture in drawn)
    assert "sheet.png" in capsys.readouterr().out


def test_close_pictures_are_of_the_garment_from_both_sides(model, tmp_path, drawn):
    """A row a body: the model and the minimum, in front and from behind, all from as near as both garments allow."""
    save(model, tmp_path / "band.safetensors")
    arguments = ["contact-sheet", str(tmp_path / "band.safetensors"), "-o", str(tmp_path / "sheet.png")]
    options = ["--poses", "2", "--motion", "walk", "kick", "--close", "--minimum", "--device", "cpu"]
    assert cli.main([*arguments, *options]) == 0
    np.testing.assert_array_equal(cells(tmp_path / "sheet.png", 4, 6), np.arange(1, 25).reshape(6, 4))
    assert [picture.azimuth for picture in drawn] == 6 * [30, 30, 210, 210]
    for first in range(0, 24, 4):
        garments = np.concatenate([picture.cloth.vertices for picture in drawn[first : first + 4]])
        for picture in drawn[first : first + 4]:
            np.testing.assert_array_equal(picture.bounds, [garments.min(axis=0), garments.max(axis=0)])
            assert np.any(picture.bounds[0] > picture.body.vertices.min(axis=0))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["-o", "{tmp}/none/sheet.png"], "none/sheet.png"),
        (["-o", "{tmp}/sheet.jpg"], "sheet.jpg"),
        (["-o", "{tmp}/sheet.png", "--poses", "0"], "poses .* 0"),
    ],
)
def test_errors_are_one_line(model, options, reason, tmp_path, capsys):
    save(model, tmp_path / "band.safetensors")
    filled = [word.format(tmp=tmp_path) for word in options]
    assert cli.main(["contact-sheet", str(tmp_path / "band.safetensors"), *filled, "--device", "cpu"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert re.search(f"error: .*{reason}", lines[-1])
