"""Outfits of shipped garments on the bundled avatar: what is worn how, what is hidden, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from point_cloud_utils import closest_points_on_mesh
from random_models import random_model
from reference.frame import ReferenceFrame
from scipy.spatial import cKDTree

from physkin_core import (
    AvatarWarning,
    Outfit,
    WornGarment,
    load_garment_model,
    load_motion,
)
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import HEM
from physkin_core.outfit.coverage import Cover, covered
from physkin_core.outfit.tuck import DEEP, SLIDES, tucked_depths
from physkin_core.quality import signed_distance
from physkin_core.runtime.evaluator import Skinner
from physkin_core.runtime.turned_cloth import turned_cloth


@pytest.fixture(scope="module")
def models(shipped):
    return {name: shipped(name) for name in ("tshirt", "longsleeve", "trousers", "skirt", "dress")}


@pytest.fixture(scope="module")
def avatar(worn):
    return worn("tshirt").avatar


@pytest.fixture(scope="module")
def motion(models):
    clip = load_motion("dance")
    return clip.positions_for(models["tshirt"].rig), clip.gravity


@pytest.fixture(scope="module")
def over_trousers(worn):
    return worn("trousers", "tshirt")


@pytest.fixture(scope="module")
def tucked(worn):
    return worn("tshirt", "trousers", tucked="tshirt")


def stands_out(inner, outer, faces, deep):
    """How many of inner vertices (n, 3) stand out of cloth (m, 3) by more than 3 mm, which is less than its folds are
    told apart by, far from its hem, which `deep` (m,) says."""
    distance = signed_distance(inner, outer, faces)
    under = deep[cKDTree(outer).query(inner)[1]]
    return int(((distance > 0.003) & (distance < 0.06) & under).sum())


def test_trousers_no_longer_stand_out_of_a_shirt(worn, motion, over_trousers):
    """While dancing: many vertices do without the outfit, next to none with it."""
    bare = [worn(name) for name in ("trousers", "tshirt")]
    layer = bare[1].layers[0]
    deep = layer.hem_distance > 0.03
    without, outfit = 0, 0
    for frame in range(0, len(motion[0]), 15):
        trousers, shirt = (outfit.drape(motion[0][frame], motion[1][frame])[0][:, :3] for outfit in bare)
        without += stands_out(trousers, shirt, layer.faces, deep)
        trousers, shirt = over_trousers.drape(motion[0][frame], motion[1][frame])
        outfit += stands_out(trousers[:, :3], shirt[:, :3], over_trousers.layers[1].faces, deep)
    assert without > 170  # more than fifteen a frame
    assert outfit < 0.02 * without


def test_hidden_vertices_are_left_out_and_no_others(over_trousers, models):
    """Some of the trousers under the shirt are hidden, none near the shirt's hem at rest, and none of the shirt."""
    layers = over_trousers.layers
    hidden, shown = [layer.hidden for layer in layers], [layer.visible for layer in layers]
    trousers = models["trousers"].garment
    assert not hidden[1].any() and len(shown[1]) == len(models["tshirt"].garment.vertices)
    assert 50 < hidden[0].sum() < 1500
    below, above = (layer.rest[:, :3] for layer in layers)
    closest = cKDTree(above).query(below[hidden[0]])[1]
    assert layers[1].hem_distance[closest].min() >= HEM
    assert set(np.flatnonzero(~hidden[0])) <= set(shown[0]) and len(shown[0]) < len(trousers.vertices)
    assert [layer.vertex_count for layer in layers] == [len(vertices) for vertices in shown]
    faces = shown[0][layers[0].faces]
    kept = ~hidden[0][trousers.faces].all(axis=1)
    np.testing.assert_array_equal(faces, trousers.faces[kept])


def test_nothing_is_hidden_when_asked_so(worn, over_trousers):
    whole = worn("trousers", "tshirt", hide_covered=False)
    for layer, same in zip(whole.layers, over_trousers.layers):
        assert layer.vertex_count == len(layer.model.garment.vertices)
        np.testing.assert_array_equal(layer.hidden, same.hidden)
    rest = whole.rig.rest
    some, layer = over_trousers.drape(rest)[0], over_trousers.layers[0]
    same, faces = whole.drape(rest)[0][layer.visible], layer.model.garment.faces
    np.testing.assert_allclose(same[:, :3], some[:, :3], atol=1e-6)
    at_edge = np.bincount(faces.ravel())[layer.visible] > np.bincount(layer.faces.ravel())
    said = "normals are of faces that are given"  # sums of eight-bit steps are rounded block by block
    np.testing.assert_allclose(same[~at_edge], some[~at_edge], atol=4e-6, err_msg=said)


def test_a_wide_skirt_does_not_cover_ankles_below_its_hem():
    """Cloth 40 cm from the hem, which flares: a thigh beside it is covered, an ankle 30 cm farther down is not."""
    ahead = np.array([[1.0, 0.0, 0.0]])
    cloth = Cover(np.array([[0.2, 0.0, 0.3]]), ahead, np.array([0.4]))
    assert covered(np.array([[0.1, 0.0, 0.3]]), ahead, [cloth]).all()
    assert not covered(np.zeros((1, 3)), ahead, [cloth]).any()


def strongest_bones(avatar):
    """Names (V,) of the bones that move vertices most."""
    strongest = avatar.influence_weights.argmax(axis=1)
    return np.array(avatar.bone_names)[avatar.influence_bones[np.arange(len(strongest)), strongest]]


def test_the_body_mask_hides_skin_under_cloth_alone(over_trousers, avatar):
    """Of thighs and belly much is hidden; nothing of head, hands and feet."""
    centre = avatar.vertices[avatar.faces].mean(axis=1)
    mask = over_trousers.body_mask
    assert mask.shape == (len(avatar.faces),) and 0.05 < mask.mean() < 0.5
    of_face = strongest_bones(avatar)[avatar.faces[:, 0]]
    for part in ("head", "wrist", "foot"):
        assert not mask[np.char.find(np.char.lower(of_face), part) >= 0].any()
    assert centre[mask][:, 2].max() < centre[:, 2].max() - 0.2


def test_skin_under_cloth_is_drawn_slimmer_and_bare_skin_as_it_is(over_trousers, avatar):
    """By up to 6 mm inwards where the mask hides it; head, hands and feet below the hem stay."""
    drawn = over_trousers.body_to_draw
    moved = drawn.vertices - avatar.vertices
    inwards = -(moved * vertex_normals(avatar.vertices, avatar.faces)).sum(axis=1)
    assert np.linalg.norm(moved, axis=1).max() < 6.01e-3
    hidden = np.unique(avatar.faces[over_trousers.body_mask])
    assert inwards.min() > -1e-6 and inwards[hidden].min() > 2e-3 and np.median(inwards[hidden]) > 5.99e-3
    bones = strongest_bones(avatar)
    for part in ("head", "wrist"):
        assert not moved[np.char.find(bones, part) >= 0].any()
    hem = over_trousers.layers[0].rest[:, 2].min()
    assert not moved[avatar.vertices[:, 2] < hem - 0.03].any()


def test_a_collarbone_does_not_show_through_as_it_is_drawn(worn, motion):
    """The arm across the chest lifts it a few millimetres over the shirt's collar, where that is not kept out of it."""
    outfit = worn("longsleeve")
    outfit = outfit.with_bound_garment(0, outfit.layers[0].bound_visible.without_contact)
    (cloth,) = outfit.drape(motion[0][144], motion[1][144])
    faces = outfit.layers[0].faces
    outward = np.cross(*(cloth[faces[:, k], :3] - cloth[faces[:, 0], :3] for k in (1, 2)))
    shows = []
    for body in (outfit.avatar, outfit.body_to_draw):
        skin = body.posed_vertices(outfit.bone_transforms(motion[0][144])).astype(np.float64)
        distance, face, share = closest_points_on_mesh(skin, cloth[:, :3].astype(np.float64), faces.astype(np.int64))
        gap = skin - np.einsum("vc,vci->vi", share, cloth[faces[face], :3])
        over = (gap * outward[face]).sum(axis=1) > 0.9 * distance * np.linalg.norm(outward[face], axis=1)
        at_collar = skin[:, 2] > cloth[:, 2].max() - 0.15
        shows.append(int((over & at_collar & (distance > 0.001) & (distance < 0.015)).sum()))
    assert shows[0] > 4 and shows[1] <= 1


def test_a_shirt_over_trousers_is_wider_where_they_are(worn, over_trousers):
    """Its rest shape is, by up to 15 mm and a little; at the collar it is as on the bare body."""
    bare = worn("tshirt").layers[0].rest_garment.vertices
    moved = np.linalg.norm(over_trousers.layers[1].rest_garment.vertices - bare, axis=1)
    low = bare[:, 2] < np.quantile(bare[:, 2], 0.1)
    assert 0.004 < moved[low].mean() < 0.017 and moved.max() < 0.02
    assert moved[bare[:, 2] > np.quantile(bare[:, 2], 0.7)].max() < 1e-3


def depth_below_waistband(alone, over):
    """How far (n,) [m] a layer by itself would reach below the waistband of another."""
    return tucked_depths((alone.rest[:, :3], over.rest[:, :3]), (alone.faces, over.bound.faces))


def test_a_tucked_hem_is_inside_the_waistband_in_every_frame(worn, tucked, motion):
    """All of the shirt that is given well below the waistband is inside the trousers, and would not be by itself, but
    for a few vertices near the waistband, which a raised arm pulls out; the deepest of it is not given."""
    alone, (shirt_layer, trousers_layer) = worn("tshirt"), tucked.layers
    depth = depth_below_waistband(alone.layers[0], trousers_layer)
    below = np.flatnonzero(depth[shirt_layer.visible] > 0.01)
    assert 0 < len(below) < (depth > 0.01).sum()
    assert shirt_layer.hidden[depth > DEEP].all() and not shirt_layer.hidden[depth < SLIDES].any()
    for frame in range(0, len(motion[0]), 15):
        shirt, trousers = tucked.drape(motion[0][frame], motion[1][frame])
        inside = signed_distance(shirt[below, :3], trousers[:, :3], trousers_layer.faces)
        assert (inside < 0).mean() > 0.99 and inside.max() < 0.05
        loose = alone.drape(motion[0][frame], motion[1][frame])[0][shirt_layer.visible[below], :3]
        assert (signed_distance(loose, trousers[:, :3], trousers_layer.faces) > 0).mean() > 0.3


def test_a_tucked_shirt_is_taken_in(worn, tucked, motion):
    """Its rest shape is another below the waistband and as before at the chest; it is outside the trousers half
    as often by itself."""
    alone, taken_in = worn("tshirt").layers[0], tucked.layers[0]
    depth = depth_below_waistband(alone, tucked.layers[1])
    moved = np.linalg.norm(taken_in.rest_garment.vertices - alone.rest_garment.vertices, axis=1)
    assert moved[depth > 0.03].mean() > 0.004
    assert moved[alone.rest_garment.vertices[:, 2] > np.quantile(alone.rest_garment.vertices[:, 2], 0.5)].max() < 1e-3
    outside = np.zeros(2)
    for frame in range(0, len(motion[0]), 30):
        _, trousers = tucked.drape(motion[0][frame], motion[1][frame])
        for k, shirt in enumerate((alone, taken_in)):
            (drawn,) = shirt.drape([(motion[0][frame], motion[1][frame])])
            hem = drawn[depth > 0.01, :3]
            outside[k] += (signed_distance(hem, trousers[:, :3], tucked.layers[1].faces) > 0).sum()
    assert outside[1] < 0.5 * outside[0]


@pytest.mark.parametrize("kind", ["over_trousers", "tucked"])
def test_agrees_with_the_reference(kind, request, motion):
    """Over consecutive frames and after a jump nearly all vertices are the same to 2 um, none is off by 1 mm (a partner
    may be chosen otherwise by rounding); and neither is the drape without what is kept."""
    outfit = request.getfixturevalue(kind)
    bounds, orders = [layer.bound_visible for layer in outfit.layers], outfit.orders
    native, reference, alone = NativeFrame(bounds, orders), ReferenceFrame(bounds, orders), NativeFrame(bounds)
    moved = 0.0
    for frame in (*range(40, 50), 120):
        given = motion[0][frame].astype(np.float32), told(motion[1][frame])
        for a, b, c in zip(*(clouds(each, bounds, *given) for each in (native, reference, alone))):
            apart = np.linalg.norm(a[:, :3] - b[:, :3], axis=1)
            assert apart.max() < 1e-3 and np.quantile(apart, 0.99) < 2e-6
            moved = max(moved, np.linalg.norm(a[:, :3] - c[:, :3], axis=1).max())
    assert moved > 0.002


def test_a_bound_frame_and_positions_alone_are_the_same_frame(over_trousers, motion):
    positions, outfits = motion[0][60].astype(np.float32), [over_trousers.twin() for _ in range(3)]
    clouds = outfits[0].drape(positions)
    stepped = [np.empty_like(cloud) for cloud in clouds]
    outfits[1].bind_frame(positions, np.stack([told()] * 2), stepped)()
    alone = outfits[2].drape(positions, outs=[np.empty((len(c), 3), dtype=np.float32) for c in clouds])
    for cloud, step, position in zip(clouds, stepped, alone):
        np.testing.assert_array_equal(step, cloud)
        np.testing.assert_array_equal(position, cloud[:, :3])


def test_garment_nodes_skin_to_what_is_not_moved(tucked, over_trousers, motion):
    """Those of each garment, of the last frame; skinned, they are the cloud where nothing is moved afterwards, by
    another layer or off the skin."""
    positions, gravity = motion[0][30], motion[1][30]
    for outfit, moved in ((over_trousers, (False, True)), (tucked, (True, False))):
        for k, layer in enumerate(outfit.layers):
            outfit = outfit.with_bound_garment(k, layer.bound_visible.without_contact)
        assert tuple(layer.moved for layer in outfit.layers) == moved
        clouds = outfit.drape(positions, gravity)
        told = outfit.node_transforms(), outfit.detail_offsets()
        for layer, nodes, offsets, cloud, is_moved in zip(outfit.layers, *told, clouds, moved):
            points = np.empty_like(cloud)
            Skinner(layer.bound_visible).skin(nodes, points, offsets)
            assert (np.abs(points - cloud)[:, :3].max() > 1e-4) == is_moved
    with pytest.raises(IndexError, match="garment 2 of 2"):
        NativeFrame([layer.bound_visible for layer in outfit.layers]).node_transforms(2)


def test_a_twin_remembers_frames_of_its_own(over_trousers, motion):
    """Whatever one drapes in between, the other goes on as if alone."""
    first, second, alone = over_trousers.twin(), over_trousers.twin(), over_trousers.twin()
    for k in range(20):
        second.drape(motion[0][-k], motion[1][-k])
        for cloud, expected in zip(first.drape(motion[0][k], motion[1][k]), alone.drape(motion[0][k], motion[1][k])):
            np.testing.assert_array_equal(cloud, expected)
    assert first.layers == over_trousers.layers, "nothing is bound anew"


def test_each_garment_may_have_its_own_fit(models, avatar, over_trousers):
    """It wins over the outfit's; how each sits is told."""
    outfit = Outfit([models["trousers"], WornGarment(models["tshirt"], fit=0.0)], avatar, fit=1.0)
    assert [[layer.fit for layer in each.layers] for each in (outfit, over_trousers)] == [[1.0, 0.0], [1.0, 1.0]]
    shirts = [each.layers[1].rest_garment.vertices for each in (outfit, over_trousers)]
    assert np.abs(shirts[0] - shirts[1]).max() > 1e-3
    assert all(layer.at_rest.sits for layer in over_trousers.layers)


def test_what_cannot_be_worn_is_refused_in_one_sentence(models, avatar):
    """Each names the garments."""
    tshirt, trousers, dress = models["tshirt"], models["trousers"], models["dress"]
    other_rig = random_model(np.random.default_rng(0))
    refused = {
        "'tshirt' is there 2 times": [tshirt, tshirt],
        "1 to 4 garments, got 5": [*models.values()],
        "1 to 4 garments, got 0": [],
        "different rigs": [tshirt, other_rig],
        "'skirt' cannot be worn under 'trousers'": [models["skirt"], trousers],
        "'dress' cannot be tucked into 'trousers': it reaches": [WornGarment(dress, tucked=True), trousers],
        "'trousers' cannot be tucked into 'tshirt': it does not reach that waistband": [
            WornGarment(trousers, tucked=True),
            tshirt,
        ],
        "'tshirt' is tucked, but no layer after it": [trousers, WornGarment(tshirt, tucked=True)],
    }
    for message, garments in refused.items():
        named = [
            replace(g, model=_named(g.model, models)) if isinstance(g, WornGarment) else _named(g, models)
            for g in garments
        ]
        with pytest.raises(ValueError, match=message.replace("(", r"\(")) as error:
            Outfit(named, avatar)
        assert "\n" not in str(error.value)
    with pytest.raises(TypeError, match="list of garments"):
        Outfit(tshirt, avatar)
    with pytest.raises(TypeError, match="got str"):
        Outfit(["tshirt"], avatar)


def _named(model, models):
    return next((replace(m, name=name) for name, m in models.items() if m is model), model)


def test_a_shirt_under_a_waistband_that_is_not_tucked_is_warned_of(models, avatar):
    """One that hugs the body; a loose one is refused, as it would hang outside."""
    with pytest.warns(AvatarWarning, match="goes under the waistband of .* and is not tucked"):
        outfit = Outfit([load_garment_model("tanktop"), models["trousers"]], avatar)
    assert any("not tucked" in warning for warning in outfit.warnings)


def test_an_open_front_is_no_waistband(worn):
    """Its rim runs from the collar along the front edges to the hem: what lies under it is not tucked into it, and not
    warned of either."""
    shirt, over = worn("tshirt").layers[0], worn("longsleeve").layers[0]
    vertices, faces = over.rest[:, :3], over.bound.faces
    middle = vertices[faces].mean(axis=1)
    edges = faces[(np.abs(middle[:, 1]) > 0.04) | (middle[:, 0] < 0)]
    rest = (shirt.rest[:, :3], vertices)
    assert tucked_depths(rest, (shirt.bound.faces, faces)) is not None
    assert tucked_depths(rest, (shirt.bound.faces, edges)) is None


def test_turned_cloth_is_found_and_ends_at_its_fold(worn):
    """A lapel: cloth near the chest whose outside faces it. Where it is folded is its edge: what lies beside that is
    seen. A patch of two fingers' width is a fold. Sleeves face the trunk at armpits, but are nearer to their arms."""
    for name in ("tshirt", "longsleeve", "trousers"):
        assert not worn(name).layers[0].turned.any()
    outfit = worn("tshirt")
    layer = outfit.layers[0]
    rest, faces, avatar = layer.rest, layer.bound.faces, outfit.avatar
    chest = rest[rest[:, 0] > 0.05, :3]
    centre = chest[np.abs(chest - [0, 0, 0.35]).sum(axis=1).argmin()]
    for radius, found in ((0.05, True), (0.02, False)):
        patch = np.linalg.norm(rest[:, :3] - centre, axis=1) < radius
        folded = rest.copy()
        folded[patch, 3:] *= -1
        turned = turned_cloth(folded, faces, avatar)
        np.testing.assert_array_equal(turned, patch & found)
        if found:
            lapelled = replace(layer, turned=turned)
            assert layer.hem_distance[patch].min() > HEM and lapelled.hem_distance[patch].max() == 0
            beside = np.linalg.norm(rest[:, :3] - centre, axis=1) < radius + HEM / 2
            assert lapelled.hem_distance[beside].max() < HEM < layer.hem_distance[beside].min()


def test_wrong_arrays_are_refused(over_trousers, motion):
    """Nothing is written then."""
    positions, gravity = motion[0][0].astype(np.float32), motion[1][0].astype(np.float32)
    outs = [np.zeros((count, 6), dtype=np.float32) for count in (layer.vertex_count for layer in over_trousers.layers)]
    with pytest.raises(ValueError, match="one for each of 2 garments"):
        over_trousers.drape(positions, gravity, outs=outs[:1])
    with pytest.raises(ValueError, match="all have normals, or none"):
        over_trousers.drape(positions, gravity, outs=[outs[0], outs[1][:, :3]])
    with pytest.raises(TypeError, match="float64"):
        over_trousers.drape(positions, gravity, outs=[out.astype(np.float64) for out in outs])
    with pytest.raises(ValueError, match="must be finite"):
        over_trousers.drape(positions * np.nan, gravity, outs=outs)
    assert not any(out.any() for out in outs)


def test_indices_of_what_is_kept_are_checked(over_trousers):
    """The native evaluator follows them blindly in a frame, so refuses them when it is built."""
    (order,), bounds = over_trousers.orders, [layer.bound_visible for layer in over_trousers.layers]
    for field in ("contact", "seed", "beside", "ring", "push_to", "moved"):
        wrong = getattr(order, field).copy()
        wrong.flat[3] = 1_000_000
        with pytest.raises(ValueError, match=rf"{field}\[3\] is 1000000"):
            NativeFrame(bounds, [replace(order, **{field: wrong})])
    for steady, yielding in ((0, 0), (0, 2), (-1, 1)):
        with pytest.raises(ValueError, match=f"layers {steady} and {yielding} must be two of 2"):
            NativeFrame(bounds, [replace(order, steady=steady, yielding=yielding)])
