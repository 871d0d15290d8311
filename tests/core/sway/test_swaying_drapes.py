"""Drapes that are told time and root."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import physkin_core as physkin


@pytest.fixture(scope="module")
def skirt():
    """One that a pendulum moves."""
    model = replace(physkin.load_garment_model("skirt"), sway=None)
    return physkin.Draper(model, physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig))


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


def test_a_skirt_trails_swings_ahead_and_hangs_still(skirt):
    rest = skirt.model.rig.rest
    hem = skirt.rest_garment.vertices[:, 2] < skirt.rest_garment.vertices[:, 2].min() + 0.1
    skirt.reset()
    ahead = []
    for k in range(330):
        cloud = skirt.drape(rest, time=k / 60, root=(1.4 * min(k / 60, 2.0), 0, 0.9, 0, 0, 0, 1))
        ahead.append(cloud[hem, 0].mean())
    still = skirt.drape(rest)[hem, 0].mean()
    assert min(ahead[60:120]) < still - 0.01
    assert max(ahead[120:180]) > still + 0.005
    assert np.abs(np.diff(ahead[300:])).max() < 5e-5
    assert abs(ahead[-1] - still) < 5e-4


def test_the_root_tells_gravity(skirt):
    skirt.reset()
    turn = Rotation.from_euler("y", 0.6)
    leaning = skirt.drape(skirt.model.rig.rest, time=0.0, root=(0, 0, 0, *turn.as_quat()))
    assert np.allclose(leaning, skirt.drape(skirt.model.rig.rest, turn.inv().apply([0, 0, -1])), atol=1e-5)


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
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide=False)
    walk = physkin.load_motion("walk")
    outfit.reset(), skirt.reset()
    for k, (q, root) in enumerate(zip(walk.positions_for(skirt.model.rig)[:40], roots(walk))):
        (worn,), alone = outfit.drape(q, time=k / 60, root=root), skirt.drape(q, time=k / 60, root=root)
    assert np.allclose(worn, alone, atol=1e-6)
    assert np.abs(worn - skirt.drape(q, walk.gravity[39])).max() > 5e-3
    twin = outfit.twin()
    (still,) = twin.drape(q, time=0.0, root=root)
    assert np.allclose(still, skirt.drape(q, walk.gravity[39]), atol=1e-5), "a twin's cloth has not moved yet"
    outfit.sway = 0.0
    (none,) = outfit.drape(q, time=5.0, root=root)
    assert np.allclose(none, still, atol=1e-5)


def test_garments_of_an_outfit_sway_as_much_as_each_is_told(skirt):
    """Each as where all sway so much; the root moves once for both."""
    shirt = physkin.load_garment_model("tshirt")
    outfit = physkin.Outfit([physkin.WornGarment(shirt, tucked=True), skirt.model], skirt.avatar)
    all_of_it, none = outfit.twin(), outfit.twin()
    outfit.sway, all_of_it.sway, none.sway = (0.0, 0.7), 0.7, 0.0
    assert outfit.sway == (0.0, 0.7) and all_of_it.sway == 0.7
    for k in range(8):
        moved = {"time": k / 20, "root": (0.02 * k**2, 0, 0.9, 0, 0, 0, 1)}
        mixed, swaying, still = (each.drape(skirt.model.rig.rest, **moved) for each in (outfit, all_of_it, none))
    assert np.allclose(mixed[1], swaying[1], atol=1e-6)
    assert np.abs(mixed[1] - still[1]).max() > 0.01
    sleeves = np.abs(still[0][:, 1]) > 0.2  # away from the skirt, which moves what is tucked
    assert np.allclose(mixed[0][sleeves], still[0][sleeves], atol=1e-6)
    assert np.abs(swaying[0] - still[0])[sleeves].max() > 1e-4


def test_outfits_refuse_other_sways(skirt):
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide=False)
    for wrong in (1.5, (0.5, -0.1), "all", (0.5, 0.5), np.array(0.5), [[0.5]], None):
        with pytest.raises(ValueError, match="a number from 0 to 1|one for each of 1"):
            outfit.sway = wrong
    assert outfit.sway == 1.0


def test_outfits_take_numbers_of_numpy_and_twins_keep_them(skirt):
    outfit = physkin.Outfit([skirt.model], skirt.avatar, hide=False)
    for given in (np.float32(0.5), np.array([0.5], dtype=np.float32), [np.float64(0.5)]):
        outfit.sway = given
        assert outfit.sway == outfit.twin().sway == 0.5
        outfit.sway = 1.0


def test_a_drape_without_a_time_ends_what_was_before(skirt):
    """The next one with a time is as a first one: nothing swings on, and no pace is kept."""
    rest = skirt.model.rig.rest
    root = (0.5, 0, 0.9, 0, 0, 0, 1)
    skirt.reset()
    for k in range(20):
        swung = skirt.drape(rest, time=k / 60, root=(0.5 * k / 20, 0, 0.9, 0, 0, 0, 1))
    still = skirt.drape(rest)
    assert np.abs(swung - still).max() > 0.01
    assert np.allclose(skirt.drape(rest, time=20 / 60, root=root), still, atol=1e-5)
    tilted = skirt.drape(rest, (0.45, 0.0, -0.9))
    skirt.drape(rest)
    assert (skirt.drape(rest, (0.45, 0.0, -0.9), time=21 / 60) == tilted).all()


def turned(draper, rest, *, steps=15, rate=60):
    """The last frame of a root that stands for two, and turns by 1.5 rad on the spot."""
    for k in range(-2, steps + 1):
        root = (0, 0, 0.9, *Rotation.from_euler("z", 1.5 * max(k, 0) / steps).as_quat())
        found = draper.drape(rest, time=k / rate, root=root)
    return found


def test_a_skirt_stays_behind_a_turn(skirt):
    """Its hem turns the other way, about the root, and rises; it comes back."""
    skirt.reset()
    rest = skirt.drape(skirt.model.rig.rest)[:, :3].astype(float)
    moved = turned(skirt, skirt.model.rig.rest)[:, :3].astype(float)
    hem = rest[:, 2] < np.quantile(rest[:, 2], 0.2)
    behind = np.angle((moved @ [1, 1j, 0]) * (rest @ [1, 1j, 0]).conj())[hem].mean()
    assert -0.6 < behind < -0.1
    assert (moved - rest)[hem, 2].mean() > 0.002
    waist = rest[:, 2] > 0.03
    assert np.abs(moved - rest)[waist].max() < 0.01
    facing = (0, 0, 0.9, *Rotation.from_euler("z", 1.5).as_quat())
    for k in range(240):
        after = skirt.drape(skirt.model.rig.rest, time=0.25 + k / 60, root=facing)
    assert np.abs(after[:, :3] - rest).max() < 5e-4


def test_trousers_turn_with_their_wearer_and_nothing_tucked_twists():
    trousers, shirt = physkin.load_garment_model("trousers"), physkin.load_garment_model("tshirt")
    avatar = physkin.load_avatar(physkin.BUNDLED_AVATAR, trousers.rig)
    outfit = physkin.Outfit([physkin.WornGarment(shirt, tucked=True), trousers], avatar)
    still = outfit.drape(trousers.rig.rest)
    moved = turned(outfit, trousers.rig.rest)
    assert all(np.abs(a - b).max() < 1e-4 for a, b in zip(moved, still))


def test_garments_of_an_outfit_twist_as_much_as_each_sways(skirt):
    shirt = physkin.load_garment_model("tshirt")
    outfit = physkin.Outfit([shirt, skirt.model], skirt.avatar)
    outfit.sway = (0.0, 1.0)
    still, moved = outfit.drape(skirt.model.rig.rest), turned(outfit, skirt.model.rig.rest, steps=4, rate=16)
    assert np.abs(moved[1] - still[1])[:, :3].max() > 0.05
    sleeves = np.abs(still[0][:, 1]) > 0.25
    assert np.abs(moved[0] - still[0])[sleeves].max() < 1e-5
