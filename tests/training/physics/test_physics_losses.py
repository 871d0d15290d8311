"""Physics losses (Warp) against the float64 torch oracle and against finite differences."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
import trimesh
import warp as wp
from random_models import sewn_tube

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material, RestAngles
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.band import BAND_SLACK, BAND_STIFFNESS
from physkin_training.energies.collision import LED_BACK_BEYOND
from physkin_training.energies.rest_data import RestData
from physkin_training.physics.physics_losses import PhysicsLosses, lightened
from training import physics_oracle as oracle

MATERIAL = Material(contact_stiffness=5.0e4, bending=1e-3)
SAMPLES = 2


@pytest.fixture(scope="module")
def scene():
    """A cylinder of cloth around a slightly larger icosphere, two random deformations."""
    wp.config.quiet = True
    wp.init()
    rng = np.random.default_rng(7)
    tube = trimesh.creation.cylinder(radius=0.1, height=0.12, sections=9).subdivide()
    side = np.abs(tube.face_normals[:, 2]) < 0.5
    used, faces = np.unique(tube.faces[side], return_inverse=True)
    garment = Garment(np.asarray(tube.vertices)[used], faces.reshape(-1, 3))
    body = trimesh.creation.icosphere(subdivisions=2, radius=0.104)
    x = garment.vertices + rng.normal(scale=4e-3, size=(SAMPLES, len(garment.vertices), 3))
    offset = np.array([[0.0, 0, 0], [2.0, 0, 0]])
    points = np.concatenate([body.vertices + o for o in offset]).astype(np.float32)
    triangles = np.concatenate([body.faces, body.faces + len(body.vertices)]).astype(np.int32)
    mesh = wp.Mesh(wp.array(points, dtype=wp.vec3, device="cpu"), wp.array(triangles.reshape(-1), device="cpu"))
    gravity = rng.normal(size=(SAMPLES, 3))
    gravity /= np.linalg.norm(gravity, axis=1, keepdims=True)
    return garment, body, x, offset, mesh, gravity


def run(scene, x, *, times=1, **options):
    """Energies (term -> (B,)) and the gradient (B, n, 3) of `times` their mean, through torch."""
    garment, _, _, offset, mesh, gravity = scene
    losses = PhysicsLosses(garment, MATERIAL, SAMPLES, torch.device("cpu"), **options)
    leaf = torch.tensor(np.asarray(x), dtype=torch.float32, requires_grad=True)
    as_float = [torch.as_tensor(a, dtype=torch.float32) for a in (gravity, offset)]
    total, energies = losses(leaf, as_float[0], mesh, as_float[1])
    (times * total).backward()
    return energies, leaf.grad.numpy()


def oracle_terms(scene, x, sample, material=MATERIAL, cut=None):
    """Energy terms of one sample as functions of a leaf tensor."""
    garment, body, _, _, _, gravity = scene
    return {
        "stretch": oracle.stretch_energy(x, garment, material, cut),
        "bend": oracle.bend_energy(x, garment, material, cut),
        "collision": oracle.collision_energy(x, garment, material, np.asarray(body.vertices), np.asarray(body.faces)),
        "gravity": oracle.gravity_energy(x, garment, material, torch.as_tensor(gravity[sample])),
    }


def check_against_oracle(energies, gradient, scene, sample, *, held=0.0, rel=3e-4, **options):
    """energies: term -> (B,). gradient: (n, 3) of this sample's energy. held: what other terms add to it, (n, 3).
    options: of `oracle_terms`. Returns the oracle's terms."""
    x = torch.tensor(scene[2][sample], requires_grad=True)
    terms = oracle_terms(scene, x, sample, **options)
    for name, value in terms.items():
        assert energies[name][sample].item() == pytest.approx(value.item(), rel=rel), name
    (expected,) = torch.autograd.grad(sum(terms.values()), x)
    assert np.abs(np.asarray(gradient) - expected.numpy() - held).max() < 1e-3 * np.abs(expected.numpy()).max()
    return terms


def test_cloth_of_a_sample_may_bend_more_stiffly(scene):
    """As if the material said so, of that sample alone."""
    garment, _, x, offset, mesh, gravity = scene
    leaf, down, places = (torch.as_tensor(np.asarray(a), dtype=torch.float32) for a in (x, gravity, offset))
    losses = PhysicsLosses(garment, MATERIAL, SAMPLES, torch.device("cpu"))
    before, gradient = losses.evaluate(leaf, down, mesh, places)
    before = {name: energy.clone() for name, energy in before.items()}
    stiffer = PhysicsLosses(garment, replace(MATERIAL, bending=4 * MATERIAL.bending), SAMPLES, torch.device("cpu"))
    expected, expected_gradient = stiffer.evaluate(leaf, down, mesh, places)
    losses.bend.stiffer.copy_(torch.tensor([1.0, 4.0]))
    after, changed = losses.evaluate(leaf, down, mesh, places)
    assert after["bend"][1].item() == pytest.approx(4 * before["bend"][1].item(), rel=1e-5)
    for name in before:
        torch.testing.assert_close(after[name][0], before[name][0])
        torch.testing.assert_close(after[name][1], expected[name][1])
    torch.testing.assert_close(changed[0], gradient[0], atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(changed[1], expected_gradient[1], atol=1e-6, rtol=1e-4)


def test_energies_and_gradient_match_the_oracle(scene):
    energies, gradient = run(scene, scene[2], times=3)
    for sample in range(SAMPLES):
        terms = check_against_oracle(vars(energies), gradient[sample] * SAMPLES / 3, scene, sample, rel=2e-4)
        assert terms["collision"].item() > 0, "the scene must touch"


def rest_shapes(garment) -> list[Garment]:
    """The garment itself, and two graded ones of other sizes and curvature."""
    z = garment.vertices[:, 2:]
    return [
        garment,
        garment.reshaped(garment.vertices * [1.15, 0.95, 1.1]),
        garment.reshaped(garment.vertices * (1 + 2 * np.abs(z)) * [0.9, 0.9, 1.2]),
    ]


@pytest.mark.parametrize("creased", [True, False])
def test_cloth_that_was_cut_flat_is_measured_against_its_panels(scene, creased):
    """As cut and graded, against the oracle: strain, weight, stiffness of contact and of bending. Seams keep the angle
    that the mesh has there. Hanging as the mesh lies, it is compressed."""
    garment = sewn_tube(columns=5, rings=4, width=0.1 * np.pi / 0.93, height=0.12, shrunk=0.93)
    if not creased:
        garment = Garment(garment.vertices, garment.faces, None, garment.panel_places, garment.panel_faces)
    x = garment.vertices + np.random.default_rng(3).normal(scale=4e-3, size=(SAMPLES, *garment.vertices.shape))
    scene = (garment, scene[1], x, *scene[3:])
    shapes = [shape.vertices for shape in rest_shapes(garment)]
    rest = RestData(garment, MATERIAL, torch.device("cpu"), shapes=np.stack(shapes))
    losses = PhysicsLosses(garment, MATERIAL, SAMPLES, torch.device("cpu"), rest=rest)
    tensors = [torch.as_tensor(a, dtype=torch.float32) for a in (x, scene[5], scene[3])]
    for rows in ([0, 2], [1, 0]):
        losses.rest_row.copy_(torch.tensor(rows))
        energies, gradient = losses.evaluate(tensors[0], tensors[1], scene[4], tensors[2])
        for sample, row in enumerate(rows):
            shape = garment.reshaped(shapes[row])
            check_against_oracle(energies, gradient[sample], (shape, *scene[1:]), sample, cut=garment)
    lying, _ = run(scene, np.tile(garment.vertices, (SAMPLES, 1, 1)))
    chord = np.sin(np.pi / 10) / (np.pi / 10)
    across, along = ((stretch**2 - 1) / 2 for stretch in (0.93 * chord, 0.93))
    lame = losses.cloth.lame
    density = lame[0] * (across**2 + along**2) + lame[1] / 2 * (across + along) ** 2
    assert lying.stretch[0].item() == pytest.approx(density * garment.face_areas.sum(), rel=1e-4)


@pytest.mark.parametrize("rest_angles", get_args(RestAngles))
def test_each_sample_has_its_own_rest_shape(scene, rest_angles):
    """Energies and gradient against the oracle with that rest shape alone, the band's by its formula; rows may change
    from call to call. Of flat cloth creases alone keep the angle that they have in each."""
    garment, _, x, offset, mesh, gravity = scene
    garment = Garment(garment.vertices, garment.faces, garment.hinges[::5, :2])
    shapes, material = rest_shapes(garment), replace(MATERIAL, rest_angles=rest_angles)
    rest = RestData(garment, material, torch.device("cpu"), shapes=np.stack([shape.vertices for shape in shapes]))
    body = scene[1]
    band = worn_on(garment, body, worn=True, band=[0, 5, 9])
    losses = PhysicsLosses(garment, material, SAMPLES, torch.device("cpu"), rest=rest, wearing=band)
    tensors = [torch.as_tensor(a, dtype=torch.float32) for a in (x, gravity, offset)]
    for rows in ([2, 1], [0, 2]):
        losses.rest_row.copy_(torch.tensor(rows))
        energies, gradient = losses.evaluate(tensors[0], tensors[1], mesh, tensors[2])
        for sample, row in enumerate(rows):
            held = band_gradient(shapes[row], body, x[sample], band)
            there = (shapes[row], *scene[1:])
            check_against_oracle(energies, gradient[sample], there, sample, held=held, material=material)
    alone = PhysicsLosses(shapes[2], material, SAMPLES, torch.device("cpu"), wearing=band)
    there = alone.evaluate(tensors[0], tensors[1], mesh, tensors[2])[0]
    assert there["band"][1].item() == pytest.approx(energies["band"][1].item(), rel=1e-5) and there["band"][1] > 0


def band_gradient(garment, body, x, wearing):
    """dE/dx (n, 3) of the band by its formula."""
    gradient = np.zeros_like(x)
    for vertex, place, limit in zip(wearing.band, wearing.band_place, wearing.band_distance + BAND_SLACK):
        away = x[vertex] - body.vertices[place]
        distance = np.linalg.norm(away)
        beyond = max(0.0, distance - limit)
        gradient[vertex] += 2 * BAND_STIFFNESS * garment.vertex_areas[vertex] * beyond * away / distance
    return gradient


def alike(vertices):
    """The same vertices (n, 3) in all samples."""
    return np.repeat(vertices[None], SAMPLES, axis=0)


def test_wrong_side_hits_are_ignored(scene):
    """Deep inside, cloth whose outside faces away from the closest surface is not pushed through the limb."""
    garment = scene[0]
    shrunk = garment.vertices * np.array([0.7, 0.7, 1.0])
    assert run(scene, alike(shrunk))[0].collision.min() > 0
    assert run(scene, alike(shrunk * np.array([-1.0, 1.0, 1.0])))[0].collision.max() == 0


def worn_on(garment, body, *, worn: bool, other_limb: bool = False, band=(), distance=0.0) -> Wearing:
    """All faces of the body belong to one part, on which the whole garment lies or does not."""
    band = np.array(band, dtype=np.int32)
    return Wearing(
        faces=np.asarray(body.faces, dtype=np.int32),
        face_bone=np.zeros(len(body.faces), dtype=np.int32),
        worn=np.full((len(garment.vertices), 1), worn),
        other_limb=np.full((len(garment.vertices), 1), other_limb),
        bare=np.zeros(1, dtype=bool),
        own_face=closest_face(garment, body),
        far_face=np.full(len(garment.vertices), -1, dtype=np.int32),
        band=band,
        band_place=np.arange(len(band), dtype=np.int32),
        band_distance=np.full(len(band), distance, dtype=np.float32),
        inside_out=np.zeros(len(garment.vertices), dtype=bool),
    )


def closest_face(garment, body) -> np.ndarray:
    centres = np.asarray(body.triangles_center)
    return np.linalg.norm(centres[None] - garment.vertices[:, None], axis=2).argmin(axis=1).astype(np.int32)


def test_deep_contact_counts_only_with_parts_a_vertex_is_worn_on(scene):
    """Another limb, run through by the cloth, does not hold it; touching cloth does, worn or not."""
    garment, body, *_ = scene
    for scale, depth in ((0.7, "deep"), (1.08, "shallow")):
        shrunk = alike(garment.vertices * np.array([scale, scale, 1.0]))
        mine, strange = (run(scene, shrunk, wearing=worn_on(garment, body, worn=worn))[0] for worn in (True, False))
        assert torch.equal(mine.collision, run(scene, shrunk)[0].collision) and mine.collision.min() > 0
        assert mine.at_worn_part.all() and not strange.at_worn_part.any()
        if depth == "deep":
            assert strange.collision.max() < 0.01 * mine.collision.min()
        else:
            assert torch.equal(strange.collision, mine.collision)


def test_deep_contact_counts_for_cloth_whose_inside_is_out(scene):
    """Such cloth has its normals the other way round, and is then pushed as other cloth is."""
    garment, body, *_ = scene
    turned = garment.vertices * np.array([0.7, 0.7, 1.0]) * np.array([-1.0, 1.0, 1.0])
    wearing = worn_on(garment, body, worn=True)
    assert run(scene, alike(turned), wearing=wearing)[0].collision.max() == 0
    wearing = replace(wearing, inside_out=~wearing.inside_out)
    assert run(scene, alike(turned), wearing=wearing)[0].collision.min() > 0


def test_another_limb_presses_only_towards_where_the_cloth_is_worn(scene):
    """A limb beside the body, cloth around it that is worn on the body: the half between the two feels the limb as it
    would otherwise, the half beyond the limb nothing."""
    garment, trunk, *_, gravity = scene
    limb = trunk.copy()
    limb.apply_translation([0.3, 0.0, 0.0])
    body = trimesh.util.concatenate([trunk, limb])
    mesh = wp.Mesh(wp.array(body.vertices, dtype=wp.vec3), wp.array(body.faces.reshape(-1), dtype=wp.int32))
    x = 0.1 * garment.vertices / np.linalg.norm(garment.vertices, axis=1, keepdims=True) + [0.3, 0.0, 0.0]
    nearest = np.asarray(trunk.triangles_center)[:, 0].argmax()

    def pressed(*, other_limb: bool) -> np.ndarray:
        wearing = worn_on(garment, body, worn=False, other_limb=other_limb)
        wearing = replace(wearing, own_face=np.full(len(x), nearest, dtype=np.int32))
        losses = PhysicsLosses(garment, MATERIAL, 1, torch.device("cpu"), wearing=wearing)
        posed = torch.as_tensor(x[None], dtype=torch.float32)
        losses.evaluate(posed, torch.as_tensor(gravity[:1], dtype=torch.float32), mesh, torch.zeros(1, 3))
        return losses.collision.values[0].numpy()

    without, found = pressed(other_limb=False), pressed(other_limb=True)
    towards, beyond = x[:, 0] < 0.23, x[:, 0] > 0.3
    assert without[towards].min() > 0 and without[beyond].min() > 0, "the whole ring must touch the limb"
    np.testing.assert_array_equal(found[towards], without[towards])
    assert found[beyond].max() == 0


def test_lost_vertices_are_led_back_to_where_they_are_worn(scene):
    """Cloth that came through the limb: energy and gradient of the plane of each vertex' own face, by the formula."""
    garment, body, _, offset, _, _ = scene
    own = closest_face(garment, body)
    normal, centre = np.asarray(body.face_normals)[own], np.asarray(body.triangles_center)[own]
    through = garment.vertices * np.array([-0.7, 0.7, 1.0])
    posed = alike(through)
    wearing = worn_on(garment, body, worn=True)
    lost, without = run(scene, posed, wearing=wearing)
    energies, gradient = run(scene, posed, wearing=wearing, leads_back=True)
    assert lost.collision.max() == 0
    behind = np.maximum(MATERIAL.contact_offset - ((through - centre) * normal).sum(axis=1), 0)
    assert behind.max() > 0.1
    bounded = np.minimum(behind, LED_BACK_BEYOND)
    stiffness = MATERIAL.contact_stiffness * garment.vertex_areas
    for sample in range(SAMPLES):
        expected = (stiffness * bounded * (2 * behind - bounded)).sum()
        assert energies.collision[sample].item() == pytest.approx(expected, rel=1e-4)
        pushed = (gradient - without)[sample] * SAMPLES
        expected = normal * (-2 * stiffness * bounded)[:, None]
        np.testing.assert_allclose(pushed, expected, atol=1e-3 * np.abs(expected).max())


def test_vertices_beyond_their_limb_are_lost(scene):
    """Cloth out on the far side is led back through a limb that its sleeve goes around, however far it is, and only
    there; cloth turned about the limb, but not beyond its middle, is left alone."""
    garment, body, *_ = scene
    far = closest_face(replace(garment, vertices=garment.vertices * np.array([-1.0, -1.0, 1.0])), body)
    wearing = worn_on(garment, body, worn=True)
    sleeve = replace(wearing, far_face=far)
    beyond = alike(garment.vertices * np.array([-1.6, -1.6, 1.0]))
    unheld, without = run(scene, beyond, wearing=wearing, leads_back=True)
    energies, gradient = run(scene, beyond, wearing=sleeve, leads_back=True)
    assert unheld.collision.max() == 0
    own = np.asarray(body.face_normals)[wearing.own_face]
    assert energies.collision.min() > 0 and (np.einsum("svi,vi->sv", gradient - without, own) < 0).all()
    angle = np.radians(60.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    turned = alike(1.2 * garment.vertices @ turn.T)
    assert run(scene, turned, wearing=sleeve, leads_back=True)[0].collision.max() == 0


def test_cloth_where_it_belongs_is_not_led(scene):
    """Run through by another limb, and outside its own: the same with and without."""
    garment, body, *_ = scene
    for scale, worn in ((1.08, True), (0.95, True), (1.3, False)):
        posed = alike(garment.vertices * np.array([scale, scale, 1.0]))
        wearing = worn_on(garment, body, worn=worn)
        (plain, force), (led, led_force) = (run(scene, posed, wearing=wearing, leads_back=b) for b in (False, True))
        np.testing.assert_array_equal(plain.collision, led.collision)
        np.testing.assert_allclose(force, led_force, atol=1e-6)


def test_the_band_holds_beyond_its_slack(scene):
    """Energy and gradient of three vertices against the formula; none while within limit and slack."""
    garment, body, x, *_ = scene
    wearing = worn_on(garment, body, worn=True, band=[0, 5, 9], distance=0.01)
    energies, gradient = run(scene, x, wearing=wearing)
    _, without = run(scene, x, wearing=worn_on(garment, body, worn=True))
    for sample in range(SAMPLES):
        beyond = np.linalg.norm(x[sample, wearing.band] - np.asarray(body.vertices)[:3], axis=1) - 0.01 - BAND_SLACK
        assert beyond.min() > 0, "the scene must pull"
        expected = BAND_STIFFNESS * garment.vertex_areas[wearing.band] @ beyond**2
        assert energies.band[sample].item() == pytest.approx(expected, rel=1e-4)
        held = band_gradient(garment, body, x[sample], wearing)
        np.testing.assert_allclose((gradient - without)[sample] * SAMPLES, held, atol=2e-4 * np.abs(gradient).max())
    slack, _ = run(scene, x, wearing=replace(wearing, band_distance=np.ones(3, np.float32)))
    assert slack.band.abs().max() == 0


def test_heavy_samples_weigh_less(scene):
    """A sample's gradient is multiplied by 1 / sqrt(1 + E / heavy_energy), E without gravity; energies stay."""
    x = np.stack([scene[2][0], scene[0].vertices + 0.1 * (scene[2][0] - scene[0].vertices)])
    energies, plain = run(scene, x)
    same, weighted = run(scene, x, heavy_energy=0.02)
    strained = (energies.stretch + energies.bend + energies.collision + energies.band).numpy()
    assert strained[0] > 1.5 * strained[1]
    np.testing.assert_array_equal(same.total.numpy(), energies.total.numpy())
    factor = 1 / np.sqrt(1 + strained / 0.02)
    np.testing.assert_allclose(weighted, plain * factor[:, None, None], rtol=1e-4, atol=1e-7)


def test_lightened_energies_have_the_gradients_of_heavy_samples():
    energy = torch.tensor([0.0, 0.02, 3.0], dtype=torch.float64, requires_grad=True)
    lightened(energy, 0.02).sum().backward()
    torch.testing.assert_close(energy.grad, (1 + energy.detach() / 0.02).rsqrt())
