"""Draper: random models against the reference without any folding, layouts of the output, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import SIZES, random_avatar, random_model, random_pose, tube, unit_rows
from reference.hyper_modulator import body_modulation
from reference.skinning import skin
from reference.unfolded_frame import unfolded_drape

from physkin_core import (
    BUNDLED_AVATAR,
    UPRIGHT_GRAVITY,
    Draper,
    FrameInput,
    Garment,
    avatar_from_body,
    load_avatar,
    load_body_model,
)
from physkin_core.model.garment import vertex_normals
from physkin_core.model.hyper_modulator import at_fit
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.runtime import body_encoder, low_rank
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.bound_garment import plain_skinning
from physkin_core.runtime.garment_grading import GarmentGrading

pytestmark = pytest.mark.usefixtures("exact_network_weights")


@pytest.fixture(autouse=True)
def few_body_points(monkeypatch):
    """The hyper modulator has tests of its own; here a body is 50 points. So have layers of low rank."""
    monkeypatch.setattr(body_encoder, "POINT_COUNT", 50)
    monkeypatch.setattr(low_rank, "DIRECTIONS", 10**6)


def unguarded(draper):
    """The same, not kept out of the skin."""
    draper.outfit = draper.outfit.with_bound_garment(0, draper.bound.without_contact)
    return draper


def scene(seed, **sizes):
    rng = np.random.default_rng(seed)
    model = random_model(rng, **sizes)
    return rng, model, random_avatar(rng, model.rig)


@pytest.mark.parametrize("size", SIZES)
def test_a_drape_is_the_unfolded_one(size):
    """Random rigs, bodies, networks and poses, a little beyond the limits; the tiny size ten times over. What contact
    adds has a reference of its own."""
    for seed in range(10 if size == "tiny" else 1):
        rng, model, avatar = scene([seed], **SIZES[size])
        points = sample_surface(avatar.vertices, avatar.faces, body_encoder.POINT_COUNT)
        modulation, draper = body_modulation(model.hyper_modulator, *points), unguarded(Draper(model, avatar))
        worn = replace(draper.bound, node_rest=model.node_rest, vertices=model.garment.vertices)
        for _ in range(2):
            q, gravity = random_pose(rng, model.rig)
            nodes = unfolded_drape(model, avatar, modulation, q, gravity / np.linalg.norm(gravity))
            positions, _ = skin(worn, nodes)
            found = draper.drape(q, gravity)
            assert np.abs(found[:, :3] - positions).max() <= 1e-5 * max(1.0, np.abs(positions).max())
            found = draper.node_transforms()
            assert np.abs(found - nodes).max() <= 1e-5 * max(1, np.abs(nodes).max())
            found[:] = 0  # a copy
        assert draper.node_transforms().any()


# --- Gravity and joint positions ---


def test_gravity_is_a_direction_of_any_length():
    rng, model, avatar = scene(2)
    q, gravity = random_pose(rng, model.rig)
    draper = Draper(model, avatar)
    expected = draper.drape(q, gravity)
    for length in (1e-6, 9.81, 1e6):
        np.testing.assert_allclose(draper.drape(q, length * gravity.astype(float)), expected, atol=1e-5)
    assert np.abs(draper.drape(q, -gravity) - expected).max() > 1e-3
    np.testing.assert_array_equal(draper.drape(q), draper.drape(q, UPRIGHT_GRAVITY))
    for bad in (np.zeros(3), [0, 0], [0, np.nan, 1], [0, 0, np.inf], np.zeros((1, 3)), np.eye(3), 9.81):
        with pytest.raises(ValueError, match=r"gravity must be a finite, non-zero direction \(3,\)"):
            draper.drape(q, bad)


def test_a_joint_that_is_not_finite_is_named():
    """And nothing is written."""
    rng, model, avatar = scene(4)
    draper = Draper(model, avatar)
    q, _ = random_pose(rng, model.rig)
    before = draper.drape(q)
    out = before.copy()
    for joint, bad in enumerate([np.nan, np.inf, -np.inf] * 2):
        spoilt = q.copy()
        spoilt[joint] = bad
        with pytest.raises(ValueError, match=rf"joint 'joint{joint}' is {bad}"):
            draper.drape(spoilt, out=out)
    np.testing.assert_array_equal(out, before)


def test_joint_positions_may_be_any_numbers_or_names():
    """A list, float64, a strided view, or some of them by name, the others at rest: the same drape."""
    _, model, avatar = scene(6)
    draper = Draper(model, avatar)
    assert draper.joint_names == tuple(f"joint{k}" for k in range(7))
    q = model.rig.rest.astype(np.float32)
    q[3] += 0.4
    expected = draper.drape(q)
    for same in (q.tolist(), q.astype(np.float64), np.repeat(q, 2)[::2], {"joint3": q[3]}):
        np.testing.assert_array_equal(draper.drape(same), expected)
    with pytest.raises(ValueError, match="no joint 'elbow'"):
        draper.drape({"elbow": 0.4})
    with pytest.raises(ValueError, match="joint 'joint3' is nan"):
        draper.drape({"joint3": np.nan})
    for shape in ((6,), (8,), (7, 1), (1, 7), ()):
        with pytest.raises(ValueError, match=r"joint positions have shape .*, expected \(7,\)"):
            draper.drape(np.zeros(shape))


def test_degrees_are_told_once(caplog):
    """A joint far beyond its limits is named with its value."""
    _, model, avatar = scene(15)
    draper, q = Draper(model, avatar), model.rig.rest.astype(np.float32)
    out = draper.drape(q + 6)  # not yet
    assert not caplog.records
    q[4] = 97
    for _ in range(2):
        draper.drape(q, out=out)
    assert len(caplog.records) == 1 and "'joint4' is 97" in caplog.text and "degrees" in caplog.text


# --- The output ---


def test_an_output_may_be_part_of_another_array():
    """A view of an interleaved cloud; what lies between the rows stays. Any layout: tests/native/test_any_step.py."""
    rng, model, avatar = scene(7)
    draper, pose = Draper(model, avatar), random_pose(rng, model.rig)
    cloud = np.full((draper.vertex_count, 11), -7.0, dtype=np.float32)
    assert draper.drape(*pose, out=(view := cloud[:, :3])) is view
    np.testing.assert_array_equal(view, draper.drape(*pose)[:, :3])
    assert (cloud[:, 3:] == -7).all()


def read_only(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "make, error",
    [
        (lambda n: np.zeros((n, 6)), TypeError),
        (lambda n: np.zeros((n, 6), np.int32), TypeError),
        (lambda n: np.zeros((n, 6), ">f4"), TypeError),
        (lambda n: read_only(np.zeros((n, 6), np.float32)), TypeError),
        (lambda n: np.zeros(6 * n, np.float32), TypeError),
        (lambda n: bytearray(24 * n), TypeError),
        (lambda n: np.zeros((n, 4), np.float32), ValueError),
        (lambda n: np.zeros((n + 1, 6), np.float32), ValueError),
        (lambda n: np.zeros((n - 1, 3), np.float32), ValueError),
        (lambda n: np.zeros((n, 12), np.float32)[:, ::2], ValueError),
        (lambda n: np.zeros((6, n), np.float32).T, ValueError),
        (lambda n: np.lib.stride_tricks.as_strided(np.zeros(6 * n, np.float32), (n, 6), (8, 4)), ValueError),
    ],
)
def test_other_outputs_are_refused(make, error):
    """And nothing is written."""
    rng, model, avatar = scene(8)
    draper = Draper(model, avatar)
    out = make(draper.vertex_count)
    with pytest.raises(error, match="out|contiguous|overlap"):
        draper.drape(*random_pose(rng, model.rig), out=out)
    assert not np.any(out)


# --- Construction ---


def test_other_arguments_are_refused():
    """Swapped, or a name in place of a model."""
    _, model, avatar = scene(11)
    with pytest.raises(TypeError, match="a GarmentModel or a WornGarment, got str"):
        Draper("tshirt", avatar)
    with pytest.raises(TypeError, match="put on an Avatar, got GarmentModel"):
        Draper(avatar, model)


def test_points_replace_the_vertices():
    rng, model, avatar = scene(12)
    points = model.garment.vertices[::3]
    draper = Draper(model, avatar, points=points, point_normals=unit_rows(rng, len(points)))
    assert draper.vertex_count == len(points) < len(model.garment.vertices)
    assert draper.faces.shape == (0, 3) and draper.faces.dtype == np.int32
    pose = random_pose(rng, model.rig)
    trained = Draper(model, avatar)
    np.testing.assert_array_equal(trained.faces, model.garment.faces)
    own = trained.drape(*pose)
    draped = draper.drape(*pose)
    np.testing.assert_allclose(draped[:, :3], own[::3, :3], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(draped[:, 3:], axis=1), 1, atol=1e-5)


def test_networks_that_overflow_are_refused():
    """Finite network weights whose result is not: said at once, when the garment is bound; in a pose nothing is
    written, and the node transforms stay."""
    rng, sane, avatar = scene(16)
    layers = tuple((np.float32(1e5) * weight, bias) for weight, bias in sane.node_deformer)
    model = replace(sane, node_deformer=layers)
    with pytest.raises(ValueError, match="corrections of garment nodes"):
        Draper(model, avatar)
    with pytest.raises(ValueError, match="corrections of garment nodes"):
        bind_garment(model, avatar)
    draper = Draper(sane, avatar)
    layers = tuple((np.float32(1e5) * weight, bias) for weight, bias in draper.bound.deformer_layers)
    draper.outfit = draper.outfit.with_bound_garment(0, replace(draper.bound, deformer_layers=layers))
    out = np.full((draper.vertex_count, 6), 7, dtype=np.float32)
    with pytest.raises(ValueError, match="corrections of garment nodes"):
        draper.drape(*random_pose(rng, model.rig), out=out)
    assert (out == 7).all() and not draper.node_transforms().any()


def test_a_bound_frame_reads_its_arrays_as_they_are_now(garment_model):
    """And drapes as a draper does."""
    avatar = load_avatar(BUNDLED_AVATAR, garment_model.rig)
    draper, again = Draper(garment_model, avatar), Draper(garment_model, avatar)
    positions, frame_input = garment_model.rig.rest.astype(np.float32), FrameInput(1)
    out = np.zeros((draper.vertex_count, 6), dtype=np.float32)
    step = draper.bind_frame(positions, frame_input.rows, out)
    for bend in (0.0, 0.3):
        positions[2] = bend
        gravity = 0, np.sin(bend), -np.cos(bend)
        frame_input.fill(gravity)
        step()
        np.testing.assert_array_equal(out, again.drape(positions, gravity))
    positions[0] = np.nan
    with pytest.raises(ValueError):
        step()


def test_precision_reaches_the_evaluator():
    """Each gives about the same garment, and not the same numbers."""
    rng, model, avatar = scene(41, **SIZES["tiny"])
    pose = random_pose(rng, model.rig)
    drapers = [Draper(model, avatar, precision=precision) for precision in ("fp32", "bf16", "int8")]
    assert [draper.outfit.precision for draper in drapers] == ["fp32", "bf16", "int8"]
    exact, *rounded = [draper.drape(*pose) for draper in drapers]
    assert all(0 < np.abs(other - exact).max() < 0.1 for other in rounded) and not np.array_equal(*rounded)


# --- Made to measure ---


@pytest.fixture(scope="module")
def measured():
    """A model of a waistband that has learnt a fit, and a heavy body."""
    body = load_body_model()
    band = tube(rings=9, segments=20, radius=1.0, height=0.3)
    garment = Garment(band.vertices * [0.16, 0.2, 1.0] + [0, 0, 0.12], band.faces)
    model = random_model(np.random.default_rng(5), rig=body.rig, garment=garment, nodes=12)
    return model, avatar_from_body(body, body.held_out_bodies[3])


def test_made_to_measure_without_correctives_rests_on_the_body(measured):
    """Plain skinning is what networks that correct nothing leave. At the canonical pose it is the graded garment, to
    the millimetres of finding the body's shape; a fit between is between; 0 is the template."""
    model, avatar = measured
    weight, bias = model.node_deformer[-1]
    plain = replace(model, node_deformer=(*model.node_deformer[:-1], (0 * weight, 0 * bias)))
    drapes, rests = {}, {}
    for fit in (0.0, 0.5, 1.0):
        draper = unguarded(Draper(plain, avatar, fit=fit))
        drapes[fit], rests[fit] = draper.drape(model.rig.rest), draper.rest_garment.vertices
        pose = np.random.default_rng(2).uniform(model.rig.lower, model.rig.upper).astype(np.float32)
        skinned = plain_skinning(draper.bound, draper.bone_transforms(pose))
        np.testing.assert_allclose(draper.drape(pose)[:, :3], skinned, atol=1e-5)
    np.testing.assert_allclose(drapes[1.0][:, :3], rests[1.0], atol=1e-5)
    np.testing.assert_allclose(drapes[0.5][:, :3], (drapes[0.0] + drapes[1.0])[:, :3] / 2, atol=1e-5)
    np.testing.assert_allclose(rests[0.0], model.garment.vertices, atol=1e-5)
    body = load_body_model()
    exact = GarmentGrading(model.garment, body).graded(body.held_out_bodies[3:4])[0]
    assert np.linalg.norm(rests[1.0] - exact, axis=1).max() < 5e-3
    assert np.linalg.norm(exact - model.garment.vertices, axis=1).max() > 0.02


def test_made_to_measure_is_the_default_with_the_body_model_s_rig(measured):
    """Bit for bit fit 1, in the bound garment too; with another rig it is worn as at fit 0."""
    for (worn, avatar), fit in ((measured, 1.0), (scene(0)[1:], 0.0)):
        default, told = Draper(worn, avatar), Draper(worn, avatar, fit=fit)
        assert default.fit == told.fit == fit
        np.testing.assert_array_equal(default.drape(worn.rig.rest), told.drape(worn.rig.rest))
        np.testing.assert_array_equal(default.rest_garment.vertices, told.rest_garment.vertices)
        bound = bind_garment(worn, avatar)
        np.testing.assert_array_equal(bound.vertices, told.bound.vertices)
        is_template = np.allclose(default.rest_garment.vertices, worn.garment.vertices, atol=1e-5)
        assert is_template == (fit == 0)


def test_the_fit_reaches_the_networks(measured):
    """Correctives differ between fits by more than rest shapes alone would make them."""
    model, avatar = measured
    corrected, folded = Draper(model, avatar, fit=1.0), at_fit(model.hyper_modulator, 1.0)
    same = model.hyper_modulator | folded | {"fit": 0 * model.hyper_modulator["fit"]}
    as_told = Draper(replace(model, hyper_modulator=same), avatar, fit=1.0)
    deaf = {**model.hyper_modulator, "fit": 0 * model.hyper_modulator["fit"]}
    untold = Draper(replace(model, hyper_modulator=deaf), avatar, fit=1.0)
    q = model.rig.rest
    np.testing.assert_allclose(corrected.drape(q), as_told.drape(q), atol=1e-5)
    assert np.abs(corrected.drape(q) - untold.drape(q))[:, :3].max() > 1e-4


def test_points_are_made_to_measure_as_the_mesh_they_lie_on(measured):
    """The mesh's own vertices given as points: the same drape; given normals turn with the cloth, and as the model's
    are fitted."""
    model, avatar = measured
    axis = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]], dtype=np.float32)
    model = replace(model, rest_normals=model.rest_normals @ axis)
    whole = Draper(model, avatar, fit=1.0)
    mesh = model.garment
    normals = vertex_normals(mesh.vertices, mesh.faces)
    q = model.rig.rest
    for given in (None, normals):
        points = Draper(model, avatar, fit=1.0, points=mesh.vertices, point_normals=given)
        np.testing.assert_allclose(points.drape(q)[:, :3], whole.drape(q)[:, :3], atol=1e-4)
        np.testing.assert_allclose(points.bound.normals, whole.bound.normals, atol=1e-3)
    assert np.abs(whole.bound.normals - normals).max() > 0.02


def test_a_fit_that_cannot_be_is_refused(measured):
    """Out of range, or above 0 with another rig than the body model's."""
    model, avatar = measured
    for bad in (-0.1, 1.5, np.nan, "1", True):
        with pytest.raises(ValueError, match="fit must be 0 .* to 1 "):
            Draper(model, avatar, fit=bad)
    _, strange, other = scene(0)
    with pytest.raises(ValueError, match="needs the body model's rig"):
        Draper(strange, other, fit=1.0)


def test_effective_gravity():
    """At 9.81 m/s2 it is gravity; less, more and none at all drape otherwise."""
    model = random_model(np.random.default_rng(3), **SIZES["tiny"])
    avatar = random_avatar(np.random.default_rng(4), model.rig)
    draper, pose = Draper(model, avatar), random_pose(np.random.default_rng(5), model.rig)[0]
    down = np.array([0.6, 0.0, -0.8])
    usual = draper.drape(pose, down)
    np.testing.assert_allclose(draper.drape(pose, effective_gravity=9.81 * down), usual, atol=1e-6)
    for size in (0.0, 5.0, 29.0):
        assert np.abs(draper.drape(pose, effective_gravity=size * down) - usual).max() > 1e-5
    frame_input, out = FrameInput(1), np.empty_like(usual)
    step = draper.bind_frame(pose, frame_input.rows, out)  # bound to arrays
    for size in (0.0, 5.0, 29.0):
        frame_input.fill(effective_gravity=size * down)
        step()
        np.testing.assert_array_equal(out, draper.drape(pose, effective_gravity=size * down))
    for wrong in ([0, 0, -30.0], [0, np.nan, 0]):
        with pytest.raises(ValueError, match="effective_gravity must be .* up to 29.4 m/s2"):
            draper.drape(pose, effective_gravity=wrong)
    for wrong in ([0, 0], [[0, 0, -9.81]], -9.81):
        with pytest.raises(ValueError, match="shape"):
            draper.drape(pose, effective_gravity=wrong)
