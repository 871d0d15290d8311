"""Quality figures where they can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from random_models import random_rotation, tube
from reference.inside_by_vertex import inside_by_vertex

from physkin_core import Garment
from physkin_core.quality import (
    area_strain,
    contact_figures,
    edge_strain,
    jitter,
    signed_distance,
)


@pytest.mark.parametrize("factor, edge, area", [(1.0, 0, 0), (1.1, 10, 21), (0.9, 10, 19), (2.0, 100, 300)])
def test_uniform_stretch(factor, edge, area):
    """10 % longer edges are 21 % more area; shorter counts as longer; a rigid motion counts for nothing."""
    garment, rng = tube(), np.random.default_rng(0)
    moved = factor * garment.vertices @ random_rotation(rng).T + rng.normal(size=3)
    assert edge_strain(garment, moved) == pytest.approx(edge, abs=1e-9)
    assert area_strain(garment, moved) == pytest.approx(area, abs=1e-9)


def test_shear_keeps_area_and_samples_stay_apart():
    garment = Garment(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    sheared = garment.vertices @ np.array([[1, 0, 0], [0.5, 1, 0], [0, 0, 1]])
    batch = np.stack([garment.vertices, sheared, 2 * garment.vertices])
    np.testing.assert_allclose(area_strain(garment, batch), [0, 0, 300], atol=1e-9)
    diagonal, side = np.hypot(1.5, 1), np.hypot(0.5, 1)
    expected = 100 * (2 * (side - 1) + (diagonal - 2**0.5) / 2**0.5) / 5
    np.testing.assert_allclose(edge_strain(garment, batch), [0, expected, 100], atol=1e-9)
    assert edge_strain(garment, np.stack([batch, batch])).shape == (2, 3)


def oracle_signed_distance(point, vertices, faces):
    """Every face's closest point (Ericson's regions), the nearest faces' normals weighted by their angle there."""
    found = []
    for face in faces:
        a, b, c = vertices[face]
        normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
        shares = np.linalg.solve(np.c_[b - a, c - a, normal], point - a)[:2]
        candidates = [a + np.c_[b - a, c - a] @ shares] if min(*shares, 1 - shares.sum()) >= 0 else []
        for start, end in ((a, b), (b, c), (c, a)):
            along = np.clip((point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            candidates.append(start + along * (end - start))
        closest = min(candidates, key=lambda candidate: np.linalg.norm(point - candidate))
        arms = [corner - closest for corner in (a, b, c) if np.linalg.norm(corner - closest) > 1e-9]
        inside = len(arms) == 3 and min(np.linalg.norm(np.cross(arms[i], arms[i - 1])) for i in range(3)) > 1e-9
        on_edge = len(arms) == 3 and not inside
        cosine = arms[0] @ arms[1] / np.linalg.norm(arms[0]) / np.linalg.norm(arms[1])
        angle = np.pi if on_edge else 2 * np.pi if inside else np.arccos(cosine)
        found.append((np.linalg.norm(point - closest), angle * normal, closest))
    least, _, closest = min(found, key=lambda entry: entry[0])
    pseudo_normal = sum(normal for distance, normal, _ in found if distance < least + 1e-9)
    return -least if (point - closest) @ pseudo_normal < 0 else least


def test_signed_distance_of_a_single_point():
    """It is the same alone as among others."""
    box = trimesh.creation.box()
    points = np.array([[0.9, 0.1, 0.2], [0.1, 0.3, 0.1]])
    together = signed_distance(points, box.vertices, box.faces)
    np.testing.assert_allclose(together, [0.4, -0.2])
    for point, distance in zip(points, together):
        np.testing.assert_allclose(signed_distance(point[None], box.vertices, box.faces), [distance])


@pytest.mark.parametrize("shape", ["box", "spike", "overlapping balls"])
def test_signed_distance_against_every_face(shape):
    """Points anywhere, above edges, above corners, and micrometres from one, where several faces are all but equally
    near; where balls overlap, the nearer skin says what is inside."""
    rng = np.random.default_rng(0)
    if shape == "overlapping balls":
        ball = trimesh.creation.icosphere(subdivisions=1)
        other = ball.copy().apply_translation([1.2, 0.1, 0])
        vertices = np.concatenate([ball.vertices, other.vertices])
        faces = np.concatenate([ball.faces, other.faces + len(ball.vertices)])
    else:
        body = trimesh.creation.box() if shape == "box" else trimesh.creation.cone(radius=0.2, height=2, sections=5)
        vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    vertices = vertices @ random_rotation(rng).T
    points = rng.uniform(1.3 * vertices.min(axis=0), 1.3 * vertices.max(axis=0), size=(25, 3))
    corners = vertices[faces[rng.integers(0, len(faces), 10)]]
    points = np.concatenate([points, 1.1 * corners[:, 0], 0.55 * (corners[:, 0] + corners[:, 1])])
    points = np.concatenate([points, vertices[0] + rng.uniform(-5e-5, 5e-5, size=(40, 3))])
    expected = [oracle_signed_distance(point, vertices, faces) for point in points]
    np.testing.assert_allclose(signed_distance(points, vertices, faces), expected, atol=1e-7)


def test_inside_by_the_nearest_vertex_against_a_loop():
    """Normals are the sums of the adjoining faces' areas."""
    rng = np.random.default_rng(2)
    cone = trimesh.creation.cone(radius=0.4, height=1, sections=7)
    vertices = np.asarray(cone.vertices) @ random_rotation(rng).T
    points = rng.uniform(vertices.min(axis=0), vertices.max(axis=0), size=(80, 3))
    expected = []
    for point in points:
        nearest = np.linalg.norm(vertices - point, axis=1).argmin()
        normal = sum(
            np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
            for a, b, c in cone.faces
            if nearest in (a, b, c)
        )
        expected.append((point - vertices[nearest]) @ normal < 0)
    assert 10 < sum(expected) < 70
    assert inside_by_vertex(points, vertices, cone.faces).tolist() == expected


def test_contact_figures():
    figures = contact_figures(np.array([[-0.004, 0.0, 0.001], [0.003, 0.1, -0.001]]))
    assert figures == pytest.approx(
        {"inside_percent": 100 * 2 / 6, "within_3mm_percent": 100 * 4 / 6, "max_depth_mm": 4.0}
    )
    assert contact_figures(np.array([0.002, 0.5]))["max_depth_mm"] == 0


def test_jitter_is_the_second_difference():
    """Steady motion has none; constant acceleration a has a; only half the vertices shaking counts half."""
    time = np.arange(10.0)[:, None, None]
    still = np.ones((4, 1)) * np.array([1.0, 2, 3])
    assert jitter(still + 0.3 * time * np.array([1.0, -1, 2])) == pytest.approx(0, abs=1e-12)
    assert jitter(still + 0.5 * time**2 * np.array([0, 3.0, 4])) == pytest.approx(5)
    shaking = np.array([1.0, 1, 0, 0])[:, None] * (-1.0) ** time * np.array([1.0, 0, 0])
    assert jitter(still + shaking) == pytest.approx(2)


def test_jitter_needs_three_frames():
    with pytest.raises(ValueError, match="at least 3 frames, got 2"):
        jitter(np.zeros((2, 5, 3)))
    assert jitter(np.zeros((3, 5, 3))) == 0
