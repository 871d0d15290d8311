"""Fabrics: what cloth a garment is made of."""

from dataclasses import replace

import numpy as np
import pytest

from physkin_core import FABRICS, Draper, Fabric, GarmentModel, load_garment_model, made_of, save_garment_model
from physkin_core.model.fabric import fabric_of
from physkin_core.model.model_file import ModelFileError, split_fabric
from tests.random_models import random_avatar, random_model

STANDARD_GRAVITY = 9.81
JERSEY = FABRICS["jersey"]


@pytest.fixture
def model() -> GarmentModel:
    return random_model(np.random.default_rng(3))


def draped(model: GarmentModel, *, times_gravity: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(4)
    draper = Draper(model, random_avatar(rng, model.rig), precision="fp32")
    positions = rng.uniform(model.rig.lower, model.rig.upper).astype(np.float32)
    return draper.drape(
        positions, effective_gravity=times_gravity * STANDARD_GRAVITY * np.array([0.0, 0.6, -0.8])
    ).copy()


def test_the_trained_fabric_changes_nothing(model):
    np.testing.assert_array_equal(draped(made_of(model, "jersey")), draped(model))


def test_twice_the_weight_hangs_as_under_twice_the_gravity(model):
    heavy = made_of(model, replace(JERSEY, density=1.2 * JERSEY.density))
    np.testing.assert_allclose(draped(heavy), draped(model, times_gravity=1.2), atol=1e-6)
    assert np.abs(draped(heavy) - draped(model)).max() > 1e-4


def test_cloth_that_stretches_and_bends_twice_as_stiffly_and_weighs_twice_as_much_hangs_the_same(model):
    scaled = made_of(model, Fabric(2 * JERSEY.stretch, 2 * JERSEY.bend, 2 * JERSEY.density))
    np.testing.assert_allclose(draped(scaled), draped(model), atol=1e-6)


def test_bending_is_a_shift_of_the_tokens(model):
    stiff = made_of(model, replace(JERSEY, bend=4 * JERSEY.bend))
    expected = model.hyper_modulator["embed.bias"] + 0.5 * model.hyper_modulator["bend"]  # two octaves of four
    np.testing.assert_allclose(stiff.hyper_modulator["embed.bias"], expected, rtol=1e-6)
    assert stiff.material.bending == 4 * JERSEY.bend and not stiff.hyper_modulator["bend"].any()
    assert np.abs(draped(stiff) - draped(model)).max() > 1e-5


def test_all_named_fabrics_can_be_worn(model):
    for name in FABRICS:
        assert made_of(model, name).material.density == FABRICS[name].density


def test_a_name_may_carry_the_fabric(model, tmp_path):
    path = tmp_path / "cape.safetensors"
    save_garment_model(model, path)
    assert load_garment_model(f"{path}:denim").material.youngs_modulus == FABRICS["denim"].stretch
    assert load_garment_model(f"{path}:density=0.16 + bend=5e-5").material.bending == 5e-5
    assert load_garment_model(path).material == model.material
    with pytest.raises(ValueError, match="no fabric 'tweed'; allowed: jersey, wool, denim, leather, or numbers"):
        load_garment_model(f"{path}:tweed")
    with pytest.raises(ModelFileError, match="no garment model 'cope'"):
        load_garment_model("cope:denim")


def test_a_file_whose_name_has_a_colon_is_itself(model, tmp_path):
    path = tmp_path / "cape:denim"
    save_garment_model(model, path)
    assert split_fabric(path) == (str(path), "")
    assert load_garment_model(path).material == model.material


@pytest.mark.parametrize("text", ["", "stretch", "stretch=", "weight=3", "stretch=a", "bend=1e-4+bend=2e-4"])
def test_what_is_no_fabric_is_refused(text):
    with pytest.raises(ValueError, match="no fabric"):
        fabric_of(text)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), True, "1"])
def test_numbers_of_a_fabric_are_above_zero(value):
    with pytest.raises(ValueError, match="fabric bend is .*, allowed: a finite number above 0"):
        Fabric(60.0, value, 0.2)


def test_what_was_not_learnt_is_refused(model):
    for density in (0.1, 0.4):
        with pytest.raises(ValueError, match=f"density {density} kg/m2 .*'random'.*allowed: 0.15 to 0.25 kg/m2"):
            made_of(model, f"density={density}")
    with pytest.raises(ValueError, match="bend 0.01 J .*allowed: 6.*e-06 to 0.0004 J$"):
        made_of(model, "bend=0.01")
    for other in ("jersey", "density=0.16"):
        with pytest.raises(ValueError, match="'random' is of another fabric already, .* optimisation.other_b"):
            made_of(made_of(model, "bend=5e-5"), other)
