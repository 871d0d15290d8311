"""Fabrics: what cloth a garment is made of."""

from dataclasses import asdict, astuple, replace

import numpy as np
import pytest

from physkin_core import (
    FABRICS,
    Draper,
    Fabric,
    GarmentModel,
    Material,
    load_garment_model,
    save_garment_model,
    with_fabric,
)
from physkin_core.model.fabric import parse_fabric, split_colour
from physkin_core.model.model_file import ModelFileError, shipped_models, split_fabric
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


def assert_alike(found: np.ndarray, expected: np.ndarray) -> None:
    """To a micrometre, which turns faces of a centimetre by a ten-thousandth."""
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-6)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], atol=1e-4)


def test_the_trained_fabric_changes_nothing(model):
    np.testing.assert_array_equal(draped(with_fabric(model, "jersey")), draped(model))


def test_twice_the_weight_hangs_as_under_twice_the_gravity(model):
    heavy = with_fabric(model, replace(JERSEY, density=1.2 * JERSEY.density))
    assert_alike(draped(heavy), draped(model, times_gravity=1.2))
    assert np.abs(draped(heavy) - draped(model)).max() > 1e-4


def test_cloth_that_stretches_and_bends_twice_as_stiffly_and_weighs_twice_as_much_hangs_the_same(model):
    scaled = with_fabric(model, Fabric(2 * JERSEY.stretch, 2 * JERSEY.bend, 2 * JERSEY.density))
    assert_alike(draped(scaled), draped(model))


def test_bending_is_a_shift_of_the_tokens(model):
    stiff = with_fabric(model, replace(JERSEY, bend=4 * JERSEY.bend))
    expected = model.hyper_modulator["embed.bias"] + 0.5 * model.hyper_modulator["bend"]  # two octaves of four
    np.testing.assert_allclose(stiff.hyper_modulator["embed.bias"], expected, rtol=1e-6)
    assert stiff.material.bending == 4 * JERSEY.bend and not stiff.hyper_modulator["bend"].any()
    assert np.abs(draped(stiff) - draped(model)).max() > 1e-5


def test_all_named_fabrics_can_be_worn(model):
    """By a model that has learnt so much as they are measured."""
    for name, fabric in FABRICS.items():
        material = with_fabric(model, name).material
        found = Fabric(material.youngs_modulus, material.bending, material.density)
        assert astuple(found) == pytest.approx(astuple(fabric))


def test_a_name_means_ratios_to_jersey_where_the_model_was_trained_as_something_else(model):
    """As models of before fabrics were as measured; what they have not learnt is the nearest that they have."""
    material = Material(youngs_modulus=60.0, bending=2.5e-5, rest_angles="as_made")
    rubber = replace(model, material=material, training={"bending_octaves": [-2, 4]})
    for name, fabric in FABRICS.items():
        material = with_fabric(rubber, name).material
        times = fabric.stretch / JERSEY.stretch
        stiffer = min(fabric.bend / JERSEY.bend / times, 16.0)
        found = Fabric(material.youngs_modulus, material.bending, material.density)
        expected = Fabric(60 * times, 2.5e-5 * times * stiffer, fabric.density)
        assert astuple(found) == pytest.approx(astuple(expected))
    assert with_fabric(rubber, "density=0.16").material.youngs_modulus == 60


def test_a_name_may_carry_the_fabric(model, tmp_path):
    path = tmp_path / "cape.safetensors"
    save_garment_model(model, path)
    assert load_garment_model(f"{path}:denim").material.youngs_modulus == FABRICS["denim"].stretch
    assert load_garment_model(f"{path}:density=0.16 + bend=5e-6").material.bending == 5e-6
    assert load_garment_model(path).material == model.material
    with pytest.raises(
        ValueError, match="unknown fabric 'tweed'; allowed: jersey, silk, cotton, wool, rib, denim, leather, or numbers"
    ):
        load_garment_model(f"{path}:tweed")
    with pytest.raises(ModelFileError, match="no garment model 'cope'"):
        load_garment_model("cope:denim")


@pytest.mark.parametrize(
    ("text", "fabric", "colour"),
    [
        ("denim", "denim", None),
        ("denim:#334", "denim", (0x33, 0x33, 0x44)),
        ("#1f2a44", "", (0x1F, 0x2A, 0x44)),
        ("black", "", (28, 28, 30)),
        ("stretch=120:white", "stretch=120", (240, 239, 235)),
    ],
)
def test_a_colour_may_follow_the_fabric(text, fabric, colour):
    found, shares = split_colour(text)
    assert found == fabric
    assert shares is None if colour is None else np.allclose(np.multiply(shares, 255), colour)
    assert split_fabric(f"cape:{text}") == ("cape", text)


@pytest.mark.parametrize("text", ["denim:#33", "denim:mauve", "#12345g", "denim:"])
def test_an_unknown_colour_is_refused_with_those_there_are(text):
    with pytest.raises(ValueError, match="unknown colour .* allowed: #rgb, #rrggbb, beige, black"):
        parse_fabric(text)


def test_a_colour_alone_leaves_the_cloth_as_it_is(model):
    navy = with_fabric(model, "navy")
    assert navy.fabric == "navy" and navy.material == model.material
    assert with_fabric(model, "denim:navy").fabric == "denim:navy"
    np.testing.assert_array_equal(draped(with_fabric(model, "wool:navy")), draped(with_fabric(model, "wool")))


def test_a_file_whose_name_has_a_colon_is_itself(model, tmp_path):
    path = tmp_path / "cape:denim"
    save_garment_model(model, path)
    assert split_fabric(path) == (str(path), "")
    assert load_garment_model(path).material == model.material


@pytest.mark.parametrize("text", ["", "stretch", "stretch=", "weight=3", "stretch=a", "bend=1e-4+bend=2e-4"])
def test_what_is_no_fabric_is_refused(model, text):
    with pytest.raises(ValueError, match="unknown fabric"):
        with_fabric(model, text)


def test_numbers_are_checked_before_there_is_a_model():
    assert parse_fabric("bend=2e-5 + density=0.18") == {"bend": 2e-5, "density": 0.18}
    assert parse_fabric("jersey") == asdict(JERSEY)
    with pytest.raises(ValueError, match="fabric stretch is 0.0, allowed: a finite number above 0"):
        parse_fabric("stretch=0")


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), True, "1"])
def test_numbers_of_a_fabric_are_above_zero(value):
    with pytest.raises(ValueError, match="fabric bend is .*, allowed: a finite number above 0"):
        Fabric(200.0, value, 0.2)


def test_what_was_not_learnt_is_refused(model):
    for density in (0.04, 0.4):
        with pytest.raises(ValueError, match=f"density {density} kg/m2 .*'random'.*allowed: 0.05 to 0.35 kg/m2"):
            with_fabric(model, f"density={density}")
    with pytest.raises(ValueError, match="bend 0.01 J .*allowed: 7.5e-07 to 9.6e-05 J$"):
        with_fabric(model, "bend=0.01")
    assert with_fabric(model, "bend=9e-5").material.bending == 9e-5
    with pytest.raises(ValueError, match="bend 9e-05 J .*allowed: 7.5e-07 to 4.8e-05 J$"):
        with_fabric(replace(model, training={"bending_octaves": [-2, 4]}), "bend=9e-5")
    for other in ("jersey", "density=0.16"):
        with pytest.raises(ValueError, match="'random' cannot be made of another fabric: .* optimisation.other_b"):
            with_fabric(with_fabric(model, "bend=5e-6"), other)


def test_jersey_is_the_reference_material():
    material = Material()
    assert Fabric(material.youngs_modulus, material.bending, material.density) == JERSEY


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_garments_can_be_made_of_every_named_fabric(name, shipped):
    model = shipped(name)
    for fabric in FABRICS:
        assert with_fabric(model, fabric).garment is model.garment
