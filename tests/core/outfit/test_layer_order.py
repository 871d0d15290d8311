"""The order of two layers on a tube within a tube: what is inside comes out, smoothly, and nothing else moves."""

import numpy as np
import pytest
from native_frames import NativeLayerOrder
from random_models import tube
from reference.layer_order import MOST_PUSH, LayerOrder
from scipy.spatial import cKDTree

from physkin_core.model.garment import vertex_normals
from physkin_core.outfit.layer_order import RADIUS, bind_layer_order
from physkin_core.quality import signed_distance
from physkin_core.runtime.layers_beneath import LAYER_GAP

INNER = tube(rings=25, segments=60, radius=0.15)


def cloth(vertices):
    return np.concatenate([vertices, vertex_normals(vertices, INNER.faces)], axis=1).astype(np.float32)


def scaled(radius):
    """The tube (n, 6) with another radius, or one that depends on the vertex."""
    return cloth(INNER.vertices * np.stack([radius / 0.15, radius / 0.15, np.ones_like(radius)], axis=1))


@pytest.fixture(scope="module")
def layers():
    inner, outer = cloth(INNER.vertices), scaled(np.full(len(INNER.vertices), 0.156))
    order = bind_layer_order(0, 1, (inner[:, :3], outer[:, :3]), (INNER.faces, INNER.faces), [(inner, outer)])
    return inner, outer, order


def dented(depth):
    """The outer tube with a dent on one side, as deep [m] as told, and how much of it each vertex has."""
    at = np.linalg.norm(INNER.vertices - [0.15, 0, INNER.vertices[:, 2].mean()], axis=1)
    share = np.exp(-((at / 0.03) ** 2))
    return scaled(0.156 - depth * share), share


def radii(rows):
    return np.linalg.norm(rows[:, :2], axis=1)


@pytest.mark.parametrize("depth", [0.008, 0.015, 0.025])
def test_a_dent_is_moved_out_of_the_inner_layer(layers, depth):
    """Without that the dent is inside by centimetres; with it every vertex is at least 2 mm outside the facets."""
    inner, _, order = layers
    outer, _ = dented(depth)
    assert radii(outer).min() < 0.15
    NativeLayerOrder(order).apply(inner, outer, look_at_all=True)
    assert radii(outer).min() > 0.15 + LAYER_GAP - 2e-4


def test_what_is_outside_stays_where_it_is(layers):
    """Far from the dent nothing moves, and nothing at all where there is no dent."""
    inner, outer, order = layers
    moved = outer.copy()
    NativeLayerOrder(order).apply(inner, moved, look_at_all=True)
    np.testing.assert_array_equal(moved, outer)
    outer, share = dented(0.02)
    moved = outer.copy()
    NativeLayerOrder(order).apply(inner, moved, look_at_all=True)
    far = np.linalg.norm(INNER.vertices - INNER.vertices[share.argmax()], axis=1) > 0.06 + 2 * RADIUS
    assert far.sum() > 500
    np.testing.assert_array_equal(moved[far], outer[far])


def test_a_push_has_no_spikes(layers):
    """One vertex alone deep inside takes those around it along: its neighbours go about half as far."""
    inner, outer, order = layers
    outer = outer.copy()
    alone = int(np.abs(INNER.vertices - [0.15, 0, INNER.vertices[:, 2].mean()]).sum(axis=1).argmin())
    outer[alone, :2] *= 0.142 / 0.156
    before = outer.copy()
    NativeLayerOrder(order).apply(inner, outer, look_at_all=True)
    pushed = np.linalg.norm(outer[:, :3] - before[:, :3], axis=1)
    assert 0.009 < pushed[alone] <= MOST_PUSH
    around = INNER.edges[(INNER.edges == alone).any(axis=1)]
    neighbours = around[around != alone]
    assert (pushed[neighbours] > 0.4 * pushed[alone]).all()


def test_a_push_changes_continuously_with_the_pose(layers):
    """As a dent grows by 0.1 mm a frame and turns about the axis, no vertex jumps."""
    inner, _, order = layers
    keeper = NativeLayerOrder(order)
    before, most = None, 0.0
    for frame in range(60):
        angle = 0.002 * frame
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        outer, _ = dented(0.01 + 1e-4 * frame)
        outer = cloth(outer[:, :3].astype(np.float64) @ turn.T)
        keeper.apply(inner, outer, look_at_all=False)
        if before is not None:
            most = max(most, np.linalg.norm(outer[:, :3] - before, axis=1).max())
        before = outer[:, :3].copy()
    assert most < 0.002 * 0.16 + 8e-4


def test_agrees_with_the_reference(layers):
    """Frame by frame, on dents of any depth that turn fast and on bulges, in the middle and at a hem: nearly all
    vertices are the same to 2 um, none is off by 1 mm, as a partner may be chosen otherwise by rounding."""
    inner, _, order = layers
    native, reference, pushed = NativeLayerOrder(order), LayerOrder(order), 0.0
    middle = INNER.vertices[:, 2].mean()
    for frame in range(12):
        radius = np.full(len(INNER.vertices), 0.156)
        for depth, angle, height in (
            (0.01 * frame, 0.2 * frame, 0.0),
            (0.03, 2 - 0.1 * frame, 0.18),
            (-0.03, 4.0, 0.05),
        ):
            at = [0.15 * np.cos(angle), 0.15 * np.sin(angle), middle + height]
            radius -= depth * np.exp(-((np.linalg.norm(INNER.vertices - at, axis=1) / 0.03) ** 2))
        outer = scaled(radius)
        found, expected = outer.copy(), outer.astype(np.float64)
        how = {"look_at_all": frame == 0, "passed": -1.0 if frame < 8 else 1 / 60}
        native.apply(inner, found, **how)
        reference.apply(inner.astype(np.float64), expected, **how)
        apart = np.linalg.norm((found - expected)[:, :3], axis=1)
        assert apart.max() < 1e-3 and np.quantile(apart, 0.99) < 2e-6
        pushed = max(pushed, np.abs(found - outer)[:, :3].max())
    assert pushed > 0.03


def test_a_push_keeps_its_pace(layers):
    """A dent that is there all of a sudden goes out, and back, by half a metre a second; where it is not said how much
    time has passed, at once."""
    inner, _, order = layers
    smooth, dent = scaled(np.full(len(INNER.vertices), 0.156)), dented(0.03)[0]
    pushes = {}
    for passed in (1 / 60, -1.0):
        keeper, sizes = NativeLayerOrder(order), []
        for outer in (smooth, *8 * [dent], *8 * [smooth]):
            found = outer.copy()
            keeper.apply(inner, found, look_at_all=True, passed=passed)
            sizes.append(np.linalg.norm(found - outer, axis=1).max())
        pushes[passed] = np.array(sizes)
    paced, at_once = pushes[1 / 60], pushes[-1.0]
    assert np.abs(np.diff(paced)).max() < 0.5 / 60 + 1e-6
    assert at_once[1] > 0.02 and abs(paced[8] - at_once[1]) < 1e-5 and paced[-1] < 1e-5


def test_layers_that_never_meet_need_no_order():
    inner, outer = cloth(INNER.vertices), scaled(np.full(len(INNER.vertices), 0.3))
    assert bind_layer_order(0, 1, (inner[:, :3], outer[:, :3]), (INNER.faces,) * 2, [(inner, outer)]) is None


def folded(share):
    """The inner tube (n, 6) with a bulge on one side that hangs over by 8 cm, as knee to chest folds trousers."""
    vertices, middle = INNER.vertices.copy(), [0.15, 0, INNER.vertices[:, 2].mean() + 0.03]
    bulge = share * np.exp(-((np.linalg.norm(vertices - middle, axis=1) / 0.04) ** 2))
    vertices[:, :2] *= (1 + 0.04 * bulge / 0.15)[:, None]
    vertices[:, 2] -= 0.08 * bulge
    return cloth(vertices)


def test_cloth_that_folds_over_finds_who_is_over_it(layers):
    """A fold brings cloth under the outer layer that lay elsewhere at rest: no partner met it in any pose looked at."""
    _, _, order = layers
    keeper = NativeLayerOrder(order)
    away_from_hems = np.abs(INNER.vertices[:, 2] - INNER.vertices[:, 2].mean()) < 0.16
    for frame in range(30):
        inner, outer = folded(min(frame / 24, 1)), scaled(np.full(len(INNER.vertices), 0.16))
        keeper.apply(inner, outer, look_at_all=False)
    points, surface = (rows[:, :3].astype(np.float64) for rows in (outer[away_from_hems], inner))
    assert signed_distance(points, surface, INNER.faces).min() > LAYER_GAP


RING = np.arange(len(INNER.vertices)) // 60
FRONT, LAPEL = RING <= 18, RING > 18


def lapelled(radius, *, dent=0.0):
    """The tube (n, 6) folded outwards over its 19th ring and down again, 4 mm over what lies beneath: that cloth shows
    its inside. dent: how deep [m] its front side goes in."""
    vertices = INNER.vertices.copy()
    spacing = vertices[60, 2] - vertices[0, 2]
    out = np.where(LAPEL, radius + 0.004, radius) - dent * np.exp(
        -((np.hypot(INNER.vertices[:, 1], (RING - 15) * spacing) / 0.04) ** 2)
    ) * (FRONT & (INNER.vertices[:, 0] > 0))
    vertices[:, :2] *= (out / 0.15)[:, None]
    vertices[LAPEL, 2] -= 2 * spacing * (RING[LAPEL] - 18.5)
    return cloth(vertices)


def order_of(steady, yielding, turned):
    rest = (steady[:, :3], yielding[:, :3])
    return bind_layer_order(0, 1, rest, (INNER.faces,) * 2, [(steady, yielding)], turned=turned)


def test_a_lapel_goes_outwards_with_its_front():
    """What of the front is 10 mm inside the shirt is pushed out of it, and the lapel, whose normals face the body, goes
    along: it stays outside its own front. The reference agrees."""
    shirt, jacket = cloth(INNER.vertices), lapelled(0.156, dent=0.016)
    none = np.zeros(len(LAPEL), dtype=bool)
    order = order_of(shirt, lapelled(0.156), (none, LAPEL))
    assert not LAPEL[order.contact].any()
    moved, expected = jacket.copy(), jacket.astype(np.float64)
    NativeLayerOrder(order).apply(shirt, moved, look_at_all=True)
    LayerOrder(order).apply(shirt.astype(np.float64), expected, look_at_all=True)
    np.testing.assert_allclose(moved, expected, atol=1e-4)
    assert radii(jacket)[FRONT].min() < 0.141 and radii(moved)[FRONT].min() > 0.15 + LAYER_GAP - 2e-4
    grown = radii(moved) - radii(jacket)
    assert grown[LAPEL].min() > -1e-6 and grown[LAPEL].max() > 0.008
    front = cKDTree(jacket[FRONT, :3]).query(jacket[LAPEL, :3])[1]
    assert (radii(moved)[LAPEL] - radii(moved)[FRONT][front]).min() > 0.002


def test_a_lapel_does_not_turn_the_order_around():
    """A coat is kept outside the front that a lapel lies on, whatever way the lapel's normals point."""
    jacket, coat = lapelled(0.15), scaled(np.full(len(INNER.vertices), 0.158))
    order = order_of(jacket, coat, (LAPEL, np.zeros(len(LAPEL), dtype=bool)))
    assert not LAPEL[order.seed].any() and not LAPEL[order.ring].any()
    dented_coat, _ = dented(0.02)
    NativeLayerOrder(order).apply(jacket, dented_coat, look_at_all=True)
    under = INNER.vertices[:, 2] < jacket[FRONT, 2].max() - 0.03
    assert radii(dented_coat)[under].min() > 0.15 + LAYER_GAP - 2e-4
