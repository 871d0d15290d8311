"""Cloth that was cut flat, from its mesh to its scores: training, model file, run time, evaluation and minima measure
against its panels."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_models import sewn_tube, write_sewn
from training.small_runs import exported, run, small_config

from physkin_core import Draper, Garment, avatar_from_body, load_body_model, load_garment, quality
from physkin_core.cli import main
from physkin_training.evaluate import simulate
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.networks.export import store_checked
from physkin_training.train.trainer import Trainer

BODY, CPU = load_body_model(), torch.device("cpu")
WIDTH, HEIGHT = 0.62, 0.33


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two panels sewn to a band about the waist of the garment maker's body, where it lies smaller than they are."""
    folder = tmp_path_factory.mktemp("sewn")
    made = sewn_tube(columns=13, rings=11, width=WIDTH, height=HEIGHT, shrunk=0.9)
    radius = np.linalg.norm(made.vertices[:, :2], axis=1).mean()
    vertices = made.vertices * [0.16 / radius, 0.2 / radius, 1.0] + [0.0, 0.0, 0.12]
    band = Garment(vertices, made.faces, made.creases, made.panel_places, made.panel_faces)
    write_sewn(folder / "band.obj", band)
    return folder


@pytest.fixture(scope="module")
def trainer(folder):
    """After a few steps."""
    trainer = Trainer(small_config(folder, full_encoding=1.0), CPU)
    run(trainer, 6)
    return trainer


@pytest.fixture(scope="module")
def model(trainer, folder):
    """Exported, checked and read again."""
    return store_checked(exported(trainer, 3), trainer.drape, folder / "band.safetensors")


def test_training_knows_the_panels(trainer):
    """At the template and graded to each body."""
    rest, garment = trainer.losses.rest, trainer.garment
    assert float(rest.face_area[0].sum()) == pytest.approx(2 * WIDTH * HEIGHT, rel=1e-5)
    assert float(rest.weight[0].sum()) == pytest.approx(2 * WIDTH * HEIGHT * 0.2 * 9.81, rel=1e-3)
    for row, shape in enumerate(trainer.fits.shapes):
        graded, lying = garment.reshaped(shape), Garment(shape, garment.faces)
        np.testing.assert_allclose(rest.face_area[row], graded.face_areas, rtol=1e-5)
        np.testing.assert_allclose(rest.edge_length[row], graded.edge_lengths, rtol=1e-5)
        larger = Garment(garment.vertices, garment.faces).face_areas.sum() / lying.face_areas.sum()
        assert graded.face_areas.sum() * larger == pytest.approx(2 * WIDTH * HEIGHT, rel=0.02)
    angle = rest.hinge_angle[0].numpy()
    assert (angle[~garment.creased] == 0).all() and np.abs(angle[garment.creased]).min() > 0.05


def test_the_model_is_scored_against_the_panels(model, folder):
    """In torch as by the run time, at the template and made to measure."""
    cut = load_garment(folder / "band.obj")
    np.testing.assert_allclose(model.garment.edge_lengths, cut.edge_lengths, rtol=1e-4)
    np.testing.assert_array_equal(model.garment.creases, cut.creases)
    for fit in (0.0, 1.0):
        evaluation = Evaluation(model, CPU, bodies=2, poses=2, seed=3, fit=fit)
        row = evaluation.figures(upright=False)["model"]
        (batch,) = evaluation.batches(evaluation.uniform(upright=False))
        found, lying = [], []
        for index, (q, gravity) in enumerate(zip(batch.positions.numpy(), batch.gravity.numpy())):
            avatar = avatar_from_body(BODY, BODY.held_out_bodies[index % 2])
            draper = Draper(model, avatar, precision="fp32", fit=fit)
            # torch does not compute contact with the skin
            draper.outfit = draper.outfit.with_bound_garment(0, draper.bound.without_contact)
            rest, cloth = draper.rest_garment, draper.drape(q, gravity)[:, :3].astype(np.float64)
            found.append([quality.edge_strain(rest, cloth), quality.area_strain(rest, cloth)])
            lying.append(quality.area_strain(Garment(rest.vertices, rest.faces), cloth))
            if fit == 0:
                np.testing.assert_array_equal(rest.edge_lengths, model.garment.edge_lengths)
        edge, area = np.mean(found, axis=0)
        assert row["edge_strain_percent"] == pytest.approx(edge, rel=1e-3)
        assert row["area_strain_percent"] == pytest.approx(area, rel=1e-3)
        assert abs(area - np.mean(lying)) > 3e-3 * area, "the mesh as it lies is another rest shape, told apart by this"


def test_free_cloth_takes_the_size_of_its_panels(folder, tmp_path, capsys, monkeypatch):
    """`physkin simulate` from where it lies, 9 % too small: every edge is nearly as long as it was cut."""
    monkeypatch.setattr(simulate, "STAGES", 0)
    out = tmp_path / "drape.npz"
    main(["simulate", str(folder / "band.obj"), "--device", "cpu", "--tolerance", "0.05", "-o", str(out)])
    garment, drape = load_garment(folder / "band.obj"), np.load(out)["vertices"][0].astype(np.float64)
    before, after = (float(quality.edge_strain(garment, x)) for x in (garment.vertices, drape))
    assert before > 7 and after < 1
    assert f"{after:.4f}" in capsys.readouterr().out
