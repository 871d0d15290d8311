"""Garment model files damaged at random: refused by name, or a valid model; never anything else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from model_files import contents, edited_header, save_packed, sealed, written
from random_models import random_model

from physkin_core import GarmentModel, ModelFileError, load_garment_model

UNTIMED = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]  # a first draw reads all sources for constants
COMMON = dict(deadline=None, suppress_health_check=UNTIMED, derandomize=True)
DTYPES = ("float16", "float32", "float64", "int8", "uint8", "uint16", "int32", "int64", "bool")
VALUES = (0, 1, -1, 255, 65535, 2**31 - 1, 1e6, 6e4, float("nan"), float("inf"))
SIZES = (0, 1, 7, 2**31, 2**53, 2**63 - 1, 2**64 - 1, 2**80, -1)


@pytest.fixture(scope="module")
def small_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "small.safetensors"
    save_packed(random_model(np.random.default_rng(80)), path)
    return path


def load(tmp_path, content: bytes) -> GarmentModel | None:
    """The model, or None when the loader refused it as it promises to."""
    try:
        return load_garment_model(written(tmp_path / "damaged.safetensors", content))
    except ModelFileError as error:
        assert str(error)
        return None


def damage_header(data, header: dict, size: int) -> None:
    """Another shape, type or place of one tensor, in a header that is otherwise sound; huge sizes among them."""
    entry = header[data.draw(st.sampled_from(sorted(set(header) - {"__metadata__"})))]
    kind = data.draw(st.sampled_from(["dtype", "shape", "data_offsets"]))
    types = st.sampled_from(["F64", "F32", "F16", "BF16", "F8_E4M3", "I64", "I32", "U8", "BOOL", "F4", ""])
    numbers = st.lists(st.one_of(st.sampled_from(SIZES), st.integers(0, size)), max_size=3)
    entry[kind] = data.draw(types if kind == "dtype" else numbers)


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
            damaged = edited_header(content, lambda header: damage_header(data, header, len(content)))
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
    metadata, tensors = contents(small_path)
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
    model = load(tmp_path, sealed(metadata, tensors))
    if model is not None:
        assert all(np.isfinite(array).all() for array in model.arrays().values())
        assert model.influence_nodes.max() < len(model.node_rest) and model.node_bone.max() < model.rig.bone_count


@pytest.mark.parametrize("check", [check_damaged_bytes, check_forged_arrays], ids=lambda check: check.__name__)
@pytest.mark.parametrize("examples", [75, pytest.param(5000, marks=pytest.mark.slow)])
def test_loader(examples, check, tmp_path, small_path):
    @settings(max_examples=examples, **COMMON)
    @given(st.data())
    def loader(data):
        check(data, tmp_path, small_path)

    loader()
