"""Splats on a garment follow its cloth."""

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_detail
from scipy.spatial.transform import Rotation

from physkin_core import (
    BUNDLED_AVATAR,
    Draper,
    SplatDraper,
    Splats,
    load_avatar,
    load_body_model,
    load_garment_model,
    load_motion,
)
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.points.splat_draper import SplatSkinner, bind_splats

pytestmark = pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")

BODY = load_body_model()
ROUND = np.array([0.004, 0.004, 0.004])


def splats_at(points, scales=ROUND):
    rng = np.random.default_rng(0)
    return Splats(points, rng.normal(size=(len(points), 4)), np.tile(scales, (len(points), 1)))


def splats_in(worn, skinner, pose):
    worn.drape(pose)
    return skinner.skin(worn.node_transforms(), worn.detail_offsets())


@pytest.fixture(scope="module")
def avatar():
    return load_avatar(BUNDLED_AVATAR, BODY.rig)


@pytest.fixture(scope="module")
def tshirt():
    return load_garment_model("tshirt")


@pytest.fixture(scope="module")
def worn(tshirt, avatar):
    """The shipped T-shirt, made to measure."""
    return Draper(tshirt, avatar)


@pytest.fixture(scope="module")
def poses(tshirt):
    motion = load_motion("dance")
    return [(motion.positions_for(tshirt.rig)[frame], motion.gravity[frame]) for frame in (0, 20, 60)]


def test_splats_follow_the_garment_nodes_of_a_drape(tshirt, avatar, worn, poses):
    splats = splats_at(tshirt.garment.vertices[:50], scales=(0.004, 0.002, 0.001))
    draper, skinner = SplatDraper(tshirt, avatar, splats), SplatSkinner(bind_splats(worn.layer, splats))
    assert draper.splat_count == skinner.splat_count == 50
    for pose in poses:
        worn.drape(*pose)
        found, expected = skinner.skin(worn.node_transforms(), worn.detail_offsets()), draper.drape(*pose)
        for name in ("centres", "rotations", "scales"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-5)


def test_centres_on_vertices_are_the_drape(tshirt, avatar, poses):
    """Of a garment made to measure, too: centres are carried to the rest shape that is worn."""
    worn = Draper(tshirt, avatar)
    skinner = SplatSkinner(bind_splats(worn.layer, splats_at(tshirt.garment.vertices)))
    for pose in poses:
        cloth = worn.drape(*pose)[:, :3]
        np.testing.assert_allclose(
            skinner.skin(worn.node_transforms(), worn.detail_offsets()).centres, cloth, atol=2e-6
        )


def test_centres_on_vertices_go_off_the_skin(tshirt, avatar, worn, poses):
    """As vertices do, which contact moves by centimetres here: within a millimetre."""
    draper = SplatDraper(tshirt, avatar, splats_at(tshirt.garment.vertices))
    for pose in poses:
        apart = np.linalg.norm(draper.drape(*pose).centres - worn.drape(*pose)[:, :3], axis=1)
        assert apart.max() < 0.001, f"up to {1000 * apart.max():.1f} mm"


def test_centres_go_with_detail(tshirt, avatar, poses):
    """As the garment's vertices, in whatever precision it is."""
    width = len(tshirt.node_deformer[-2][1])
    detail = random_detail(np.random.default_rng(2), tshirt.garment, 60, width=width, offset=0.004)
    worn = Draper(replace(tshirt, detail=detail), avatar, precision="bf16")
    skinner = SplatSkinner(bind_splats(worn.layer, splats_at(tshirt.garment.vertices)))
    cloth = worn.drape(*poses[1])[:, :3]
    nodes, offsets = worn.node_transforms(), worn.detail_offsets()
    np.testing.assert_allclose(skinner.skin(nodes, offsets).centres, cloth, atol=2e-6)
    assert np.abs(skinner.skin(nodes, 0 * offsets).centres - cloth).max() > 0.01


def test_rigid_cloth_turns_splats_rigidly(garment_model):
    """All garment nodes on one bone, without corrections, and no skin in the way: what the bone does between two poses,
    splats do."""
    *hidden, (weight, bias) = garment_model.node_deformer
    spine = BODY.rig.bone_names.index("spine03")
    stiff = replace(
        garment_model,
        node_bone=np.full_like(garment_model.node_bone, spine),
        node_deformer=(*hidden, (0 * weight, 0 * bias)),
    )
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[0])
    splats = splats_at(stiff.garment.vertices[::20], np.array([0.008, 0.004, 0.001]))
    worn = Draper(stiff, avatar)
    skinner, free = SplatSkinner(bind_splats(worn.layer, splats)), worn.layer.bound_visible.without_contact
    worn.outfit = worn.outfit.with_bound_garment(0, free)
    rng = np.random.default_rng(1)
    start, end = (rng.uniform(0.5 * BODY.rig.lower, 0.5 * BODY.rig.upper) for _ in range(2))
    before, after = (splats_in(worn, skinner, pose) for pose in (start, end))
    bones = [BODY.rig.bone_transforms(pose, heads=avatar.bone_heads)[spine] for pose in (start, end)]
    turn = bones[1][:, :3] @ bones[0][:, :3].T
    assert np.degrees(Rotation.from_matrix(turn).magnitude()) > 5
    expected = (before.centres - bones[0][:, 3]) @ turn.T + bones[1][:, 3]
    np.testing.assert_allclose(after.centres, expected, atol=2e-6)
    np.testing.assert_allclose(after.scales, before.scales, rtol=5e-4)
    turned = (
        Rotation.from_quat(after.rotations) * (Rotation.from_matrix(turn) * Rotation.from_quat(before.rotations)).inv()
    )
    assert turned.magnitude().max() < 2e-3


def test_splats_stretch_as_the_cloth_does(tshirt, worn, poses):
    """A flat splat on every fifth triangle becomes what the draped triangle makes of it, but for a fraction of the
    strain: inside a triangle the cloth is skinned, not flat."""
    garment = tshirt.garment
    faces = garment.faces[::5]
    corners = garment.vertices[faces]
    flat = frames(corners)
    quaternions = Rotation.from_matrix(flat / np.linalg.norm(flat, axis=1, keepdims=True)).as_quat()
    splats = Splats(corners.mean(axis=1), quaternions, np.tile([0.004, 0.004, 1e-5], (len(faces), 1)))
    skinner = SplatSkinner(bind_splats(worn.layer, splats))
    for pose in poses:
        map_of_triangles = frames(worn.drape(*pose)[:, :3][faces]) @ np.linalg.inv(flat)
        found = skinner.skin(worn.node_transforms(), worn.detail_offsets())
        spokes = map_of_triangles @ splats.axes() * splats.scales[:, None]
        expected = np.linalg.svd(spokes, compute_uv=False)[:, :2]
        strain = np.abs(expected / 0.004 - 1)
        beyond = np.abs(np.sort(found.scales, axis=1)[:, :0:-1] / expected - 1)
        assert np.median(beyond) < 0.5 * np.median(strain) and np.median(strain) > 0.02
        normal, across = map_normal(spokes), found.axes()[:, :, 2]
        assert np.quantile(np.abs((normal * across).sum(axis=1)), 0.05) > np.cos(np.radians(12))


def frames(corners):
    """(f, 3, 3) of triangles (f, 3, 3): two edges and the unit normal, as columns."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    return np.stack([first, second, normal / np.linalg.norm(normal, axis=1, keepdims=True)], axis=2)


def map_normal(spokes):
    normal = np.cross(spokes[:, :, 0], spokes[:, :, 1])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_far_splats_are_refused_by_their_own_number(garment_model, avatar):
    """And those within 5 cm are taken, whichever way their axes point."""
    vertices = garment_model.garment.vertices[:4].copy()
    normal = garment_model.rest_normals[0].astype(float)
    near = np.concatenate([vertices, vertices[:1] + 0.0495 * normal])
    SplatDraper(garment_model, avatar, splats_at(near), fit=0)
    vertices[2] += [0, 0, 3.0]
    with pytest.raises(ValueError, match=r"point 2 is at least .* cm from garment 'vest'.* 1 of 4 points"):
        SplatDraper(garment_model, avatar, splats_at(vertices), fit=0)
