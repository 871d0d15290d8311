"""Binding to a body, and binding another mesh or point set of the same garment to the trained garment nodes."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import point_cloud_utils
import pytest
import trimesh
from random_models import random_avatar, random_model, tube

from physkin_core import Draper, avatar_from_body, load_body_model
from physkin_core.model.garment import vertex_normals
from physkin_core.model.garment_nodes import closest_bones
from physkin_core.runtime import binding
from physkin_core.runtime.binding import bind_garment, bind_points

pytestmark = pytest.mark.usefixtures("exact_network_weights")

BODY = load_body_model()
RIG = BODY.rig


@pytest.fixture(scope="module")
def model():
    """A belly band of 2,080 vertices on the default rig, garment nodes on their closest bones, 8 influences."""
    rng = np.random.default_rng(0)
    garment = tube(rings=40, segments=52, radius=0.16, height=0.5)
    model = random_model(rng, rig=RIG, garment=garment, nodes=48, influences=8, correction=0.01, detail_nodes=60)
    distance = np.linalg.norm(garment.vertices[:, None] - model.node_rest, axis=-1)
    weights = np.exp(-np.take_along_axis(distance, model.influence_nodes.astype(int), axis=1) / 0.05)
    return replace(
        model,
        node_bone=closest_bones(model.node_rest, RIG.heads, RIG.tails),
        influence_weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        detail=replace(model.detail, offsets=model.detail.offsets * np.float32(0.1)),
    )


@pytest.fixture(scope="module")
def avatar():
    return avatar_from_body(BODY, BODY.held_out_bodies[0])


@pytest.fixture(scope="module")
def trained(model, avatar):
    """Drapes of the garment itself: of each pose, what is draped."""
    rng, draper = np.random.default_rng(1), Draper(model, avatar, precision="fp32")
    poses = [rng.uniform(0.5 * RIG.lower, 0.5 * RIG.upper).astype(np.float32) for _ in range(3)]
    return [(pose, draper.drape(pose)) for pose in poses]


def surface_distance(points, vertices, faces):
    surface = trimesh.Trimesh(vertices, faces, process=False)
    return trimesh.proximity.closest_point(surface, points)[1]


# --- Another mesh of the same garment ---


def finer(garment):
    return trimesh.Trimesh(garment.vertices, garment.faces, process=False).subdivide().vertices


def coarser(garment):
    """Other triangles altogether: their corners touch the trained surface only by chance."""
    return tube(rings=9, segments=15, radius=0.16, height=0.5).vertices


def cropped(garment):
    mesh = trimesh.Trimesh(garment.vertices, garment.faces, process=False)
    return mesh.submesh([np.flatnonzero(mesh.triangles_center[:, 2] > 0.05)], append=True).vertices


def point_cloud(garment):
    """Points anywhere on the surface, in any order."""
    rng = np.random.default_rng(2)
    corners = garment.vertices[garment.faces[rng.integers(0, len(garment.faces), 500)]]
    return np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), size=500), corners)


@pytest.mark.parametrize("other", [finer, coarser, cropped, point_cloud], ids=lambda f: f.__name__)
def test_other_meshes_drape_onto_the_trained_surface(model, avatar, trained, other):
    """Within a fraction of a millimetre of the trained garment's drape on average, beyond what they were apart at rest;
    in a sharp fold, whose corner the trained triangles cut off, several. The garment itself moves by decimetres.
    Contact folds it more: detail nodes beside each other move by as much as each of them lacks."""
    points = np.asarray(other(model.garment))
    gap = surface_distance(points, model.garment.vertices, model.garment.faces)
    draper = Draper(model, avatar, points=points)
    for pose, expected in trained:
        draped, cloth = draper.drape(pose), expected[:, :3]
        assert draped.shape == (len(points), 6)
        distance = surface_distance(draped[:, :3], cloth, model.garment.faces)
        beyond = distance - gap
        assert beyond.mean() < 9e-4 and np.quantile(beyond, 0.95) < 4e-3 and beyond.max() < 1.5e-2
        assert np.linalg.norm(cloth - model.garment.vertices, axis=1).max() > 0.1


def test_points_off_the_surface_stay_off_it(model, avatar, trained):
    """Splat centres 15 mm outside move with the cloth under them and keep about their distance."""
    garment = model.garment
    points = garment.vertices + 0.015 * vertex_normals(garment.vertices, garment.faces)
    draper = Draper(model, avatar, points=points)
    for pose, cloth in trained:
        offset = draper.drape(pose)[:, :3] - cloth[:, :3]
        outside = (offset * cloth[:, 3:]).sum(axis=1)
        assert np.median(outside) == pytest.approx(0.015, abs=0.002)
        assert np.linalg.norm(offset, axis=1).max() < 0.03


def test_weights_are_interpolated_in_the_face(model):
    """At barycentric coordinates (a, b, c) of a face: a, b, c times its corners' weights, the 8 largest of them."""
    rng = np.random.default_rng(3)
    garment = model.garment
    faces = rng.integers(0, len(garment.faces), 30)
    shares = rng.dirichlet(np.ones(3), size=30)
    points = np.einsum("nc,nci->ni", shares, garment.vertices[garment.faces[faces]])
    bound = bind_points(model, points)
    for index, (face, share) in enumerate(zip(faces, shares)):
        expected = np.zeros(len(model.node_rest))
        for corner, part in zip(garment.faces[face], share):
            for node, weight in zip(model.influence_nodes[corner], model.influence_weights[corner]):
                expected[node] += part * weight
        expected[np.argsort(-expected)[8:]] = 0
        found = np.zeros(len(model.node_rest))
        np.add.at(found, bound["influence_nodes"][index], bound["influence_weights"][index])
        np.testing.assert_allclose(found, expected / expected.sum(), atol=1e-5)


def test_normals_are_those_of_the_surface_or_those_given(model, monkeypatch):
    """At unit length, and the same where points are bound in parts."""
    points = finer(model.garment)
    bound = bind_points(model, points)
    around = points * [1, 1, 0]
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    assert (bound["normals"] * around).sum(axis=1).min() > 0.99
    given = bind_points(model, points, normals=np.tile([0.0, 3.0, 4.0], (len(points), 1)))["normals"]
    np.testing.assert_allclose(given, np.tile([0, 0.6, 0.8], (len(points), 1)), atol=1e-6)
    monkeypatch.setattr(binding, "WEIGHTS_AT_ONCE", 50_000)
    for name, array in bind_points(model, points).items():
        np.testing.assert_array_equal(array, bound[name], err_msg=name)


def test_given_normals_turn_as_the_model_s_are_fitted(model):
    """By one rotation for all here: those of the surface, left out or given, and others."""
    garment, own = model.garment, vertex_normals(model.garment.vertices, model.garment.faces)
    turned = own @ np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])  # of a tube around the z axis
    fitted = replace(model, rest_normals=turned.astype(np.float32))
    for given in (None, own):
        bound = bind_points(fitted, garment.vertices, normals=given)
        np.testing.assert_allclose(bound["normals"], turned, atol=1e-5)
    across = np.cross(own, turned)  # the axis of each turn, which it leaves alone
    bound = bind_points(fitted, garment.vertices, normals=across)
    np.testing.assert_allclose(bound["normals"], across / np.linalg.norm(across, axis=1, keepdims=True), atol=1e-4)


@pytest.mark.parametrize(
    "points, normals, message",
    [
        *((points, None, r"must be a finite, non-empty \(n, 3\) array, got shape")
          for points in (np.zeros((0, 3)), np.zeros(3), np.zeros((5, 2)), [[0.16, 0, np.nan]], [[np.inf, 0, 0]])),
        *((np.full((20, 3), 0.0), normals, "normals")
          for normals in (np.ones((7, 3)), np.ones((1, 3)), np.full((20, 3), np.nan),
                          np.ones((20, 3)) * (np.arange(20) != 5)[:, None])),
    ],
)  # fmt: skip
def test_points_and_normals_must_be_finite_and_three_dimensional(model, points, normals, message):
    points = points if normals is None else model.garment.vertices[:20]
    with pytest.raises(ValueError, match=message):
        bind_points(model, points, normals=normals)


def test_far_points_are_refused(model, monkeypatch):
    """5 cm are allowed; the message says which point, how far, and what to look for. Centimetres are refused by the
    bounding box, before any closest point is looked for."""
    outwards = model.garment.vertices[100] * [1, 1, 0] / 0.16
    near, far = (model.garment.vertices[100] + distance * outwards for distance in (0.049, 0.052))
    assert len(bind_points(model, [near, near])["vertices"]) == 2
    with pytest.raises(ValueError, match=r"point 1 is 5\.2 cm from garment 'random', at most 5 cm.*in metres\?"):
        bind_points(model, [near, far])
    monkeypatch.setattr(point_cloud_utils, "closest_points_on_mesh", None)
    with pytest.raises(ValueError, match=r"is at least \d+\.\d cm from garment 'random'.* in metres\?"):
        bind_points(model, 100 * model.garment.vertices)


def test_encoding_a_body_is_logged(model, avatar, caplog):
    """It takes its time."""
    with caplog.at_level(logging.INFO):
        bind_garment(model, avatar)
    assert f"encoded body {avatar.source} for random in" in caplog.text


def test_an_avatar_of_another_rig_is_refused(model, avatar):
    rng = np.random.default_rng(5)
    other = random_model(rng, bones=7)
    with pytest.raises(ValueError, match="avatar random body has 7 bones, the rig of 'random' has 36"):
        bind_garment(model, random_avatar(rng, other.rig))
    with pytest.raises(ValueError, match="its bone 'tail' is 'head' there"):
        bind_garment(model, replace(avatar, bone_names=(*RIG.bone_names[:-1], "tail")))
