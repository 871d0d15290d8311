"""Bodies of a batch in Warp: kinematics and skinning of the run time, surface points, and the mesh for contacts."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
import warp as wp

from physkin_core import avatar_from_body, load_body_model
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

BODY = load_body_model()
SAMPLES = 5


@pytest.fixture(scope="module")
def bodies():
    wp.config.quiet = True
    return BodySet(BODY, BODY.train_bodies[:3], torch.device("cpu"))


@pytest.fixture(scope="module")
def posed(bodies):
    """Five samples of three bodies in random poses over the limits, the last one at rest."""
    rng = np.random.default_rng(0)
    scene = PosedBodies(BODY, bodies, SAMPLES)
    index = torch.tensor([2, 0, 1, 2, 1])
    rig = BODY.rig
    q = rng.uniform(rig.lower, rig.upper, size=(SAMPLES, len(rig.dofs))).astype(np.float32)
    q[4] = rig.rest
    scene.pose(torch.rand(SAMPLES, q.shape[1]), torch.zeros(SAMPLES, dtype=torch.int64))  # nothing of it may remain
    transforms = scene.pose(torch.as_tensor(q), index).clone()
    return scene, q, index.tolist(), transforms.numpy()


def avatar(index):
    return avatar_from_body(BODY, BODY.train_bodies[index])


def test_skinning_agrees_with_the_avatar(posed):
    """Every bone, and every vertex at its place on the grid."""
    scene, q, index, transforms = posed
    points = scene.mesh.points.numpy().reshape(SAMPLES, -1, 3)
    for sample in range(SAMPLES):
        own = avatar(index[sample])
        bones = BODY.rig.bone_transforms(q[sample], heads=own.bone_heads)
        np.testing.assert_allclose(transforms[sample], bones, atol=2e-5)
        expected = own.posed_vertices(bones)
        np.testing.assert_allclose(points[sample] - scene.offset[sample].numpy(), expected, atol=3e-5)
    moved = points[0] - scene.offset[0].numpy() - avatar(index[0]).vertices
    assert np.abs(moved).max() > 0.3


@pytest.mark.parametrize("positions, of_bodies", [(SAMPLES - 1, SAMPLES - 1), (SAMPLES + 1, SAMPLES), (SAMPLES, 2)])
def test_other_numbers_of_samples_are_refused(posed, positions, of_bodies):
    scene, q, _, _ = posed
    told = f"must be {SAMPLES} each, one a sample; got {positions} and {of_bodies}"
    with pytest.raises(ValueError, match=told):
        scene.pose(torch.zeros(positions, q.shape[1]), torch.zeros(of_bodies, dtype=torch.int64))


def test_samples_cannot_touch_each_other(posed):
    """Far enough apart on the grid for any pose of any body."""
    scene, _, _, _ = posed
    gap = torch.cdist(scene.offset, scene.offset) + 100 * torch.eye(SAMPLES)
    assert gap.min() > 2 * 1.3


def test_surface_points_lie_on_the_surface_evenly(bodies):
    """On the triangles, with the normals of these; the share of points per region is its share of area."""
    torch.manual_seed(0)
    points, normals = bodies.sample_points(torch.tensor([1, 0]), 4000)
    assert points.shape == normals.shape == (2, 4000, 3)
    for row, index in enumerate((1, 0)):
        body = trimesh.Trimesh(bodies.vertices[index].numpy(), BODY.faces, process=False)
        at = points[row].numpy()
        _, distance, face = trimesh.proximity.closest_point(body, at[:300])
        assert distance.max() < 1e-5
        aligned = (body.face_normals[face] * normals[row, :300].numpy()).sum(axis=1)
        assert np.quantile(aligned, 0.05) > 0.999
        for axis, cut in ((2, 0.0), (2, -0.5), (1, 0.0), (1, 0.3)):
            area = body.area_faces[body.triangles_center[:, axis] > cut].sum() / body.area
            assert (at[:, axis] > cut).mean() == pytest.approx(area, abs=0.01)
    another, _ = bodies.sample_points(torch.tensor([1, 0]), 4000)
    assert (another - points).abs().max() > 1e-3


def test_a_swollen_body_lies_outside_itself(bodies):
    """Along the normals, smoothly from part to part; bones stay, and other bodies are as they were."""
    swelling = np.zeros((3, BODY.rig.bone_count))
    swelling[1, BODY.rig.bone_index("spine03")] = 0.015
    swollen = BodySet(BODY, BODY.train_bodies[:3], torch.device("cpu"), swelling=swelling)
    torch.testing.assert_close(swollen.vertices[[0, 2]], bodies.vertices[[0, 2]], rtol=0, atol=0)
    torch.testing.assert_close(swollen.heads, bodies.heads, rtol=0, atol=0)
    moved = (swollen.vertices - bodies.vertices)[1].numpy()
    body = trimesh.Trimesh(bodies.vertices[1].numpy(), BODY.faces, process=False)
    distance = np.linalg.norm(moved, axis=1)
    assert 0.01 < distance.max() < 0.0151 and (distance == 0).mean() > 0.5
    assert np.ptp(distance[body.edges_unique], axis=1).max() < 0.008
    outward = (moved * body.vertex_normals).sum(axis=1)
    assert (outward[distance > 1e-3] > 0.7 * distance[distance > 1e-3]).all()
