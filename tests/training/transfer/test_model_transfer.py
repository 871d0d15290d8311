"""A shipped model on another garment."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import Draper, Garment, load_garment_model
from physkin_core.model.model_file import save_garment_model
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_training.transfer.matched_folds import Counterparts, match_folds
from physkin_training.transfer.model_transfer import transferred_model


@pytest.fixture(scope="module")
def tank_top():
    return load_garment_model("tanktop")


def shuffled(garment: Garment, kept: np.ndarray) -> tuple[Garment, np.ndarray]:
    """Some faces (f,) bool of a garment, its vertices in another order: also which ones they were."""
    used, faces = np.unique(garment.faces[kept], return_inverse=True)
    order = np.random.default_rng(0).permutation(len(used))
    return Garment(garment.vertices[used[order]], np.argsort(order)[faces.reshape(-1, 3)]), used[order]


def test_a_cropped_garment_drapes_as_the_whole(tank_top, template, tmp_path):
    """Its cloth stays where it lies; and it can be stored."""
    whole = tank_top.garment
    kept = whole.vertices[whole.faces][:, :, 2].mean(axis=1) > 0.1
    garment, vertices = shuffled(whole, kept)
    model = transferred_model(tank_top, garment, name="cropped")
    save_garment_model(model, tmp_path / "cropped.safetensors")
    model = load_garment_model(tmp_path / "cropped.safetensors")
    assert model.name == "cropped" and model.training["transferred_from"] == "tanktop" and not model.scores
    positions, gravity = everyday_poses(model.rig)
    own, other = (Draper(each, template, fit=0.0) for each in (model, tank_top))
    apart = own.drape(positions[5], gravity[5])[:, :3] - other.drape(positions[5], gravity[5])[vertices, :3]
    distance = np.linalg.norm(apart, axis=1)
    assert distance.mean() < 2e-3 and distance.max() < 2e-2


def sheet(x: np.ndarray, y: np.ndarray, height: np.ndarray) -> Garment:
    """A grid of points at x (r,) and y (c,), and as high (r,) above them."""
    rows, columns = len(x), len(y)
    corner = np.arange(rows * columns).reshape(rows, columns)[:-1, :-1].reshape(-1, 1)
    faces = np.concatenate([corner + [0, columns, columns + 1], corner + [0, columns + 1, 1]])
    points = np.stack([np.repeat(x, columns), np.tile(y, rows), np.repeat(height, columns)], axis=1)
    return Garment(points, faces)


def test_cloth_is_laid_in_the_folds_of_the_other():
    """A flat sheet on one with ripples of 1 cm ends in these, its edges as long as before."""

    def ripple(x: np.ndarray) -> np.ndarray:
        return 0.01 * np.sin(20 * np.pi * x)

    x, y = np.arange(-25, 26) / 100, np.arange(-15, 16) / 100
    flat, other = sheet(0.8 * x, y[3:-3], 0 * x), sheet(x, y, ripple(x))
    laid = match_folds(flat, other)
    assert np.abs(laid.vertices[:, 2] - ripple(laid.vertices[:, 0])).mean() < 1e-3 and not laid.torn.any()
    apart = np.linalg.norm(laid.vertices[flat.edges[:, 0]] - laid.vertices[flat.edges[:, 1]], axis=1)
    assert np.abs(apart / flat.edge_lengths - 1).mean() < 0.01


def test_counterparts_face_as_the_cloth_does():
    """Of two sheets 2 cm apart, looking apart, each goes to its own, though shifted nearer to the other."""
    x, y = np.meshgrid(np.arange(5) / 50, np.arange(5) / 50)
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(25)], axis=1)
    corner = (np.arange(20).reshape(4, 5)[:, :4]).reshape(-1, 1)
    up = np.concatenate([corner + [0, 1, 6], corner + [0, 6, 5]])
    faces = np.concatenate([up, up[:, ::-1] + 25])
    lower = flat - [0, 0, 0.02]
    other = Garment(np.concatenate([flat, lower]), faces)
    garment = Garment(np.concatenate([flat - [0, 0, 0.015], lower + [0, 0, 0.013]]), faces)
    there = Counterparts.of(garment, other)
    np.testing.assert_array_equal(there.near[:, 0], np.arange(50))
    np.testing.assert_allclose(there.distance, np.repeat([0.015, 0.013], 25), atol=1e-9)
    np.testing.assert_allclose(there.share.sum(axis=1), 1)
