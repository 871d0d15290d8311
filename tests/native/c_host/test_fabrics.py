"""Fabrics that a host chooses from: hanging as Python's drape of a garment made of that fabric does."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from native_library import BAD_ARGUMENT, OK, c_library, load, options, save_one, step, step_moving

from physkin_core import BUNDLED_AVATAR, FABRICS, Draper, load_avatar, load_garment_model, load_motion, with_fabric
from physkin_core.model.mlp import fold_modulation
from physkin_core.runtime import low_rank

UPRIGHT = np.array([0, 0, -1], dtype=np.float32)


@pytest.fixture(scope="module")
def c():
    return c_library()


def made(garment, fabric):
    """A bound garment with one of its fabrics folded into its networks."""
    (weight, bias), *others = garment.fabric_pose_layers
    weight = weight.copy()
    weight[:, -3:] *= garment.fabric_weights[fabric]
    pose_layers = fold_modulation(((weight, bias), *others), garment.fabric_modulations[fabric])
    first, driven, read, *rest = garment.sway_layers
    of_first, of_read = np.split(garment.fabric_sway_shifts[fabric], [len(first[1])])
    sway_layers = ((first[0], first[1] + of_first), driven, (read[0], read[1] + of_read), *rest)
    return replace(garment, pose_layers=pose_layers, sway_layers=sway_layers)


def test_a_fabric_is_what_its_networks_would_be(c, make_garment, make_frames, tmp_path):
    """In a motion that is told anything, fabrics changing under way, and back to the first."""
    rng = np.random.default_rng(90)
    garment = make_garment(rng, learnt_sway=True, detail_nodes=9, fabrics=2)
    names = ["jersey", "silk", "felt"]
    save_one(garment, tmp_path / "g", fabrics=names)
    status, loaded = load(c, (tmp_path / "g").read_bytes(), options(precision=b"fp32"))
    assert status == OK, c.physkin_last_error()
    frames = {name: NativeFrame([each]) for name, each in zip(names, (garment, made(garment, 0), made(garment, 1)))}
    stands, out = told(UPRIGHT), np.empty((50, 6), dtype=np.float32)
    drapes = {}
    for name in ("jersey", "felt", "silk", "jersey"):
        assert c.physkin_set_fabric(loaded, 0, name.encode()) == OK
        for positions, _ in make_frames(rng, garment, 5):
            assert step(c, loaded, positions, UPRIGHT, out) == OK
            (expected,) = clouds(frames[name], [garment], positions, stands)
            np.testing.assert_allclose(out, expected, atol=2e-5)
            if name == "jersey":
                assert np.array_equal(out, expected)
        drapes[name] = expected
    c.physkin_close(loaded)


@pytest.mark.parametrize(
    ("own", "precision", "wide", "on_average", "at_most"),
    [("", "fp32", True, 1e-5, 1e-4), ("denim", "int8", False, 2e-3, 1e-2)],
)
def test_shipped_garments_hang_as_in_python(own, precision, wide, on_average, at_most, c, tmp_path, monkeypatch):
    """The skirt, which sways by a network, in fabrics that the file holds, whatever it was made in. Layers of low rank
    have one set of directions for all other fabrics, which is seen where layers are not as wide as they were trained:
    both drapes are then within a millimetre of the wide network's."""
    if wide:
        monkeypatch.setattr(low_rank, "DIRECTIONS", 10**6)
    trained = load_garment_model("skirt")
    avatar, motion = load_avatar(BUNDLED_AVATAR, trained.rig), load_motion("dance")
    Draper(with_fabric(trained, own) if own else trained, avatar).save_bound(tmp_path / "g")
    status, loaded = load(c, (tmp_path / "g").read_bytes(), options(precision=precision.encode()))
    assert status == OK, c.physkin_last_error()
    held = [c.physkin_fabric_name(loaded, 0, k) for k in range(len(FABRICS) + 1)]
    assert (
        held[-1] is None and held[0] == (own or "jersey").encode() and set(held[:-1]) == {n.encode() for n in FABRICS}
    )
    positions = motion.positions_for(trained.rig)[:40:2].astype(np.float32)
    roots = np.concatenate([motion.root_position, motion.root_orientation], axis=1)[:40:2]
    drapes = {}
    for name in ("denim", "silk", "jersey"):
        draper = Draper(with_fabric(trained, name), avatar, precision=precision)
        out = np.empty((draper.vertex_count, 6), dtype=np.float32)
        assert c.physkin_set_fabric(loaded, 0, name.encode()) == c.physkin_reset(loaded) == OK
        for k, (q, root) in enumerate(zip(positions, roots)):
            time = 10.0 * len(drapes) + k / 30
            assert step_moving(c, loaded, q, time, root, out) == OK
            expected = draper.drape(q, time=time, root=root)
            away = np.linalg.norm(out[:, :3] - expected[:, :3], axis=1)
            assert away.mean() < on_average and away.max() < at_most
        drapes[name] = expected[:, :3]
    assert np.linalg.norm(drapes["denim"] - drapes["silk"], axis=1).max() > 0.005
    c.physkin_close(loaded)


def test_a_fabric_that_is_not_there_is_refused(c, small_bound_file):
    """And changes nothing."""
    _, loaded = load(c, small_bound_file.read_bytes())
    assert [c.physkin_fabric_name(loaded, *at) for at in ((0, 0), (0, 2), (0, 3), (0, -1), (1, 0))] == [
        *(b"jersey", b"felt", None, None, None)
    ]
    assert c.physkin_set_fabric(loaded, 0, b"felt") == OK
    before, after = np.empty((2, 50, 6), dtype=np.float32)
    pose = np.zeros(7, dtype=np.float32)
    assert step(c, loaded, pose, UPRIGHT, before) == OK
    assert c.physkin_set_fabric(loaded, 0, b"tweed") == BAD_ARGUMENT
    assert c.physkin_last_error() == b"the file holds no fabric tweed of small; it holds jersey, silk, felt"
    assert c.physkin_set_fabric(loaded, 1, b"silk") == BAD_ARGUMENT
    assert b"part is 1" in c.physkin_last_error()
    assert c.physkin_set_fabric(None, 0, b"silk") == c.physkin_set_fabric(loaded, 0, None) == BAD_ARGUMENT
    assert step(c, loaded, pose, UPRIGHT, after) == OK
    assert np.array_equal(before, after)
    c.physkin_close(loaded)
