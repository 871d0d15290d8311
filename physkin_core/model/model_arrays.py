"""What arrays a garment model consists of: each is described once, where its dataclass declares the field.

A description gives the array's name in the file, its shape, how it is stored and what it may hold. Reading, checking
and writing go by it. Sizes have names: the first array with "n" in its shape gives n, all others must have the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

__all__ = [
    "Array",
    "Chain",
    "DescribedArray",
    "GarmentModelError",
    "Linear",
    "Named",
    "Part",
    "check_arrays",
    "described",
    "described_arrays",
    "read_described",
]

DescribedArray = tuple[str, np.ndarray, "Array"]
"""Name in the file, array and its description."""


class GarmentModelError(ValueError):
    """A garment model is incomplete or inconsistent."""


def described(name: str, kind: Array | Linear | Chain | Named | Part, **options: Any) -> Any:
    """A dataclass field whose arrays have this name in the file, or begin with it. options: of `dataclasses.field`."""
    return field(metadata={"name": name, "kind": kind}, **options)


@dataclass(frozen=True)
class Array:
    """shape: sizes with spaces between, each a number, a name or a sum, as in "n 3" and "2K+p 12m". stored: type in the
    file; or step: what the file holds whole multiples of. below: the size that indices, which are whole numbers from 0,
    are below; none for floating point numbers. sums_to_one: each row does, of numbers that are not negative. optional:
    None where the file has none."""

    shape: str
    stored: type = np.float16
    step: float = 0.0
    below: str = ""
    sums_to_one: bool = False
    optional: bool = False

    def arrays(self, name: str, value: np.ndarray | None) -> Iterator[DescribedArray]:
        if value is not None or not self.optional:
            yield name, value, self

    def read(self, name: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray | None:
        """What the file holds; indices as int32, rows that sum to 1 relieved of their rounding. `check` comes after."""
        if self.optional and name not in arrays:
            return None
        array = arrays[name]
        if self.step and array.dtype.kind in "iu":
            array = (array * self.step).astype(np.float32)
        if self.sums_to_one and array.dtype.kind == "f":
            return array / np.maximum(array.sum(axis=-1, keepdims=True), 1e-6)
        if self.below and array.dtype.kind in "iu" and 0 <= array.min() and array.max() <= np.iinfo(np.int32).max:
            return array.astype(np.int32)
        return array

    def check(self, name: str, array: np.ndarray, sizes: dict[str, int]) -> None:
        terms = self.shape.split()
        for term, size in zip(terms, array.shape):
            if term.isidentifier() and len(terms) == array.ndim:
                sizes.setdefault(term, size)
        expected = tuple(_size(term, sizes) for term in terms)
        if array.shape != expected or 0 in expected:
            wanted = str(expected).replace("'", "")
            raise GarmentModelError(f"{name} has shape {array.shape}, expected {wanted}, none of them empty")
        if self.below:
            if array.dtype.kind not in "iu":
                raise GarmentModelError(f"{name} is of type {array.dtype}, expected an integer index")
            if array.min() < 0 or array.max() >= sizes[self.below]:
                allowed = f"allowed 0..{sizes[self.below] - 1}"
                raise GarmentModelError(f"{name} holds index {array.min()}..{array.max()}, {allowed}")
            return
        if array.dtype.kind != "f":
            raise GarmentModelError(f"{name} is of type {array.dtype}, expected floating point numbers")
        if not np.isfinite(array).all():
            raise GarmentModelError(f"{name} holds a value that is not finite")
        if self.sums_to_one and (array.min() < 0 or np.abs(array.sum(axis=-1) - 1).max() > 1e-3):
            raise GarmentModelError(f"{name} must be non-negative and sum to 1 at every vertex")


def _size(term: str, sizes: Mapping[str, int]) -> int | str:
    """The number that a term of a shape stands for; the term itself where a size is not known yet."""
    total = 0
    for factor, name in (re.fullmatch(r"(\d*)(\w*)", part).groups() for part in term.split("+")):
        if name and name not in sizes:
            return term
        total += int(factor or 1) * (sizes[name] if name else 1)
    return total


@dataclass(frozen=True)
class Linear:
    """A layer, network weight and bias: NAME.weight (outputs, inputs) and NAME.bias (outputs,)."""

    outputs: str
    inputs: str

    def arrays(self, name: str, layer: tuple[np.ndarray, np.ndarray]) -> Iterator[DescribedArray]:
        yield f"{name}.weight", layer[0], Array(f"{self.outputs} {self.inputs}")
        yield f"{name}.bias", layer[1], Array(self.outputs)

    def read(self, name: str, arrays: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return arrays[f"{name}.weight"], arrays[f"{name}.bias"]


@dataclass(frozen=True)
class Chain:
    """A tuple of layers, each reading what the one before gives: NAME.0, NAME.1 and so on. Those between the first and
    the last may be projections, without a bias (see `physkin_core.model.mlp`)."""

    inputs: str
    outputs: str

    def arrays(self, name: str, layers: tuple) -> Iterator[DescribedArray]:
        if not layers:
            raise GarmentModelError(f"{name} has no layers")
        widths = [self.inputs, *(str(len(weight)) for weight, _ in layers[:-1]), self.outputs]
        for index, (weight, bias) in enumerate(layers):
            yield f"{name}.{index}.weight", weight, Array(f"{widths[index + 1]} {widths[index]}")
            if len(bias) or index in (0, len(layers) - 1):
                yield f"{name}.{index}.bias", bias, Array(widths[index + 1])

    def read(self, name: str, arrays: Mapping[str, np.ndarray]) -> tuple:
        layers: list = []
        while f"{name}.{len(layers)}.weight" in arrays:
            own = f"{name}.{len(layers)}"
            layers.append((arrays[f"{own}.weight"], arrays.get(f"{own}.bias", np.empty(0, dtype=np.float32))))
        return tuple(layers)


@dataclass(frozen=True)
class Named:
    """A mapping of arrays, NAME.KEY. shapes: those of all keys, from the keys that are there."""

    shapes: Callable[[Collection[str]], dict[str, str]]

    def arrays(self, name: str, value: Mapping[str, np.ndarray]) -> Iterator[DescribedArray]:
        shapes = self.shapes(value)
        if odd := sorted(shapes.keys() ^ value.keys()):
            raise GarmentModelError(f"{name} lacks arrays or has unknown ones: {', '.join(odd)}")
        for key, shape in shapes.items():
            yield f"{name}.{key}", value[key], Array(shape)

    def read(self, name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        keys = {key.removeprefix(f"{name}.") for key in arrays if key.startswith(f"{name}.")}
        return {key: arrays[f"{name}.{key}"] for key in self.shapes(keys)}


@dataclass(frozen=True)
class Part:
    """A dataclass with described fields. optional: None where there are none of its arrays."""

    owner: type
    optional: bool = False

    def arrays(self, name: str, value: object) -> Iterator[DescribedArray]:
        if value is not None:
            yield from described_arrays(value, f"{name}.")

    def read(self, name: str, arrays: Mapping[str, np.ndarray]) -> object:
        if self.optional and not any(key.startswith(f"{name}.") for key in arrays):
            return None
        return self.owner(**read_described(self.owner, arrays, f"{name}."))


def described_arrays(instance: object, prefix: str = "") -> Iterator[DescribedArray]:
    """Every array of a dataclass with its description, by its name in the file."""
    for entry in fields(instance):
        if kind := entry.metadata.get("kind"):
            yield from kind.arrays(prefix + entry.metadata["name"], getattr(instance, entry.name))


def read_described(owner: type, arrays: Mapping[str, np.ndarray], prefix: str = "") -> dict[str, Any]:
    """The described fields of a dataclass from arrays by name. Raises KeyError where one is missing."""
    described_fields = (entry for entry in fields(owner) if "kind" in entry.metadata)
    return {
        entry.name: entry.metadata["kind"].read(prefix + entry.metadata["name"], arrays) for entry in described_fields
    }


def check_arrays(instance: object, sizes: Mapping[str, int]) -> None:
    """Check every array of a dataclass. sizes: known ones. Raises GarmentModelError naming what does not fit."""
    known = dict(sizes)
    for name, array, kind in described_arrays(instance):
        kind.check(name, array, known)
