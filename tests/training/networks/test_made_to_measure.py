"""Rest shapes of bodies in training: the graded garments fit, and plain skinning makes sense of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from training.small_runs import small_config

from physkin_core import load_body_model, load_garment
from physkin_core.model.garment import face_areas
from physkin_core.runtime.garment_grading import GarmentGrading
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.sampling.posed_bodies import BodySet
from physkin_training.train.trainer import Trainer

CPU = torch.device("cpu")
BODY = load_body_model()
GARMENTS = Path(__file__).parents[3] / "training" / "garments"


def build(coefficients) -> float:
    """Volume of a body for its height squared."""
    corners = BODY.vertices(coefficients).astype(np.float64)
    return np.linalg.det(corners[BODY.faces]).sum() / np.ptp(corners[:, 2]) ** 2


@pytest.mark.parametrize("name", ["tshirt", "dress"])
def test_shipped_garments_are_graded_without_folds_and_keep_their_ease(name):
    """On the leanest and the heaviest of the held-out bodies, and four others."""
    garment = load_garment(GARMENTS / f"{name}.obj")
    bodies = sorted(BODY.held_out_bodies, key=build)
    bodies = np.stack([bodies[0], *bodies[10:50:10], bodies[-1]])
    graded = GarmentGrading(garment, BODY).graded(bodies)
    maker = BodySurface(BODY.vertices(BODY.garment_body), BODY.faces).closest(garment.vertices).distance
    normals = face_normals(garment.vertices, garment.faces)
    for coefficients, vertices in zip(bodies, graded, strict=True):
        ratio = face_areas(vertices, garment.faces) / garment.face_areas
        assert 0.3 < ratio.min() and ratio.max() < 2.4
        assert (normals * face_normals(vertices, garment.faces)).sum(axis=1).min() > 0.7
        distance = BodySurface(BODY.vertices(coefficients), BODY.faces).closest(vertices).distance
        assert (distance < 0).mean() < 0.005
        assert np.abs(distance - maker)[maker < 0.03].mean() < 0.01


@pytest.mark.parametrize("name", ["tshirt", "trousers"])
def test_children_wear_garments_in_their_size(name):
    """Below 1.15 m, the smallest and others: no folds, nothing inside, and the garment's ease, in proportion.
    Faces are a quarter to half as large: a garment at 0.55 to 0.7 of its scale."""
    garment = load_garment(GARMENTS / f"{name}.obj")
    statures = BODY.statures(BODY.held_out_children)
    children = BODY.held_out_children[statures.argsort()[:3]]
    maker = BodySurface(BODY.vertices(BODY.garment_body), BODY.faces).closest(garment.vertices).distance
    normals = face_normals(garment.vertices, garment.faces)
    for coefficients, vertices in zip(children, GarmentGrading(garment, BODY).graded(children), strict=True):
        scale = BODY.statures(coefficients[None])[0] / BODY.statures(BODY.garment_body[None])[0]
        ratio = face_areas(vertices, garment.faces).sum() / garment.face_areas.sum()
        assert 0.25 < ratio < 0.55
        assert (normals * face_normals(vertices, garment.faces)).sum(axis=1).min() > 0.5
        distance = BodySurface(BODY.vertices(coefficients), BODY.faces).closest(vertices).distance
        assert (distance < 0).mean() < 0.005
        assert np.abs(distance - scale * maker)[maker < 0.03].mean() < 0.01


def face_normals(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def trainer(tmp_path_factory):
    config = small_config(tmp_path_factory.mktemp("run"), full_encoding=1.0, growth=0.0, prune_from=0.0)
    return Trainer(config, CPU)


def at_rest(trainer, fits, body, made):
    """Plain skinning at the canonical pose, and the rest shapes, (B, n, 3) each."""
    worn = fits.worn(body, made)
    bones = torch.eye(3, 4).expand(len(body), len(BODY.rig.bone_names), 3, 4)
    nodes = trainer.drape.posed_nodes(bones, worn.node_positions)
    with torch.no_grad():
        return trainer.drape.skin(nodes, worn.rest), worn.rest.vertices, nodes, worn


def test_plain_skinning_at_the_canonical_pose_is_the_graded_garment(trainer):
    """Made to measure, cloth rests on its own body; at the template it is skinned as without any fit."""
    body = torch.tensor([2, 0, 1])
    skinned, rest, nodes, worn = at_rest(trainer, trainer.fits, body, torch.tensor([True, True, False]))
    graded = GarmentGrading(trainer.garment, BODY).graded(BODY.train_bodies[[2, 0]])
    np.testing.assert_allclose(rest[:2], graded, atol=1e-6)
    np.testing.assert_allclose(skinned[:2], graded, atol=1e-5)
    with torch.no_grad():
        plain = trainer.drape.skin(nodes)
    np.testing.assert_allclose(skinned[2], plain[2], atol=1e-5)
    np.testing.assert_array_equal(worn.node_positions[2], trainer.drape.node_positions(trainer.bodies)[1])
    np.testing.assert_array_equal(worn.rows, [3, 1, 0])
    np.testing.assert_allclose(trainer.fits.shapes[worn.rows], rest, atol=1e-6)


def test_children_never_wear_one_size(trainer, monkeypatch):
    """Every second body of a step wears what is made to measure; of children all do, and the networks are told so."""
    child = BODY.held_out_children[BODY.statures(BODY.held_out_children).argmin()]
    bodies = BodySet(BODY, np.stack([BODY.held_out_bodies[0], child]), CPU)
    fits = MadeToMeasure(trainer.garment, trainer.drape, bodies, BODY)
    assert fits.small.tolist() == [False, True]
    encoder, given = trainer.drape.networks.hyper_modulator, []
    monkeypatch.setattr(
        encoder, "forward", lambda *inputs: given.append(inputs[2]) or type(encoder).forward(encoder, *inputs)
    )
    for small in (False, True):
        monkeypatch.setattr(trainer.fits, "small", torch.full_like(trainer.fits.small, small))
        trainer.take_step()
        worn = (trainer.losses.rest_row > 0).view(len(trainer.made), -1)
        assert worn.all(dim=1).tolist() == given[-1].bool().tolist() == (trainer.made | small).tolist()


def test_a_fit_between_is_between(trainer):
    """Rest shapes, and plain skinning of them at the canonical pose, a quarter of the way."""
    body, made = torch.tensor([1]), torch.tensor([True])
    quarter = MadeToMeasure(trainer.garment, trainer.drape, trainer.bodies, BODY, fit=0.25)
    ends = [at_rest(trainer, trainer.fits, body, torch.tensor([fit])) for fit in (False, True)]
    between = at_rest(trainer, quarter, body, made)
    for index in range(2):
        expected = 0.75 * ends[0][index] + 0.25 * ends[1][index]
        np.testing.assert_allclose(between[index], expected, atol=1e-5)


def test_a_step_trains_half_the_bodies_made_to_measure(trainer):
    """One body of two, with its own rest shape; the fit is learnt, and validation says both."""
    steps = trainer.run(4)
    next(steps)
    rows = trainer.losses.rest_row.clone()
    assert (rows[:2] == 0).all() and rows[2] == rows[3] and 1 <= rows[3] <= len(trainer.bodies), "two samples a body"
    assert trainer.validation.made_to_measure is None
    list(steps)
    assert trainer.drape.networks.hyper_modulator.fit.abs().min() > 0
    made, both = trainer.validation.made_to_measure, trainer.validation_energy
    assert math.isfinite(both) and made != pytest.approx(both, rel=1e-3)
