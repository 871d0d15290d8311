"""Garment model file: the round trip, and every way a file can be damaged, altered, newer or inconsistent."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from random_models import SIZES, random_avatar, random_model, random_pose
from safetensors import safe_open
from safetensors.numpy import save

from physkin_core import (
    Draper,
    GarmentModelError,
    Material,
    ModelFileError,
    load_garment_model,
    save_garment_model,
)
from physkin_core.model import model_file
from physkin_core.model.garment import vertex_normals
from physkin_core.model.model_file import MODELS_PATH, SCHEMA_VERSION

pytestmark = pytest.mark.usefixtures("exact_network_weights")


def tiny(**changes):
    return random_model(np.random.default_rng(3), **{**SIZES["tiny"], "rings": 4, "segments": 6, **changes})


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A small garment model file."""
    path = tmp_path_factory.mktemp("models") / "tiny.safetensors"
    save_garment_model(tiny(), path)
    return path


def contents(path):
    """Metadata and tensors of a file."""
    with safe_open(path, framework="numpy") as file:
        return dict(file.metadata()), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def write(path, metadata, tensors, *, seal=True):
    """A file with a digest that fits, as someone would write who knows the format."""
    if seal:
        metadata = {**metadata, "sha256": model_file._digest(metadata, tensors)}
    path.write_bytes(save(tensors, metadata=metadata))
    return path


# --- The round trip ---


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("activation, node_outputs", [("silu", 9), ("relu", 12)])
def test_round_trip(tmp_path, size, activation, node_outputs):
    """Indices, geometry in float32, rig and plain data come back exactly, the rest to half precision."""
    model = random_model(
        np.random.default_rng(1), **SIZES[size], activation=activation, node_outputs=node_outputs, width=16
    )
    model = replace(model, material=Material(youngs_modulus=33.5, contact_stiffness=1e5), name="a b")
    path = tmp_path / "new folder" / "model.safetensors"
    save_garment_model(model, path)
    back = load_garment_model(path)
    assert back.name == "a b" and back.activation == activation and back.material == model.material
    assert back.training == model.training and back.scores == model.scores
    assert back.rig.to_json() == model.rig.to_json()
    arrays, expected = back.arrays(), model.arrays()
    assert arrays.keys() == expected.keys()
    for name, array in arrays.items():
        if expected[name].dtype.kind == "f" and "garment" not in name:
            np.testing.assert_allclose(array, expected[name], rtol=1e-3, atol=2e-7, err_msg=name)
        else:
            np.testing.assert_array_equal(array, expected[name].astype(np.float32), err_msg=name)
    np.testing.assert_allclose(back.influence_weights.sum(axis=1), 1, atol=1e-6)
    assert not list(path.parent.glob("*.partial"))


def test_the_file_says_whether_made_to_measure_was_learnt(tmp_path):
    """Files from before have no fit, and keep loading; one above 0 is refused for them, as are numbers out of range."""
    for learnt in (True, False):
        model = tiny(made_to_measure=learnt)
        save_garment_model(model, tmp_path / "model.safetensors")
        loaded = load_garment_model(tmp_path / "model.safetensors")
        assert loaded.made_to_measure == learnt and loaded.checked_fit(0) == 0.0
        for bad in (-0.1, 1.1, np.nan, "1", True):
            with pytest.raises(ValueError, match="fit must be 0 .* to 1"):
                loaded.checked_fit(bad)
        if learnt:
            np.testing.assert_allclose(
                loaded.hyper_modulator["fit"], model.hyper_modulator["fit"], rtol=1e-3, atol=1e-6
            )
            assert loaded.checked_fit(0.5) == 0.5
    with pytest.raises(ValueError, match="'random' has not learnt to be made to measure: fit is 0.5, allowed is 0"):
        loaded.checked_fit(0.5)


def test_a_loaded_model_drapes_as_the_saved_one(tmp_path):
    """Half precision moves the garment by a fraction of a millimetre at most; a second round trip by nothing."""
    rng = np.random.default_rng(2)
    model = random_model(rng, **SIZES["default rig"])
    avatar, pose = random_avatar(rng, model.rig), random_pose(rng, model.rig)
    drapes = [Draper(model, avatar, backend="numpy").drape(*pose)]
    for name in ("first", "second"):
        save_garment_model(model, tmp_path / name)
        model = load_garment_model(tmp_path / name)
        drapes.append(Draper(model, avatar, backend="numpy").drape(*pose))
    assert 0 < np.abs(drapes[1] - drapes[0])[:, :3].max() < 1e-3
    np.testing.assert_allclose(drapes[2], drapes[1], atol=1e-6)


def test_saving_again_writes_the_same_and_replaces_the_file(tmp_path, saved):
    """Saved, loaded and saved again, over something else: not a bit differs in metadata and tensors."""
    path = tmp_path / "model.safetensors"
    path.write_bytes(b"something else")
    save_garment_model(load_garment_model(saved), path)
    (metadata, tensors), (first_metadata, first_tensors) = contents(path), contents(saved)
    assert tensors.keys() == first_tensors.keys()
    for name, tensor in tensors.items():
        if name != "skinning.weights":  # normalised again after loading
            np.testing.assert_array_equal(tensor, first_tensors[name], err_msg=name)
            assert tensor.dtype == first_tensors[name].dtype
    assert {**metadata, "sha256": ""} == {**first_metadata, "sha256": ""}


# --- Damage ---


def test_cut_and_foreign_files_are_refused(tmp_path, saved):
    """Cut anywhere, with a byte more, of another kind, a folder, or not there; the message names the file."""
    data, path = saved.read_bytes(), tmp_path / "other.safetensors"
    contents = [data[: int(share * len(data))] for share in (0, 1e-4, 0.01, 0.1, 0.3, 0.5, 0.8, 0.99, 0.9999)]
    contents += [data + b"\0", b"garment", b"\0" * 100, b"\xff" * 100, b"o tshirt\nv 1 2 3\n" * 50]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(ModelFileError, match="cannot read garment model .*other.safetensors"):
            load_garment_model(path)
    for metadata in (None, {"format": "pt"}):
        path.write_bytes(save({"weight": np.zeros(3)}, metadata=metadata))
        with pytest.raises(ModelFileError, match="format .* expected 'physkin-garment'"):
            load_garment_model(path)
    (tmp_path / "folder.safetensors").mkdir()
    for name in ("no.safetensors", "folder.safetensors"):
        with pytest.raises(ModelFileError, match=name):
            load_garment_model(tmp_path / name)


@pytest.mark.parametrize("place", ["anywhere", "header"])
def test_one_flipped_bit_is_refused(tmp_path, saved, place):
    """60 positions in the whole file, and 200 in its header: length, names, types, shapes, offsets, metadata."""
    data = saved.read_bytes()
    header = 8 + int.from_bytes(data[:8], "little")
    rng = np.random.default_rng(5)
    at = rng.integers(0, len(data), 60) if place == "anywhere" else np.r_[:8, rng.integers(8, header, 200)]
    path = tmp_path / "flipped.safetensors"
    for position, bit in zip(at, rng.integers(0, 8, len(at))):
        flipped = bytearray(data)
        flipped[position] ^= 1 << bit
        path.write_bytes(flipped)
        with pytest.raises(ModelFileError, match="flipped.safetensors"):
            load_garment_model(path)
            pytest.fail(f"bit {bit} of byte {position} of {len(data)} went unnoticed")


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_nothing_in_the_working_folder_hides_a_shipped_model(kind, tmp_path, saved, monkeypatch):
    """A bare name is the shipped model's; with a folder before it the path of a file."""
    monkeypatch.setattr(model_file, "MODELS_PATH", saved.parent)
    monkeypatch.chdir(tmp_path)
    here = tmp_path / "tiny"
    here.mkdir() if kind == "folder" else save_garment_model(replace(tiny(), name="another"), here)
    assert load_garment_model("tiny").name == "random"
    if kind == "file":
        assert load_garment_model("./tiny").name == "another"


def test_unknown_name_lists_the_shipped_models():
    with pytest.raises(ModelFileError, match="no garment model 'toga': give a file, or one of ") as caught:
        load_garment_model("toga")
    for path in MODELS_PATH.glob("*.safetensors"):
        assert path.stem in str(caught.value)


# --- Altered or newer ---


@pytest.mark.parametrize("key", ["name", "rig", "material", "training", "scores", "activation", "extra", "sha256"])
def test_altered_metadata_are_refused(tmp_path, saved, key):
    metadata, tensors = contents(saved)
    metadata[key] = metadata.get(key, "") + " "
    with pytest.raises(ModelFileError, match="damaged or was altered"):
        load_garment_model(write(tmp_path / "altered.safetensors", metadata, tensors, seal=False))


@pytest.mark.parametrize("change", ["rename", "swap", "reshape"])
def test_rearranged_tensors_are_refused(tmp_path, saved, change):
    """The digest covers names, shapes and types, not only bytes."""
    metadata, tensors = contents(saved)
    if change == "rename":
        tensors["garment_nodes.bones"] = tensors.pop("garment_nodes.bone")
    elif change == "swap":
        a, b = "hyper_modulator.norm_1.weight", "hyper_modulator.norm_2.weight"
        tensors[a], tensors[b] = tensors[b], tensors[a]
    else:
        tensors["garment.vertices"] = tensors["garment.vertices"].reshape(3, -1)
    with pytest.raises(ModelFileError, match="damaged or was altered"):
        load_garment_model(write(tmp_path / "altered.safetensors", metadata, tensors, seal=False))


@pytest.mark.parametrize("version", [str(SCHEMA_VERSION + 1), "", "0", "-1", "1.0", "one", "²"])
def test_schema_version_must_be_known(tmp_path, saved, version):
    metadata, tensors = contents(saved)
    metadata["schema_version"] = version
    with pytest.raises(ModelFileError, match=f"schema version '?{re.escape(version)}"):
        load_garment_model(write(tmp_path / "model.safetensors", metadata, tensors))


def test_files_of_version_one_have_the_mesh_s_normals(tmp_path, saved):
    metadata, tensors = contents(saved)
    metadata["schema_version"] = "1"
    del tensors["garment.normals"]
    old = load_garment_model(write(tmp_path / "old.safetensors", metadata, tensors))
    np.testing.assert_allclose(old.rest_normals, vertex_normals(old.garment.vertices, old.garment.faces), atol=1e-6)


# --- Inconsistent, though undamaged ---


def test_every_tensor_is_needed(tmp_path, saved):
    """Left out one at a time; the message says what is lacking, or what does not fit without it."""
    metadata, tensors = contents(saved)
    load_garment_model(write(tmp_path / "model.safetensors", metadata, tensors))
    for name in tensors:
        fewer = {other: tensor for other, tensor in tensors.items() if other != name}
        with pytest.raises(ModelFileError, match="lacks|is not valid"):
            load_garment_model(write(tmp_path / "model.safetensors", metadata, fewer))
            pytest.fail(f"{name} was not missed")


@pytest.mark.parametrize(
    "key, value",
    [
        *((key, None) for key in ("name", "rig", "material", "training", "scores", "activation")),
        ("activation", "tanh"),
        ("rig", "{"),
        ("rig", "[]"),
        ("rig", json.dumps({"bones": [], "dofs": []})),
        ("material", "[]"),
        ("material", json.dumps({"youngs_modulus": 60, "colour": 3})),
        ("material", json.dumps({"youngs_modulus": "stiff"})),
        ("material", json.dumps({"poisson_ratio": 1.0})),
        ("material", json.dumps({"density": float("nan")})),
        ("training", "none"),
        ("training", "[]"),
        ("scores", "3"),
        ("name", ""),
    ],
)
def test_metadata_that_make_no_sense_are_refused(tmp_path, saved, key, value):
    metadata, tensors = contents(saved)
    metadata[key] = value
    if value is None:
        del metadata[key]
    with pytest.raises(ModelFileError, match="is not valid" if value is not None else f"lacks '{key}'"):
        load_garment_model(write(tmp_path / "model.safetensors", metadata, tensors))


def test_wrong_shapes_are_refused(tmp_path, saved):
    """Every tensor with a row more, with a row less, with an axis more, and as a scalar."""
    metadata, tensors = contents(saved)
    path = tmp_path / "model.safetensors"
    for name, tensor in tensors.items():
        other = [
            np.concatenate([tensor, tensor[:1]]),
            tensor[:-1],
            tensor[..., None],
            tensor.reshape(-1)[0:1].reshape(()),
        ]
        for wrong in other[2 * (name == "garment.faces") :]:  # a face more or less is another valid garment
            with pytest.raises(ModelFileError, match="is not valid"):
                load_garment_model(write(path, metadata, {**tensors, name: wrong}))
                pytest.fail(f"{name} was accepted as {wrong.shape} instead of {tensor.shape}")


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, saved, bad):
    """In every float tensor; the message names it, and nothing else is said."""
    metadata, tensors = contents(saved)
    for name, tensor in tensors.items():
        if tensor.dtype.kind != "f":
            continue
        spoilt = tensor.copy()
        spoilt.reshape(-1)[-1] = bad
        with pytest.raises(ModelFileError, match="finite|skinning weights must be"):
            load_garment_model(write(tmp_path / "model.safetensors", metadata, {**tensors, name: spoilt}))
            pytest.fail(f"{bad} in {name} went unnoticed")


def beyond(value):
    """The fourth index is `value`, or lies 2**32 too high."""

    def change(tensor):
        spoilt = tensor.astype(np.int64)
        spoilt.reshape(-1)[3] = value + (spoilt.reshape(-1)[3] if value == 2**32 else 0)
        return spoilt

    return change


INDICES = ("garment.faces", "garment_nodes.bone", "skinning.nodes")


@pytest.mark.parametrize(
    "name, change, message",
    [
        *((name, beyond(value), "index") for name in INDICES for value in (200, -1, 2**32)),
        *((name, lambda array: array.astype(np.float32), "integer index") for name in INDICES),  # else 1.7 becomes 1
        *((name, lambda array: np.ones_like(array, dtype=np.int8), "floating point numbers|pool.bias")
          for name in ("garment_nodes.rest", "pose_modulator.0.weight", "hyper_modulator.pool.bias")),
        ("garment.normals", lambda array: array * (np.arange(len(array)) != 3)[:, None], "vertex 3 is 0.0e.00 long"),
    ],
)  # fmt: skip
def test_values_of_another_kind_are_refused(tmp_path, saved, name, change, message):
    metadata, tensors = contents(saved)
    with pytest.raises(ModelFileError, match=f"is not valid: .*({message})"):
        load_garment_model(write(tmp_path / "model.safetensors", metadata, {**tensors, name: change(tensors[name])}))


@pytest.mark.parametrize("name", ["pose_modulator.9.weight", "garment.colour"])
def test_unknown_arrays_are_refused(tmp_path, saved, name):
    metadata, tensors = contents(saved)
    with pytest.raises(ModelFileError, match=name):
        load_garment_model(write(tmp_path / "model.safetensors", metadata, {**tensors, name: np.zeros(3)}))


# --- The model itself ---


@pytest.mark.parametrize(
    "field, value, message",
    [
        ("youngs_modulus", 0, "more than 0"),
        ("density", -0.1, "more than 0"),
        ("poisson_ratio", 1, "from 0 to below 1"),
        ("poisson_ratio", -0.1, "from 0 to below 1"),
        ("bending", -1e-5, "0 or more"),
        ("contact_offset", -0.001, "0 or more"),
        ("contact_stiffness", np.inf, "a finite number"),
        ("bending", np.nan, "a finite number"),
        ("density", "0.2", "a finite number"),
        ("density", True, "a finite number"),
        ("density", None, "a finite number"),
    ],
)
def test_impossible_material_is_refused(field, value, message):
    with pytest.raises(ValueError, match=f"material {field} is .*, allowed: {message}"):
        Material(**{field: value})


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda m: dict(name=" "), "needs a name"),
        (lambda m: dict(training=[]), r"training must be an object of names and values, got \[\]"),
        (lambda m: dict(activation="gelu"), "unknown activation 'gelu'; known: silu, relu"),
        (lambda m: dict(influence_weights=-m.influence_weights), "non-negative and sum to 1"),
        (lambda m: dict(influence_weights=1.1 * m.influence_weights), "non-negative and sum to 1"),
        (lambda m: dict(influence_nodes=m.influence_nodes + 4), r"skinning.nodes holds index \d\.\.\d, allowed 0\.\.5"),
        (lambda m: dict(node_bone=m.node_bone - 9), r"garment_nodes.bone holds index -9"),
        (lambda m: dict(pose_modulator=()), "pose_modulator has no layers"),
        (lambda m: dict(pose_modulator=m.pose_modulator[:-1]), r"pose_modulator gives 16 numbers, expected 48"),
        (lambda m: dict(node_deformer=m.node_deformer[:-1]), "pose_modulator gives 48 numbers, expected 24"),
        (lambda m: dict(node_deformer=(*m.node_deformer[:-1], (np.zeros((9, 12)), np.zeros(9)))), "expected 54 or 72"),
        (lambda m: dict(node_deformer=m.node_deformer[::-1]), r"modulator gives 48 numbers, expected 132"),
        (lambda m: dict(hyper_modulator={**m.hyper_modulator, "extra.weight": np.zeros(1)}), "unknown.*extra.weight"),
        (
            lambda m: dict(hyper_modulator={**m.hyper_modulator, "fit": np.zeros(3)}),
            r"fit has shape \(3,\)",
        ),
        (
            lambda m: dict(rig=tiny(bones=4, dofs=6).rig),
            r"pose_modulator.0.weight has shape \(16, 8\), expected \(16, 9\)",
        ),
    ],
)
def test_inconsistent_model_is_refused(change, message):
    """Not only from files: a garment model checks itself."""
    model = tiny()
    with pytest.raises(GarmentModelError, match=message):
        replace(model, **change(model))


def test_token_width_must_be_a_multiple_of_the_heads():
    model = tiny()
    with pytest.raises(GarmentModelError, match="token width 6 is not a multiple of its 4 heads"):
        random_model(np.random.default_rng(0), rig=model.rig, garment=model.garment, nodes=6, influences=3, width=6)


def test_network_weights_beyond_half_precision_are_refused_on_saving(tmp_path):
    model = tiny()
    (weight, bias), *rest = model.pose_modulator
    model = replace(model, pose_modulator=((np.where(weight == weight.max(), 1e5, weight), bias), *rest))
    with pytest.raises(ModelFileError, match=r"pose_modulator.0.weight holds 1e\+05; float16 stores at most 6.55e\+04"):
        save_garment_model(model, tmp_path / "model.safetensors")
    assert not list(tmp_path.iterdir())
