"""Garment model files damaged at random: refused by name, or a valid model; never anything else."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_models import random_model
from safetensors import safe_open
from safetensors.numpy import save

from physkin_core import GarmentModel, ModelFileError, load_garment_model, save_garment_model
from physkin_core.model.model_file import _digest

COMMON = dict(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
DTYPES = ("float16", "float32", "float64", "uint8", "uint16", "int32", "int64", "bool")
VALUES = (0, 1, -1, 255, 65535, 2**31 - 1, 1e6, 6e4, float("nan"), float("inf"))
SIZES = (0, 1, 7, 2**31, 2**53, 2**63 - 1, 2**64 - 1, 2**80, -1)


@pytest.fixture(scope="module")
def small_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "small.safetensors"
    save_garment_model(random_model(np.random.default_rng(80)), path)
    return path


def load(tmp_path, content: bytes) -> GarmentModel | None:
    """The model, or None when the loader refused it as it promises to."""
    path = tmp_path / "damaged.safetensors"
    path.write_bytes(content)
    try:
        return load_garment_model(path)
    except ModelFileError as error:
        assert str(error)
        return None


def damage_header(data, content: bytes) -> bytes:
    """Another shape, type or place of one tensor, in a header that is otherwise sound; huge sizes among them."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    entry = header[data.draw(st.sampled_from(sorted(set(header) - {"__metadata__"})))]
    kind = data.draw(st.sampled_from(["dtype", "shape", "data_offsets"]))
    if kind == "dtype":
        entry[kind] = data.draw(
            st.sampled_from(["F64", "F32", "F16", "BF16", "F8_E4M3", "I64", "I32", "U8", "BOOL", "F4", ""])
        )
    else:
        numbers = st.one_of(st.sampled_from(SIZES), st.integers(0, len(content)))
        entry[kind] = data.draw(st.lists(numbers, max_size=3))
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + content[8 + size :]


def check_damaged_bytes(data, tmp_path, small_path):
    """Cut off, overwritten, or with another header: the digest or the reader notices all of it."""
    content = small_path.read_bytes()
    match data.draw(st.sampled_from(["cut", "bytes", "header", "length"])):
        case "cut":
            damaged = content[: data.draw(st.integers(0, len(content) - 1))]
        case "bytes":
            at = data.draw(st.integers(0, len(content) - 9))
            damaged = content[:at] + data.draw(st.binary(min_size=1, max_size=8)) + content[at + 8 :]
        case "header":
            damaged = damage_header(data, content)
        case _:
            damaged = data.draw(st.sampled_from(SIZES[:7])).to_bytes(8, "little") + content[8:]
    if damaged != content:
        model = load(tmp_path, damaged)
        # A header may say the same in other words.
        assert model is None or all(
            np.array_equal(array, load_garment_model(small_path).arrays()[name])
            for name, array in model.arrays().items()
        )


def check_forged_arrays(data, tmp_path, small_path):
    """Arrays of another shape, type or content with a digest that fits: the checks of the model have to notice."""
    with safe_open(small_path, framework="numpy") as file:
        metadata, tensors = dict(file.metadata()), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    name = data.draw(st.sampled_from(sorted(tensors)))
    array = tensors[name]
    match data.draw(st.sampled_from(["type", "value", "shape", "drop", "rename", "metadata"])):
        case "type":
            with np.errstate(all="ignore"):
                tensors[name] = array.astype(data.draw(st.sampled_from(DTYPES)))
        case "value":
            value = data.draw(st.sampled_from(VALUES))
            array = array.copy() if array.dtype.kind == "f" else array.astype(np.int64)
            with np.errstate(all="ignore"):
                array.flat[data.draw(st.integers(0, array.size - 1))] = (
                    value if array.dtype.kind == "f" else int(np.nan_to_num(value, posinf=9))
                )
            tensors[name] = array
        case "shape":
            tensors[name] = np.resize(array, data.draw(st.lists(st.integers(0, 40), max_size=3)))
        case "drop":
            del tensors[name]
        case "rename":
            tensors[data.draw(st.text(min_size=1, max_size=9))] = tensors.pop(name)
        case _:
            key = data.draw(st.sampled_from(sorted(metadata)))
            metadata[key] = data.draw(
                st.sampled_from(["", "{}", "[]", "null", "NaN", "1e999", '{"bones": []}', "silu"])
            )
    metadata["sha256"] = _digest(metadata, tensors)
    model = load(tmp_path, save(tensors, metadata=metadata))
    if model is not None:
        assert all(np.isfinite(array).all() for array in model.arrays().values())
        assert model.influence_nodes.max() < len(model.node_rest) and model.node_bone.max() < model.rig.bone_count


@pytest.mark.parametrize("dtype", ["BF16", "F8_E4M3", "F8_E5M2", "C64"])
def test_types_that_numpy_lacks_are_refused(dtype, tmp_path, small_path):
    content = small_path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    name = next(name for name, entry in header.items() if entry.get("dtype") == "F16" and entry["shape"][0] % 8 == 0)
    width = {"BF16": 1, "C64": 4}.get(dtype)
    header[name]["dtype"] = dtype
    header[name]["shape"][0] = int(header[name]["shape"][0] // width if width else 2 * header[name]["shape"][0])
    text = json.dumps(header).encode()
    assert load(tmp_path, len(text).to_bytes(8, "little") + text + content[8 + size :]) is None


CHECKS = [check_damaged_bytes, check_forged_arrays]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_loader(check, tmp_path, small_path):
    @settings(max_examples=150, **COMMON)
    @given(st.data())
    def loader(data):
        check(data, tmp_path, small_path)

    loader()


@pytest.mark.slow
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_loader_for_long(check, tmp_path, small_path):
    @settings(max_examples=5000, **COMMON)
    @given(st.data())
    def loader(data):
        check(data, tmp_path, small_path)

    loader()
