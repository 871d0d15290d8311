"""Figures of what the page shows, and the bands of colour that they are drawn in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from physkin_core.check.garment_check import rest_check
from physkin_core.quality import edge_strain
from physkin_core.view.scene.figures import OutfitFigures, look_at_contact
from physkin_core.view.scene.heat_map import SKIN_BANDS, STRAIN_BANDS, parts_of
from physkin_core.view.scene.scene_state import SceneState


@pytest.fixture(scope="module")
def dressed(asset_loader):
    """A T-shirt at rest: its figures, and the frame."""
    state = SceneState(asset_loader, ["tshirt"])
    return OutfitFigures(state.outfit), state.advance(0.0)


def test_strain_is_the_cores(dressed):
    figures, frame = dressed
    (strain,) = figures.strains(frame)
    expected = edge_strain(frame.outfit.layers[0].rest_garment, frame.cloth[0][:, :3])
    assert strain.mean() == pytest.approx(float(expected), rel=1e-5)


def test_strain_of_what_is_given_is_that_of_the_whole(asset_loader):
    """A T-shirt under a dress, some of it left out: edge by edge what the whole has, but at a seam whose other side is
    left out: an edge there is as long as both sides on average."""
    state = SceneState(asset_loader, ["tshirt", "dress"])
    layer = state.outfit.layers[0]
    assert 0 < layer.vertex_count < len(layer.rest)
    part, whole = layer.visible_garment, layer.rest_garment
    np.testing.assert_array_equal(part.faces, layer.faces)
    np.testing.assert_array_equal(part.vertices, whole.vertices[layer.visible])
    lengths = dict(zip(map(tuple, whole.edges.tolist()), whole.edge_lengths))
    found = [lengths[tuple(edge)] for edge in layer.visible[part.edges].tolist()]
    np.testing.assert_allclose(part.edge_lengths, found, rtol=0.01)
    assert np.isclose(part.edge_lengths, found).mean() > 0.8
    assert [len(strain) for strain in OutfitFigures(state.outfit).strains(state.advance(0.0))][0] == len(part.edges)


def test_stretched_cloth_shows_where_it_is_stretched(dressed):
    """One vertex pulled out by 5 cm: the faces about it are in the last band, faces elsewhere are as they were."""
    figures, frame = dressed
    (before,) = figures.strains_of_faces(frame)
    pulled = frame.cloth[0].copy()
    pulled[100, :3] += 0.05 * pulled[100, 3:]
    (after,) = figures.strains_of_faces(replace(frame, cloth=(pulled,)))
    near = (frame.outfit.layers[0].faces == 100).any(axis=1)
    assert (STRAIN_BANDS.band(after)[near] == len(STRAIN_BANDS.limits)).all()
    assert (after != before).mean() < 0.02


def test_contact_is_what_check_finds(dressed):
    """On the body at rest as it is, not as it is drawn, and with a bump that comes through the cloth."""
    figures, frame = dressed
    question = figures.question(frame)
    own, faces = question["body"], frame.outfit.avatar.faces
    pose = frame.outfit.bone_transforms(frame.pose.positions)
    np.testing.assert_array_equal(own, frame.outfit.avatar.posed_vertices(pose))
    assert not np.allclose(own, frame.body, atol=1e-3)
    chest = np.linalg.norm(own - frame.cloth[0][np.argmax(frame.cloth[0][:, 0]), :3], axis=1) < 0.08
    for body in (own, own + 0.05 * chest[:, None] * np.array([1.0, 0.0, 0.0], dtype=np.float32)):
        found = look_at_contact(**(question | {"body": body}))
        expected = rest_check(figures.outfit.layers[0].rest_garment, frame.cloth[0][:, :3], body, faces)
        assert found.inside_percent == pytest.approx(expected.inside_percent)
        assert found.deepest_mm == pytest.approx(expected.deepest_mm, rel=1e-4)
        assert found.skin_shows_percent == pytest.approx(expected.skin_shows_percent)
    assert found.inside_percent > 0.1 and found.skin_shows.any() and found.skin_shows.mean() < 0.05


def test_bands_part_a_mesh():
    """Each face is in the part of its band, with the vertices it uses; a band without faces is an empty part."""
    assert STRAIN_BANDS.band(np.array([0.0, 2.0, 4.9, 39.9, 40.0, 400.0])).tolist() == [0, 1, 1, 4, 5, 5]
    for bands in (STRAIN_BANDS, SKIN_BANDS):
        assert len(bands.colours) == len(bands.labels) == len(bands.limits) + 1
    vertices = np.arange(15.0).reshape(5, 3)
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4]])
    band = np.array([2, 0, 2])
    parts = parts_of(faces, band, bands=3, vertex_count=5)
    for k, part in enumerate(parts):
        np.testing.assert_array_equal(vertices[part.vertices][part.faces], vertices[faces[band == k]])
    assert parts[1].faces.shape == (0, 3) and parts[0].vertices.tolist() == [1, 2, 3]
