"""Skin that shows: none at rest, a patch where the cloth has sunk in, none under a lifted hem or inside a limb."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_models import tube

from physkin_core import Garment, load_body_model, load_garment_model
from physkin_core.model.surface_paths import mesh_edges
from physkin_training.evaluate.skin_shows import HEM, SkinShows, covered_faces
from physkin_training.physics.surface_queries import covering_faces
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

BODY = load_body_model()
MAKERS = BODY.vertices(BODY.garment_body).astype(np.float64)
SHIRT = load_garment_model("tshirt").garment
CHEST = np.array([0.13, 0.0, 0.32])


def measured(garment, samples):
    """On the garment maker's body, `samples` times, in the canonical pose."""
    posed = PosedBodies(BODY, BodySet(BODY, BODY.garment_body[None], torch.device("cpu")), samples)
    posed.pose(torch.tensor(BODY.rig.rest, dtype=torch.float32).expand(samples, -1).contiguous())
    return SkinShows(garment, BODY, posed), posed


def as_tensor(*drapes):
    return torch.tensor(np.stack(drapes), dtype=torch.float32)


def test_a_patch_that_sank_in_shows_and_a_lifted_hem_does_not():
    """One batch: the shirt as it lies, with a patch of the chest 5 cm inwards, and with its hem pulled up by 12 cm."""
    skin, _ = measured(SHIRT, 3)
    sunk, lifted = SHIRT.vertices.copy(), SHIRT.vertices.copy()
    sunk[np.linalg.norm(sunk - CHEST, axis=1) < 0.08] -= [0.05, 0.0, 0.0]
    waist = lifted[:, 2].min() + 0.4
    lower = lifted[:, 2] < waist
    lifted[lower, 2] = waist - 0.7 * (waist - lifted[lower, 2])
    overlapped = skin.overlapped()
    shows, in_sight = (flags.numpy() for flags in skin.shows(as_tensor(SHIRT.vertices, sunk, lifted), overlapped))
    assert not overlapped.any()
    triangles = MAKERS[BODY.faces[skin.points.face.numpy()]]
    centres, normals = triangles.mean(axis=1), np.cross(*np.moveaxis(np.diff(triangles, axis=1), 1, 0))
    away = np.linalg.norm(centres - CHEST, axis=1)
    assert not shows[0].any() and not shows[2].any()
    assert shows[1][away < 0.055].all() and not shows[1][away > 0.1].any() and (away < 0.055).sum() > 10
    assert np.array_equal(shows, in_sight), "nothing stands before the chest"
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bare = covering_faces(centres, normals, lifted, SHIRT.faces, 0.1) < 0
    assert bare.sum() > 100, "no cloth lies over the belly there, but the hem above it may be lifted"
    areas = np.linalg.norm(np.cross(*np.moveaxis(np.diff(triangles, axis=1), 1, 0)), axis=1)
    figures = skin.figures(as_tensor(SHIRT.vertices, sunk, lifted), overlapped)
    expected = 100 * areas[shows[1]].sum() / areas.sum()
    assert figures["skin_shows_percent"].tolist() == [0, pytest.approx(expected, rel=1e-4), 0]


def test_skin_inside_another_limb_does_not_count():
    """Without cloth all skin shows that is not inside a limb, and that is 100 %; some of it faces other skin."""
    skin, posed = measured(SHIRT, 8)
    rng = np.random.default_rng(0)
    poses = rng.uniform(BODY.rig.lower, BODY.rig.upper, size=(8, len(BODY.rig.rest)))
    posed.pose(torch.tensor(poses, dtype=torch.float32))
    overlapped = skin.overlapped()
    gone = as_tensor(*[SHIRT.vertices + [0.0, 0.0, 5.0]] * 8)
    shows, in_sight = skin.shows(gone, overlapped)
    assert overlapped.any(dim=1).sum() > 2 and torch.equal(shows, ~overlapped)
    assert not (in_sight & ~shows).any() and 0.5 < in_sight.sum() / shows.sum() < 0.99
    figures = skin.figures(gone, overlapped)
    assert figures["skin_shows_percent"].numpy() == pytest.approx(100, rel=1e-5)
    assert (figures["skin_in_sight_percent"] < 99.9).all()


def test_what_is_covered_at_rest_ends_before_the_hems():
    """Skin under the shirt, all of the trunk between its hems; no neck, forearm or hand, though these are beside it."""
    covered = covered_faces(SHIRT, MAKERS, BODY.faces)
    centres = MAKERS[BODY.faces[covered]].mean(axis=1)
    boundary = SHIRT.vertices[np.unique(mesh_edges(SHIRT.faces)[0][mesh_edges(SHIRT.faces)[1] == 1])]
    gaps = np.linalg.norm(centres[:, None] - boundary[None], axis=2).min(axis=1)
    assert gaps.min() > 0.6 * HEM and np.abs(centres[:, 1]).max() < np.abs(SHIRT.vertices[:, 1]).max()
    trunk = MAKERS[BODY.faces].mean(axis=1)
    trunk = np.flatnonzero((np.abs(trunk[:, 1]) < 0.1) & (trunk[:, 2] > 0.05) & (trunk[:, 2] < 0.35))
    assert len(trunk) > 100 and np.isin(trunk, covered).all()


def test_a_garment_all_hem_covers_nothing_and_shows_nothing():
    band = tube(rings=3, segments=20, radius=1.0, height=0.04)
    band = Garment(band.vertices * [0.16, 0.2, 1.0] + [0, 0, 0.12], band.faces)
    skin, _ = measured(band, 1)
    figures = skin.figures(as_tensor(band.vertices), skin.overlapped())
    assert {name: values.tolist() for name, values in figures.items()} == {
        "skin_shows_percent": [0],
        "skin_in_sight_percent": [0],
    }
