"""Drapes that are told time and root."""

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_sway_network
from scipy.spatial.transform import Rotation

import physkin_core as physkin


@pytest.fixture(scope="module")
def skirt():
    """One that a random sway network moves."""
    model = swaying("skirt", offset=0.02)
    return physkin.Draper(model, physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig))


def swaying(name, offset):
    """A shipped garment with a random sway network."""
    model = physkin.load_garment_model(name)
    modulation = 2 * sum(len(bias) for _, bias in model.pose_modulator[:-1])
    rng, sizes = np.random.default_rng(1), (len(model.rig.dofs), len(model.node_rest))
    return replace(model, sway=random_sway_network(rng, *sizes, modulation=modulation, offset=offset))


def roots(motion):
    return np.concatenate([motion.root_position, motion.root_orientation], axis=1)


def played(draper, motion, **options):
    draper.reset()
    frames = zip(motion.positions_for(draper.model.rig), roots(motion))
    return np.stack(
        [draper.drape(q, time=k / motion.rate_hz, root=root, **options) for k, (q, root) in enumerate(frames)]
    )


def test_without_sway_it_is_the_drape_under_gravity_bit_for_bit(skirt):
    """But for frames in which cloth is held off the legs, smoothly in time."""
    walk = physkin.load_motion("walk")
    skirt.sway = 0.0
    try:
        still = played(skirt, walk)
    finally:
        skirt.sway = 1.0
    plain = [skirt.drape(q, down) for q, down in zip(walk.positions_for(skirt.model.rig), walk.gravity)]
    apart = np.abs(still - np.stack(plain)).max(axis=(1, 2))
    assert (apart == 0).mean() > 0.9
    assert apart.max() < 1e-3


def test_after_a_stop_a_skirt_swings_on_and_hangs_still(skirt):
    rest, path = skirt.model.rig.rest, []
    skirt.reset()
    for k in range(330):
        path.append(skirt.drape(rest, time=k / 60, root=(1.4 * min(k / 60, 2.0), 0, 0.9, 0, 0, 0, 1))[:, :3])
    changes = np.abs(np.diff(path, axis=0)).max(axis=(1, 2))
    assert changes[121:150].max() > 2e-4 and changes[-30:].max() < 1e-5
    skirt.reset()
    still = skirt.drape(rest, time=0.0, root=(0, 0, 0.9, 0, 0, 0, 1))
    assert np.abs(path[-1] - still[:, :3]).max() < 5e-4
    assert np.abs(path[100] - still[:, :3]).max() > 1e-3


def test_a_garment_without_a_network_is_draped_at_rest_however_the_root_moves():
    """At any rate, over gaps, jumps, doubled messages and clocks that go back."""
    model = replace(physkin.load_garment_model("skirt"), sway=None)
    draper = physkin.Draper(model, physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig))
    generator, time = np.random.default_rng(4), 0.0
    for _ in range(60):
        time += generator.choice([1 / 120, 1 / 60, 1 / 15, 0.0, 0.5, -2.0])
        turn = Rotation.from_euler("z", generator.normal()).as_quat()
        moved = draper.drape(model.rig.rest, time=time, root=(*generator.normal(size=3), *turn))
        assert np.abs(moved - draper.outfit.twin().drape(model.rig.rest)[0]).max() < 1e-5


def test_the_root_tells_gravity(skirt):
    skirt.reset()
    turn = Rotation.from_euler("y", 0.6)
    rest, down = skirt.model.rig.rest, turn.inv().apply([0, 0, -1])
    leaning = skirt.drape(rest, time=0.0, root=(0, 0, 0, *turn.as_quat()))
    skirt.reset()
    assert np.allclose(leaning, skirt.drape(rest, down, time=0.0), atol=1e-5)


@pytest.mark.parametrize(
    "given",
    [
        {"root": (0, 0, 0, 0, 0, 0, 1)},
        {"time": 0.0, "root": (0,) * 6 + (1,), "effective_gravity": (0, 0, -9.81)},
    ],
)
def test_a_root_comes_with_a_time_and_without_gravity(skirt, given):
    with pytest.raises(ValueError, match="time with root"):
        skirt.drape(skirt.model.rig.rest, **given)


def test_an_outfit_swings_as_its_garments_do(skirt):
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide_covered=False)
    walk = physkin.load_motion("walk")
    outfit.reset(), skirt.reset()
    for k, (q, root) in enumerate(zip(walk.positions_for(skirt.model.rig)[:40], roots(walk))):
        (worn,), alone = outfit.drape(q, time=k / 60, root=root), skirt.drape(q, time=k / 60, root=root)
    assert np.allclose(worn, alone, atol=1e-6)
    assert np.abs(worn - skirt.drape(q, walk.gravity[39])).max() > 5e-3
    twin = outfit.twin()
    (first,) = twin.drape(q, time=0.0, root=root)
    skirt.reset()
    assert np.allclose(first, skirt.drape(q, time=0.0, root=root), atol=1e-5), "a twin's cloth has not moved yet"
    outfit.sway = 0.0
    (none,) = outfit.drape(q, time=5.0, root=root)
    assert np.allclose(none, skirt.drape(q, walk.gravity[39]), atol=1e-5)


def test_garments_of_an_outfit_sway_as_much_as_each_is_told(skirt):
    """Each as where all sway so much; the root moves once for both."""
    shirt = swaying("tshirt", offset=0.005)
    outfit = physkin.Outfit([physkin.WornGarment(shirt, tucked=True), skirt.model], skirt.avatar)
    all_of_it, none = outfit.twin(), outfit.twin()
    outfit.sway, all_of_it.sway, none.sway = (0.0, 0.7), 0.7, 0.0
    assert outfit.sway == (0.0, 0.7) and all_of_it.sway == 0.7
    for k in range(8):
        moved = {"time": k / 20, "root": (0.02 * k**2, 0, 0.9, 0, 0, 0, 1)}
        mixed, all_of_it_now, still = (each.drape(skirt.model.rig.rest, **moved) for each in (outfit, all_of_it, none))
    assert np.allclose(mixed[1], all_of_it_now[1], atol=1e-6)
    assert np.abs(mixed[1] - still[1])[:, :3].max() > 0.01
    sleeves = np.abs(still[0][:, 1]) > 0.2  # away from the skirt, which moves what is tucked
    assert np.allclose(mixed[0][sleeves], still[0][sleeves], atol=1e-6)
    assert np.abs(all_of_it_now[0] - still[0])[sleeves].max() > 1e-4


def test_outfits_refuse_other_sways(skirt):
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide_covered=False)
    for wrong in (1.5, (0.5, -0.1), "all", (0.5, 0.5), np.array(0.5), [[0.5]], None):
        with pytest.raises(ValueError, match="a number from 0 to 1|one for each of 1"):
            outfit.sway = wrong
    assert outfit.sway == 1.0


def test_outfits_take_numbers_of_numpy_and_twins_keep_them(skirt):
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide_covered=False)
    for given in (np.float32(0.5), np.array([0.5], dtype=np.float32), [np.float64(0.5)]):
        outfit.sway = given
        assert outfit.sway == outfit.twin().sway == 0.5
        outfit.sway = 1.0


def test_a_drape_without_a_time_ends_what_was_before(skirt):
    """The next one with a time is as a first one: nothing swings on, and no pace is kept."""
    rest = skirt.model.rig.rest
    root = (0.5, 0, 0.9, 0, 0, 0, 1)
    skirt.reset()
    first = skirt.drape(rest, time=0.0, root=root)
    for k in range(20):
        swung = skirt.drape(rest, time=k / 60, root=(0.5 * k / 20, 0, 0.9, 0, 0, 0, 1))
    skirt.drape(rest)
    assert np.abs(swung - first).max() > 0.005
    assert np.allclose(skirt.drape(rest, time=20 / 60, root=root), first, atol=1e-5)
    skirt.sway = 0.0
    try:
        tilted = skirt.drape(rest, (0.45, 0.0, -0.9))
        skirt.drape(rest)
        assert (skirt.drape(rest, (0.45, 0.0, -0.9), time=21 / 60) == tilted).all()
    finally:
        skirt.sway = 1.0
