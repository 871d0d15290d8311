"""What cameras see of one tube of cloth in another, and of skin under a shirt."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import tube

from physkin_core import load_body_model, load_garment_model
from physkin_core.check.sight import CAMERAS, Cameras, Figure, Surface, holes, skin_shows, what_shows, who_covers
from physkin_core.model.surface_paths import HEM, hem_distances


def surface(vertices, faces):
    """Cloth as it lies at rest."""
    return Surface(vertices, faces, hem_distances(vertices, faces))


TUBES = [tube(rings=25, segments=60, radius=radius) for radius in (0.15, 0.156)]
INNER, OUTER = (surface(each.vertices, each.faces) for each in TUBES)
CAMERAS_OF_TUBES, COVER = Cameras(OUTER.vertices), who_covers(INNER, OUTER)
HEIGHT = INNER.vertices[:, 2]
MIDDLE = int(np.abs(INNER.vertices - [0.15, 0, (HEIGHT.min() + HEIGHT.max()) / 2]).sum(axis=1).argmin())
BODY = load_body_model()
SKIN = Surface(BODY.vertices(BODY.garment_body).astype(np.float64), BODY.faces)
SHIRT = load_garment_model("tshirt").garment
CHEST = np.array([0.13, 0.0, 0.32])


def shown(inner_vertices, outer=OUTER):
    figure = Figure([Surface(inner_vertices, INNER.faces), outer], CAMERAS_OF_TUBES)
    return figure, what_shows(figure, {(0, 1): COVER})[0, 1]


def pushed(vertex, distance):
    """The inner tube with one vertex moved off the axis."""
    vertices = INNER.vertices.copy()
    vertices[vertex, :2] *= 1 + distance / 0.15
    return vertices


def test_what_is_covered_belongs_and_does_not_show():
    """Every face of the middle, though cameras look into the tubes' ends."""
    from_end = np.minimum(HEIGHT - HEIGHT.min(), HEIGHT.max() - HEIGHT)[INNER.faces].min(axis=1)
    assert COVER.under[from_end > HEM].all() and COVER.over[from_end > HEM].all()
    _, nothing = shown(INNER.vertices)
    assert nothing.shows == 0 and nothing.percent == 0 and nothing.pixels > 10_000


def test_what_is_pushed_through_is_seen_from_its_side_alone():
    """As large as what stands out, where it stands out, and by cameras from which the outer tube is not before it."""
    figure, found = shown(pushed(MIDDLE, 0.02))
    near = (INNER.faces == MIDDLE).any(axis=1)
    assert found.faces.any() and not found.faces[~near].any()
    seen = (figure.first.surface == 0) & near[figure.first.face]
    angles = figure.cameras.directions[seen] @ [-1, 0, 0]
    horizon = np.sqrt(1 - (0.156 / 0.17) ** 2)  # the tip, 17 cm from the axis, is seen over the outer tube
    assert angles.min() > -horizon and 3 <= len(np.unique(figure.cameras.directions[seen], axis=0)) < CAMERAS
    assert found.shows == pytest.approx(seen.sum(), rel=0.5) and found.percent == 100 * found.shows / found.pixels


def test_what_sank_in_belongs_under_the_cloth_though_it_is_above():
    """The outer tube is the narrower one: all of it shows but for the hems, in any one pose."""
    sunk = Surface(OUTER.vertices * [0.9, 0.9, 1], OUTER.faces, OUTER.hem_distance)
    found = skin_shows(Surface(INNER.vertices, INNER.faces), sunk)
    assert found.percent > 95
    centre = INNER.vertices[INNER.faces].mean(axis=1)[:, 2]
    assert (
        found.faces[np.abs(centre - centre.mean()) < 0.15].all() and not found.faces[centre > HEIGHT.max() - 0.01].any()
    )


def test_a_hem_that_is_lifted_shows_nothing():
    """The outer tube is pushed together to a third from below: what it covered is bare, and its hem the closest."""
    low, high = HEIGHT.min(), HEIGHT.max()
    lifted = OUTER.vertices * [1, 1, 1 / 3] + [0, 0, 2 / 3 * high]
    assert lifted[:, 2].min() > low + 0.2
    figure, found = shown(INNER.vertices, Surface(lifted, OUTER.faces, OUTER.hem_distance))
    assert found.shows == 0
    assert figure.first.on(0, COVER.under).sum() > 10_000, "what was covered is seen"


def test_single_pixels_decide_nothing():
    """Nor rows of them, as of rays that pass between faces along an edge; squares of two by two do."""
    image = CAMERAS_OF_TUBES._sizes[0]
    seen = np.zeros(len(CAMERAS_OF_TUBES.origins), dtype=bool)
    first = seen[: image[0] * image[1]].reshape(image)
    first[5, 5] = first[20, :] = first[:, 30] = True
    assert not CAMERAS_OF_TUBES.agreed(seen).any()
    first[40:42, 40:42] = True
    assert CAMERAS_OF_TUBES.agreed(seen).sum() == 4


def test_one_line_of_sight_meets_what_many_meet():
    scene = Figure([INNER], CAMERAS_OF_TUBES)
    origins, directions = np.array([[1.0, 0.01, 0.02], [-1.0, 0.01, 0.05]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    both = scene.meet(origins, directions)
    for k in (0, 1):
        alone = scene.meet(origins[k : k + 1], directions[k : k + 1])
        assert alone.face.shape == (1,) and alone.face[0] == both.face[k] and alone.facing[0]


def test_a_hole_is_seen_where_nothing_covers_what_was_removed():
    """A removed patch under whole outer cloth leaves none; without the outer cloth there, its pixels."""
    patch = (np.linalg.norm(INNER.vertices - INNER.vertices[MIDDLE], axis=1) < 0.06)[INNER.faces].all(axis=1)
    kept, open_cloth = (Surface(each.vertices, each.faces[~patch]) for each in (INNER, OUTER))
    figures = [Figure(each, CAMERAS_OF_TUBES) for each in ([INNER, OUTER], [kept, OUTER])]
    assert not holes(*figures).any()
    whole, given = (Figure([each, open_cloth], CAMERAS_OF_TUBES) for each in (INNER, kept))
    seen = (whole.first.surface == 0) & whole.first.facing & patch[whole.first.face]
    found = holes(whole, given)
    assert found.sum() > 100 and not (found & ~seen).any() and found.sum() == pytest.approx(seen.sum(), rel=0.1)


def test_an_outline_that_is_slimmer_is_no_hole():
    """Without the outer tube the inner one is all there is: 6 mm slimmer."""
    whole, given = (Figure(each, CAMERAS_OF_TUBES) for each in ([INNER, OUTER], [INNER]))
    beside = whole.first.facing & (given.first.surface == -1)
    near_end = np.abs(OUTER.vertices[OUTER.faces][..., 2]).max(axis=1) > 0.17
    assert beside.sum() > 500 and not (holes(whole, given) & ~near_end[whole.first.face]).any()


def test_a_patch_that_sank_in_shows_on_a_body_and_a_lifted_hem_does_not():
    """The shirt as it lies, with a patch of the chest 5 cm inwards, and with its hem pulled up by 12 cm."""
    cover = who_covers(SKIN, surface(SHIRT.vertices, SHIRT.faces))
    sunk, lifted = SHIRT.vertices.copy(), SHIRT.vertices.copy()
    sunk[np.linalg.norm(sunk - CHEST, axis=1) < 0.08] -= [0.05, 0.0, 0.0]
    waist = lifted[:, 2].min() + 0.4
    lower = lifted[:, 2] < waist
    lifted[lower, 2] = waist - 0.7 * (waist - lifted[lower, 2])
    away = np.linalg.norm(SKIN.vertices[SKIN.faces].mean(axis=1) - CHEST, axis=1)
    hem_distance = hem_distances(SHIRT.vertices, SHIRT.faces)
    for cloth, shows in ((SHIRT.vertices, False), (lifted, False), (sunk, True)):
        figure = Figure([SKIN, Surface(cloth, SHIRT.faces, hem_distance)], Cameras(cloth))
        found = what_shows(figure, {(0, 1): cover})[0, 1]
        assert (found.percent > 0.5) == shows and bool(found.shows) == shows
    assert found.faces[away < 0.05].all() and not found.faces[away > 0.1].any()
