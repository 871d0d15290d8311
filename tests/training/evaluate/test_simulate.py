"""`physkin simulate`: a band on the garment maker's body, its report, its files, and its errors."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from training.small_runs import write_belly_band

from physkin_core import load_body_model, load_garment, load_motion
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.cli import main
from physkin_core.model.garment_model import Material
from physkin_training.evaluate import simulate
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.evaluate.simulate import DrapeSimulation
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies, posed_avatar

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def band(tmp_path_factory):
    path = tmp_path_factory.mktemp("band") / "band.obj"
    write_belly_band(path)
    return path


@pytest.fixture(scope="module")
def body():
    return load_body_model()


def test_an_npz_of_two_frames(band, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(simulate, "STAGES", 1)
    out = tmp_path / "band.npz"
    code = main(
        ["simulate", str(band), "--motion", "walk", "--frame", "0", "20", "-o", str(out)]
        + ["--tolerance", "0.5", "--device", "cpu"]
    )
    arrays = np.load(out)
    garment = load_garment(band)
    assert code == (0 if arrays["converged"].all() else 1)
    assert arrays["vertices"].shape == (2, *garment.vertices.shape)
    np.testing.assert_array_equal(arrays["faces"], garment.faces)
    assert not np.allclose(arrays["vertices"][0], arrays["vertices"][1])
    text = capsys.readouterr().out
    assert text.count("| yes ") + text.count("| NO ") == 2
    assert "stretch J" in text and "force scale" in text


def test_a_drape_that_cannot_converge_says_so(band, tmp_path, capsys, monkeypatch, rough_minima):
    monkeypatch.setattr(simulate, "STAGES", 0)
    out = tmp_path / "band.ply"
    code = main(["simulate", str(band), "--tolerance", "1e-6", "-o", str(out)] + ["--device", "cpu"])
    error = capsys.readouterr().err
    assert code == 1 and "did not converge" in error
    named = re.search(r"drape 0: nine tenths of the force that is left is at \d+ vertices, near (.+)", error)
    assert named and set(named[1].split(", ")) <= set(load_body_model().rig.bone_names)
    assert len(trimesh.load_mesh(out, process=False).vertices) == len(load_garment(band).vertices)


def test_force_that_is_left_is_told_where_it_is(body, band):
    """A vertex before the belly, pushed in by 3 cm: nine tenths of the force are on it and its neighbours, near skin of
    the trunk. Where a minimiser that gives up leaves force is not asked: that depends on how sums are rounded."""
    garment, avatar = load_garment(band), avatar_from_body(body, body.garment_body)
    simulation = DrapeSimulation(garment, avatar, plain_model(garment, nodes=12), Material(), 1, CPU)
    vertices = torch.tensor(garment.vertices[None], dtype=torch.float32)
    vertices[0, vertices[0, :, 0].argmax(), 0] -= 0.03
    simulation.body.pose(torch.tensor(body.rig.rest[None], dtype=torch.float32))
    ((few, near),) = simulation.force_left(SimpleNamespace(vertices=vertices), np.array([[0.0, 0.0, -1.0]]))
    assert few < 8 and near
    assert all(bone.startswith(("spine", "pelvis", "root")) for bone in near), near


@pytest.mark.parametrize(
    "options, material",
    [
        ([], Material()),
        (
            ["--bending", "2.5e-5", "--youngs-modulus", "60", "--rest-angles", "as_made"],
            Material(bending=2.5e-5, youngs_modulus=60.0, rest_angles="as_made"),
        ),
    ],
)
def test_options_say_what_the_cloth_is(band, monkeypatch, capsys, options, material):
    """The reference material unless they do."""

    def simulation(garment, avatar, model, material, *_, **__):
        raise ValueError(str(material))

    monkeypatch.setattr(simulate, "DrapeSimulation", simulation)
    assert main(["simulate", str(band), "--device", "cpu", "-o", "drape.ply", *options]) == 2
    assert str(material) in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["-o", "drape.stl"], "must end in .obj or .ply or .npz"),
        (["--motion", "walk", "--frame", "0", "1", "-o", "drape.obj"], "must end in .npz"),
        (["--motion", "walk", "--frame", "100000", "-o", "drape.obj"], "has frames 0 to"),
        (["--tolerance", "0", "-o", "drape.obj"], "must be above 0"),
        (["--bending", "-1", "-o", "drape.obj"], "material bending is -1.0"),
    ],
)
def test_errors(band, arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", str(band), "--device", "cpu", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_posed_avatars_are_where_posed_bodies_are(body):
    """The same body in the same poses; each copy at its own place on the grid."""
    poses = load_motion("walk").positions_for(body.rig)[[0, 30]].astype(np.float64)
    avatar = avatar_from_body(body, body.held_out_bodies[0])
    ours, other = posed_avatar(avatar, body.rig, 2, CPU), PosedBodies(body, BodySet(body, body.held_out_bodies, CPU), 2)
    for posed in (ours, other):
        posed.pose(torch.as_tensor(poses, dtype=torch.float32))
    assert torch.equal(ours.offset, other.offset)
    np.testing.assert_allclose(ours.mesh.points.numpy(), other.mesh.points.numpy(), atol=2e-5)
    expected = [avatar.posed_vertices(body.rig.bone_transforms(pose, heads=avatar.bone_heads)) for pose in poses]
    np.testing.assert_allclose(ours.vertices.numpy(), expected, atol=2e-5)
    np.testing.assert_array_equal(ours.mesh.indices.numpy(), other.mesh.indices.numpy())


def test_stages_carry_the_garment_along(body, band, monkeypatch):
    """Without minimising, a garment that started as skinning puts it ends as skinning puts it."""
    garment = load_garment(band)
    avatar = avatar_from_body(body, body.garment_body)
    simulation = DrapeSimulation(garment, avatar, plain_model(garment, nodes=12), Material(), 1, CPU)
    bent, down = body.rig.joint_positions({"spine05_x": 0.4, "spine03_x": 0.3})[None], np.array([[0.0, 0, -1]])
    options = {"iterations": 1, "tolerance": 1e9}  # converged where it starts
    monkeypatch.setattr(simulate, "ON_THE_WAY", options)
    direct = simulation.run(bent, down, **options).vertices[0].numpy()
    rest = simulation.run(body.rig.rest[None], down, **options).vertices[0].numpy()
    staged = simulation.run(bent, down, stages=3, **options).vertices[0].numpy()
    moved = np.linalg.norm(direct - rest, axis=1).mean()
    assert moved > 0.01
    assert np.linalg.norm(staged - direct, axis=1).max() < 1e-4
