"""Push-out: the reference against exact distances, and what it must leave alone."""

import numpy as np
import pytest
from random_models import BACKENDS, random_avatar, random_model, unit_rows

from physkin_core import Draper, avatar_from_body, load_body_model, load_garment_model
from physkin_core.model.garment import vertex_normals
from physkin_core.model.skinning import skin
from physkin_core.quality import signed_distance
from physkin_core.runtime import push_out as module
from physkin_core.runtime.push_out import bind_push_out, displacement, patch_distance, push_out

pytestmark = pytest.mark.usefixtures("exact_network_weights")

BODY = load_body_model()


@pytest.fixture(scope="module")
def worn():
    """The shipped T-shirt on a held-out body: avatar, draper without push-out, and what the push-out is bound to."""
    model = load_garment_model("tshirt")
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[0])
    draper = Draper(model, avatar, backend="numpy")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BIND_POSES", 256)
        bound = bind_push_out(draper.drape, model.rig, avatar)
    return model, avatar, draper, bound


def dented(draper, rig, depth):
    """The drape at rest with a smooth dent all over, up to `depth` [m] deep: positions, normals, bone transforms."""
    cloth = draper.drape(rig.rest).astype(np.float64)
    wave = depth * (0.5 + 0.5 * np.sin(25 * cloth[:, 2]))
    return cloth[:, :3] - wave[:, None] * cloth[:, 3:], cloth[:, 3:].copy(), draper.bone_transforms(rig.rest)


def test_displacement_is_smooth_and_pushes_to_the_clearance():
    """Nothing for what is clear of the body, no step anywhere, slope at most that of full depth."""
    distance = np.linspace(-0.08, 0.02, 20001)
    push = displacement(distance)
    clear = distance >= module.CLEARANCE + module.SOFTNESS
    np.testing.assert_array_equal(push[clear], 0)
    trusted = (distance > -module.TRUSTED_DEPTH) & ~clear
    assert ((distance + push)[trusted] >= module.CLEARANCE - 1e-9).all()
    deep = trusted & (distance < module.CLEARANCE - module.SOFTNESS)
    np.testing.assert_allclose((distance + push)[deep], module.CLEARANCE)
    np.testing.assert_array_equal(push[distance <= -module.LARGEST_DEPTH], 0)
    slope = np.diff(push) / np.diff(distance)
    assert np.abs(np.diff(slope)).max() < 0.01, "the first derivative has a step"


def test_patch_distance_is_the_exact_one():
    """Where the closest triangle is in the patch: sign, size and direction, over faces, edges and corners."""
    random = np.random.default_rng(0)
    for _ in range(50):
        body = random.normal(size=(24, 3))
        patch = np.arange(24).reshape(1, 8, 3)
        point = random.normal(size=(1, 3)) * random.choice([0.1, 1, 3])
        outward = np.tile(unit_rows(random, 1), (24, 1))
        distance, normal, _ = patch_distance(body, outward, patch, point)
        shares = random.dirichlet(np.ones(3), size=(8, 40000))  # brute force: points all over each triangle
        corners = body.reshape(8, 3, 3)
        sampled = np.einsum("tsc,tci->tsi", shares, corners).reshape(-1, 3)
        for k in range(3):
            edge = np.linspace(0, 1, 2000)[:, None]
            sides = [(1 - edge) * c[k] + edge * c[(k + 1) % 3] for c in corners]
            sampled = np.concatenate([sampled, *sides])
        brute = np.linalg.norm(sampled - point, axis=1)
        assert abs(distance[0]) <= brute.min() + 1e-9
        assert abs(distance[0]) >= brute.min() - 0.01
        np.testing.assert_allclose(normal, outward[:1], atol=1e-12)
        assert np.sign(distance[0]) == np.sign((point[0] - sampled[brute.argmin()]) @ outward[0])


def test_a_dented_garment_comes_out(worn):
    """Vertices millimetres inside end up outside by the exact distance, the others stay where they are."""
    model, avatar, draper, bound = worn
    positions, normals, bones = dented(draper, model.rig, 0.008)
    before = positions.copy()
    residual = push_out(bound, bones, positions, normals)
    handled = np.zeros(len(positions), dtype=bool)
    handled[bound.block_vertices[bound.block_vertices >= 0]] = True
    moved = np.linalg.norm(positions - before, axis=1) > 0
    posed = avatar.posed_vertices(bones)
    was, now = (signed_distance(at[handled], posed, avatar.faces) for at in (before, positions))
    assert (was < -0.0005).sum() > 50
    assert now.min() > -0.0005
    assert (residual.deepest, residual.left_inside) == (0, 0)
    assert not moved[~handled].any()
    assert not moved[handled][was > 0.006].any()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert (normals * draper.drape(model.rig.rest)[:, 3:]).sum(axis=1)[moved].min() > 0.3


def test_residual_tells_what_is_left(worn, monkeypatch):
    """Without any push, the deepest vertex and the count are those of the exact distance."""
    model, avatar, draper, bound = worn
    positions, normals, bones = dented(draper, model.rig, 0.008)
    monkeypatch.setattr(module, "ROUNDS", 0)
    residual = push_out(bound, bones, positions, normals)
    handled = bound.block_vertices[bound.block_vertices >= 0]
    exact = signed_distance(positions[handled], avatar.posed_vertices(bones), avatar.faces)
    exact = exact[exact > -module.LARGEST_DEPTH]
    assert residual.deepest == pytest.approx(-exact.min(), rel=0.1)
    assert residual.left_inside == pytest.approx((exact < -0.0005).sum(), rel=0.1)


def test_unworn_parts_do_not_touch_the_cloth(worn):
    """Forearms and hands are no candidates of a T-shirt: an arm through the trunk moves nothing by itself."""
    model, avatar, draper, bound = worn
    dominant = bound.body_bones[np.arange(len(bound.body_bones)), bound.body_weights.argmax(axis=1)]
    touched = {model.rig.bone_names[bone] for bone in dominant[np.unique(bound.candidates)]}
    assert {"spine02", "upperarm01.L", "upperarm01.R"} <= touched
    assert not [name for name in touched if name.startswith(("wrist", "lowerarm02", "foot", "lowerleg"))]


def test_nothing_pops(worn):
    """A dent that deepens in steps of 0.05 mm moves no vertex by more than a few steps, entering contact or deep."""
    model, _, draper, bound = worn
    last, largest = None, 0.0
    for depth in np.arange(0.004, 0.006, 0.00005):
        positions, normals, bones = dented(draper, model.rig, depth)
        push_out(bound, bones, positions, normals)
        if last is not None:
            largest = max(largest, float(np.quantile(np.linalg.norm(positions - last, axis=1), 0.999)))
        last = positions
    assert largest < 0.0005


def test_a_body_is_skinned_as_garments_are():
    """The set-up's matrix products give the points and normals of `skin`."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[3])
    normals = vertex_normals(avatar.vertices, avatar.faces)
    pose = np.random.default_rng(5).uniform(BODY.rig.lower, BODY.rig.upper)
    bones = BODY.rig.bone_transforms(pose, heads=avatar.bone_heads)
    skinned = module._BodySkin(avatar.vertices, normals, avatar.influence_bones, avatar.influence_weights)(bones)
    at_origin = np.zeros((len(bones), 3))
    expected = skin(bones, at_origin, avatar.vertices, normals, avatar.influence_bones, avatar.influence_weights)
    for found, wanted in zip(skinned, expected):
        np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_a_garment_that_hangs_clear_is_left_alone():
    """No body within reach: nothing to do, and both backends accept that."""
    random = np.random.default_rng(3)
    model = random_model(random, correction=0.0)
    avatar = random_avatar(random, model.rig)
    draper = Draper(model, avatar, backend="numpy")
    far = bind_push_out(lambda q, g: draper.drape(q, g) + np.array([9, 0, 0, 0, 0, 0]), model.rig, avatar)
    assert far.block_vertices.shape == (0, module.BLOCK)
    cloth = draper.drape(model.rig.rest).astype(np.float64)
    residual = push_out(far, draper.bone_transforms(model.rig.rest), cloth[:, :3], cloth[:, 3:])
    assert (residual.deepest, residual.left_inside) == (0, 0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_draper_pushes_out_when_asked(backend, monkeypatch):
    """Off by default, without a residual; on, the frame is the reference's."""
    monkeypatch.setattr(module, "BIND_POSES", 6)
    model = load_garment_model("tshirt")
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[1])
    plain = Draper(model, avatar, backend=backend, precision="fp32")
    pushing = Draper(model, avatar, backend=backend, precision="fp32", push_out=True)
    pose = np.random.default_rng(1).uniform(model.rig.lower, model.rig.upper)
    cloth = plain.drape(pose)
    assert plain.residual is None
    expected = cloth.astype(np.float64)
    bound = bind_push_out(plain.drape, model.rig, avatar)
    residual = push_out(bound, plain.bone_transforms(pose), expected[:, :3], expected[:, 3:])
    assert (expected != cloth).any()
    np.testing.assert_allclose(pushing.drape(pose), expected, atol=2e-5)
    assert pushing.residual.deepest == pytest.approx(residual.deepest, abs=1e-5)
    assert pushing.residual.left_inside == residual.left_inside
