"""Garment model file: the round trip, and every way a file can be damaged, altered, newer or inconsistent."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from model_files import contents, save_packed, sealed, written
from random_models import SIZES, random_model
from safetensors.numpy import save

from physkin_core import (
    Garment,
    GarmentModelError,
    Material,
    ModelFileError,
    load_garment_model,
    save_garment_model,
)
from physkin_core.model import model_file
from physkin_core.model.model_arrays import described_arrays
from physkin_core.model.model_file import LEAST_PACKED, MODELS_PATH, SCHEMA_VERSION, model_content
from physkin_core.tensor_file import read_tensors


def tiny(**changes):
    return random_model(np.random.default_rng(3), **{**SIZES["tiny"], "rings": 4, "segments": 6, **changes})


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A small garment model file, all network weights packed."""
    path = tmp_path_factory.mktemp("models") / "tiny.safetensors"
    save_packed(tiny(learnt_sway=True, detail_nodes=5), path)
    return path


def unit_rows(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def refused(saved, match, change):
    """The file is refused after change(metadata, tensors), sealed again with a digest that fits."""
    metadata, tensors = contents(saved)
    change(metadata, tensors)
    with pytest.raises(ModelFileError, match=match):
        load_garment_model(written(saved.with_name("changed.safetensors"), sealed(metadata, tensors)))
        pytest.fail("it went unnoticed")


# --- The round trip ---


def test_creases_of_the_mesh_are_kept(saved, tmp_path):
    model, path = load_garment_model(saved), tmp_path / "creased.safetensors"
    assert model.garment.creases is None
    garment = Garment(model.garment.vertices, model.garment.faces, model.garment.edges[3:7])
    save_garment_model(replace(model, garment=garment), path)
    np.testing.assert_array_equal(load_garment_model(path).garment.creases, garment.creases)
    refused(path, "is not valid.*creases", lambda _, tensors: tensors.update({"garment.creases": np.array([[0, 999]])}))


def test_threads_are_kept(saved, tmp_path):
    model, path = load_garment_model(saved), tmp_path / "buttoned.safetensors"
    assert model.garment.threads is None and "garment.threads" not in contents(saved)[1]
    vertices = model.garment.vertices * 0.1
    garment = Garment(vertices, model.garment.faces, threads=np.array([[len(vertices) - 1, 0]]))
    save_garment_model(replace(model, garment=garment), path)
    np.testing.assert_array_equal(load_garment_model(path).garment.threads, garment.threads)
    for threads, message in (([[0, 0]], "join a vertex to itself"), ([[0, 999]], "threads hold 0 to 999")):
        stored = {"garment.threads": np.array(threads)}
        refused(path, message, lambda _, tensors, stored=stored: tensors.update(stored))


@pytest.mark.parametrize("size", SIZES)
def test_round_trip(tmp_path, size):
    """Indices, rig and plain data come back exactly, large network weights to a thousandth of a row's largest, geometry
    to half a step and skinning weights to one, the rest to half precision. Saved again, over the file, not a bit
    differs."""
    model = random_model(np.random.default_rng(1), **SIZES[size], width=16, detail_nodes=30, learnt_sway=True)
    model = replace(model, material=Material(youngs_modulus=33.5, contact_stiffness=1e5), name="a b")
    path = tmp_path / "new folder" / "model.safetensors"
    save_garment_model(model, path)
    back = load_garment_model(path)
    assert back.name == "a b" and back.material == model.material
    assert back.training == model.training and back.scores == model.scores
    assert back.rig.to_json() == model.rig.to_json()
    arrays, expected = back.arrays(), model.arrays()
    assert arrays.keys() == expected.keys()
    steps = {name: kind.step for name, _, kind in described_arrays(model)}
    for name, array in arrays.items():
        if step := steps[name]:
            whole = array / np.float64(step)
            np.testing.assert_allclose(whole, np.rint(whole), atol=2e-3, err_msg=name)
            moved = np.abs(array - unit_rows(expected[name]) if name == "garment.normals" else array - expected[name])
            assert moved.max() <= (1.001 if "weights" in name else 0.501) * step, name
        elif name.endswith(".weight") and array.ndim == 2 and array.size >= LEAST_PACKED:
            rounding = np.abs(expected[name]).max(axis=1, keepdims=True) / 1000
            assert (np.abs(array - expected[name]) <= rounding).all(), name
        elif expected[name].dtype.kind == "f" and name != "garment_nodes.rest":
            np.testing.assert_allclose(array, expected[name], rtol=1e-3, atol=2e-7, err_msg=name)
        else:
            np.testing.assert_array_equal(array, expected[name].astype(np.float32), err_msg=name)
    np.testing.assert_allclose(back.influence_weights.sum(axis=1), 1, atol=1e-6)
    stored = [read_tensors(path.read_bytes())]
    save_garment_model(back, path)
    stored.append(read_tensors(path.read_bytes()))
    assert stored[0][0] == stored[1][0], "the digest, among others"
    assert not list(path.parent.glob("*.partial"))


def test_what_is_read_once_is_what_is_loaded(saved, tmp_path):
    """A file that is replaced after it was read changes nothing: the bytes that a digest was taken of are parsed."""
    path = written(tmp_path / "model.safetensors", saved.read_bytes())
    content = model_content(path)
    path.write_bytes(b"replaced")
    assert load_garment_model(path, content=content).arrays().keys() == load_garment_model(saved).arrays().keys()
    with pytest.raises(ModelFileError):
        load_garment_model(path)
    assert model_content("tshirt:denim") == (MODELS_PATH / "tshirt.safetensors").read_bytes()
    with pytest.raises(ModelFileError, match="nothere.safetensors: no such file"):
        model_content("nothere.safetensors")


# --- Damage ---


def test_damaged_and_foreign_files_are_refused(tmp_path, saved):
    """Cut anywhere, with a byte more, of another kind, a folder or not there; the message names the file. Files that
    were overwritten: test_damaged_model_files. What the digest covers: test_tensor_file."""
    data, path = saved.read_bytes(), tmp_path / "other.safetensors"
    contents = [data[: int(share * len(data))] for share in (0, 1e-4, 0.01, 0.1, 0.3, 0.5, 0.8, 0.99, 0.9999)]
    contents += [data + b"\0", b"garment", b"\0" * 100, b"\xff" * 100, b"o tshirt\nv 1 2 3\n" * 50]
    for content in contents:
        with pytest.raises(ModelFileError, match="garment model .*other.safetensors: it cannot be read as safetensors"):
            load_garment_model(written(path, content))
    for metadata in (None, {"format": "pt"}):
        with pytest.raises(ModelFileError, match="format .* expected 'physkin-garment'"):
            load_garment_model(written(path, save({"weight": np.zeros(3)}, metadata=metadata)))
    for name in ("no.safetensors", tmp_path.name):
        with pytest.raises(ModelFileError, match=name):
            load_garment_model(tmp_path.parent / name)


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


@pytest.mark.parametrize("version", [str(SCHEMA_VERSION + 1), "7", "", "0", "-1", "1.0", "one", "²"])
def test_schema_version_must_be_known(saved, version):
    """An older one is to be trained anew, a newer one needs a newer release."""
    remedy = {"7": ".* train it anew", str(SCHEMA_VERSION + 1): ".* update PhySkin"}.get(version, "")
    refused(saved, f"schema version '?{version}{remedy}", lambda metadata, _: metadata.update(schema_version=version))


# --- Inconsistent, though undamaged ---


@pytest.mark.parametrize(
    "key, value",
    [
        *((key, None) for key in ("name", "rig", "material", "training", "scores")),
        *(("rig", text) for text in ("{", "[]", '{"bones": [], "dofs": []}')),
        *(("material", text) for text in ("[]", '{"youngs_modulus": 60, "colour": 3}', '{"youngs_modulus": "stiff"}')),
        *(("material", text) for text in ('{"poisson_ratio": 1.0}', '{"density": NaN}')),
        ("training", "none"),
        ("training", "[]"),
        ("scores", "3"),
        ("name", ""),
    ],
)
def test_metadata_that_make_no_sense_are_refused(saved, key, value):
    def change(metadata, _):
        metadata.update({key: value}) if value is not None else metadata.pop(key)

    refused(saved, "is not valid" if value is not None else f"lacks '{key}'", change)


@pytest.mark.parametrize(
    "text, message",
    [
        (np.zeros((2, 3), np.uint8), "rig.json is uint8 of shape .2, 3., expected uint8"),
        (np.zeros(9, np.int8), "rig.json is int8"),
        (np.full(9, 255, np.uint8), "malformed: UnicodeDecodeError"),
        (np.frombuffer(b"{", np.uint8), "is not valid"),
    ],
)
def test_texts_that_are_none_are_refused(saved, text, message):
    refused(saved, message, lambda _, tensors: tensors.update({"rig.json": text}))


def test_what_is_deflated_is_told_by_metadata_that_the_digest_covers(saved):
    """Damaged streams under a digest that fits, and another story about them, are refused in a sentence."""
    metadata, tensors = read_tensors(saved.read_bytes())
    assert len(json.loads(metadata["deflated"])) > 3
    for name in json.loads(metadata["deflated"]):
        cut = sealed(metadata, tensors | {name: tensors[name][:-1]})
        with pytest.raises(ModelFileError, match="changed.safetensors: .* does not inflate to"):
            load_garment_model(written(saved.with_name("changed.safetensors"), cut))
    told = sealed(metadata | {"deflated": "{}"}, tensors)
    with pytest.raises(ModelFileError, match="changed.safetensors"):
        load_garment_model(written(saved.with_name("changed.safetensors"), told))


def test_places_too_far_for_steps_are_refused_on_saving(saved, tmp_path):
    model = load_garment_model(saved)
    far = replace(model, garment=model.garment.reshaped(model.garment.vertices * 1e5))
    with pytest.raises(ModelFileError, match=r"garment.vertices holds .*; steps of 3.81e-06 store at most 8.19e\+03"):
        save_garment_model(far, tmp_path / "far.safetensors")


def spoilt(tensor, value, at=-1):
    copy = tensor.copy()
    copy.reshape(-1)[at] = value
    return copy


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_every_tensor_is_needed_and_checked(saved):
    """Each left out, with a row more, a row less, an axis more, as a scalar, and with numbers that are not finite; the
    message says what does not fit, and nothing else is said."""
    for name, tensor in contents(saved)[1].items():
        refused(saved, "lacks|is not valid", lambda _, tensors, name=name: tensors.pop(name))
        changed = [tensor[..., None], tensor.reshape(-1)[0:1].reshape(())]
        if name != "garment.faces":  # a face more or less is another valid garment
            changed += [np.concatenate([tensor, tensor[:1]]), tensor[:-1]]
        cases = [("is not valid", wrong) for wrong in changed]
        if tensor.dtype.kind == "f":
            cases += [("finite|skinning weights must be", spoilt(tensor, bad)) for bad in (np.nan, np.inf, -np.inf)]
        for message, wrong in cases:
            refused(saved, message, lambda _, tensors, name=name, wrong=wrong: tensors.update({name: wrong}))


INDICES = ("garment.faces", "garment_nodes.bone", "skinning.nodes")


@pytest.mark.parametrize(
    "name, change, message",
    [
        *((name, lambda array, v=v: spoilt(array.astype(np.int64), v, 3), "index|indices")
          for name in INDICES for v in (200, -1, 2**32 + 1)),
        *((name, lambda array: array.astype(np.float32), "integer index") for name in INDICES),  # else 1.7 becomes 1
        *((name, lambda array: np.ones_like(array, dtype=np.int16), "floating point numbers|pool.bias")
          for name in ("garment_nodes.rest", "pose_modulator.0.weight", "hyper_modulator.pool.bias")),
        ("garment.normals", lambda array: array * (np.arange(len(array)) != 3)[:, None], "vertex 3 is 0.0e.00 long"),
        ("pose_modulator.9.weight", lambda _: np.zeros(3), "pose_modulator.9.weight"),
        ("garment.colour", lambda _: np.zeros(3), "garment.colour"),
        ("pose_modulator.0.bias.largest", lambda _: np.zeros(3), "unknown arrays: pose_modulator.0.bias.largest"),
        ("pose_modulator.0.weight.largest", lambda array: -array, "pose_modulator.0.weight.largest holds -"),
    ],
)  # fmt: skip
def test_values_of_another_kind_and_unknown_arrays_are_refused(saved, name, change, message):
    refused(saved, message, lambda _, tensors: tensors.update({name: change(tensors.get(name))}))


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
        ("rest_angles", "round", "'flat' or 'as_made'"),
        ("rest_angles", ["flat"], "'flat' or 'as_made'"),
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
        *(
            (
                lambda m, octaves=octaves: dict(training={"bending_octaves": octaves}),
                "training.bending_octaves is .*, allowed",
            )
            for octaves in (3, None, "ab", [-2], [-2, "x"], [1, 5], [-2, -1], [-2, 17], [-2, np.nan], [-2, 3, 4])
        ),
        (lambda m: dict(influence_weights=-m.influence_weights), "non-negative and sum to 1"),
        (lambda m: dict(influence_weights=1.1 * m.influence_weights), "non-negative and sum to 1"),
        (lambda m: dict(influence_nodes=m.influence_nodes + 4), r"skinning.nodes holds index \d\.\.\d, allowed 0\.\.5"),
        (lambda m: dict(node_bone=m.node_bone - 9), r"garment_nodes.bone holds index -\d"),
        (lambda m: dict(pose_modulator=()), "pose_modulator has no layers"),
        (
            lambda m: dict(pose_modulator=m.pose_modulator[:-1]),
            r"1.weight has shape .16, 16., expected .48, 16.",
        ),
        (
            lambda m: dict(node_deformer=m.node_deformer[:-1]),
            r"2.weight has shape .48, 16., expected .24, 16.",
        ),
        (
            lambda m: dict(node_deformer=(*m.node_deformer[:-1], (np.ones((54, 12)), np.ones(54)))),
            "expected .72, 12.",
        ),
        (
            lambda m: dict(node_deformer=m.node_deformer[::-1]),
            r"2.weight has shape .48, 16., expected .168, 16.",
        ),
        (lambda m: dict(hyper_modulator={**m.hyper_modulator, "extra.weight": np.zeros(1)}), "unknown.*extra.weight"),
        (lambda m: dict(hyper_modulator={**m.hyper_modulator, "fit": np.zeros(3)}), r"fit has shape \(3,\)"),
        (
            lambda m: dict(rig=tiny(bones=4, dofs=6).rig),
            r"pose_modulator.0.weight has shape \(16, 8\), expected",
        ),
        (lambda m: tiny(width=6), "token width 6 is not a multiple of its 4 heads"),
    ],
)
def test_inconsistent_model_is_refused(change, message):
    """Not only from files: a garment model checks itself."""
    model = tiny()
    with pytest.raises(GarmentModelError, match=message):
        replace(model, **change(model))


def test_network_weights_beyond_half_precision_are_refused_on_saving(tmp_path):
    model = tiny()
    (weight, bias), *rest = model.pose_modulator
    model = replace(model, pose_modulator=((np.where(weight == weight.max(), 1e5, weight), bias), *rest))
    with pytest.raises(ModelFileError, match=r"pose_modulator.0.weight holds 1e\+05; float16 stores at most 6.55e\+04"):
        save_garment_model(model, tmp_path / "model.safetensors")
    assert not list(tmp_path.iterdir())


def test_a_model_in_use_is_not_read_again(tmp_path):
    """Nor is its fabric put on again. A file written anew is another model; so is one whose content is given."""
    path = tmp_path / "tiny.safetensors"
    save_garment_model(tiny(), path)
    model, red = load_garment_model(path), load_garment_model(f"{path}:red")
    assert load_garment_model(str(path)) is model
    assert load_garment_model(f"{path}:red") is red is not model
    assert load_garment_model(path, content=model_content(path)) is not model
    save_garment_model(replace(tiny(), name="other"), path)
    assert load_garment_model(path).name == "other"
    assert model.name == "random"
