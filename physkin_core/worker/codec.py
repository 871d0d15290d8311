"""Values as plain text and arrays: what two processes say to each other. Nothing that is read here is ever executed.

Known are None, truth values, numbers, texts, tuples (lists become tuples), mappings by text, NumPy arrays, and the
dataclasses that a codec is given. What is there twice is written once, and is the same object again when it is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

__all__ = ["Codec", "CodecError"]

PLAIN = (bool, int, float, str)
NUMERIC = "biuf"
"""Kinds of arrays' elements; records of these are allowed, too."""


class CodecError(ValueError):
    """A value that cannot be written, or a text that says none."""


class Codec:
    """Writes and reads values. kinds: dataclasses that may be in them; their fields are read as they were written,
    derived ones too, and not checked again."""

    def __init__(self, kinds: Iterable[type]) -> None:
        self._kinds = {kind.__name__: kind for kind in kinds}

    def encode(self, value: object) -> tuple[str, list[np.ndarray]]:
        """The text of a value, and the arrays that it refers to, C-contiguous."""
        writing = _Writing(self._kinds)
        said = writing.say(value)
        arrays = [np.asarray(array, order="C") for array in writing.arrays]
        laid_out = [[_description(array.dtype), array.shape] for array in arrays]
        return json.dumps({"value": said, "objects": writing.objects, "arrays": laid_out}), arrays

    def empty_arrays(self, text: str, most_bytes: int) -> list[np.ndarray]:
        """Arrays to be filled for `decode`. Raises CodecError for a text that is none of `encode`'s, and for more
        bytes than these."""
        try:
            laid_out = [(_dtype(described), tuple(shape)) for described, shape in json.loads(text)["arrays"]]
            sizes = [dtype.itemsize * _product(shape) for dtype, shape in laid_out]
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise CodecError(f"not a message: {error}") from error
        if sum(sizes) > most_bytes:
            raise CodecError(f"a message of {sum(sizes)} bytes; at most {most_bytes} are taken")
        return [np.empty(shape, dtype) for dtype, shape in laid_out]

    def decode(self, text: str, arrays: list[np.ndarray]) -> Any:
        """The value of a text and its arrays. Raises CodecError for what `encode` would not have written."""
        try:
            message = json.loads(text)
            objects: list[object] = []
            for entry in message["objects"]:
                objects.append(self._object(entry["kind"], entry["fields"], arrays, objects))
            return self._value(message["value"], arrays, objects)
        except (ValueError, TypeError, AttributeError, LookupError, RecursionError) as error:
            raise CodecError(f"not a message: {error}") from error

    def _object(self, kind: str, said: Mapping[str, object], arrays: list[np.ndarray], objects: list[object]) -> object:
        made = self._kinds[kind]
        if said.keys() != {field.name for field in fields(made)}:
            raise CodecError(f"a {kind} of the fields {', '.join(said)}")
        new: object = object.__new__(made)
        for name, value in said.items():
            object.__setattr__(new, name, self._value(value, arrays, objects))
        return new

    def _value(self, said: Any, arrays: list[np.ndarray], objects: list[object]) -> object:
        if isinstance(said, list):
            return tuple(self._value(each, arrays, objects) for each in said)
        if not isinstance(said, dict):
            return said
        ((how, what),) = said.items()
        if how == "mapping":
            return {key: self._value(each, arrays, objects) for key, each in what.items()}
        return arrays[what] if how == "array" else {"object": objects}[how][what]


class _Writing:
    """Arrays and objects of one value, each once."""

    def __init__(self, kinds: Mapping[str, type]) -> None:
        self._kinds = kinds
        self.arrays: list[np.ndarray] = []
        self.objects: list[dict[str, Any]] = []
        self._known: dict[int, dict[str, int]] = {}

    def say(self, value: Any) -> Any:
        if value is None or type(value) in PLAIN:
            return value
        if isinstance(value, tuple | list):
            return [self.say(each) for each in value]
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) for key in value):
                raise CodecError("a mapping's keys must be strings")
            return {"mapping": {key: self.say(each) for key, each in value.items()}}
        if isinstance(value, np.generic):
            return self.say(value.item())
        if id(value) not in self._known:
            self._known[id(value)] = self._array(value) if isinstance(value, np.ndarray) else self._object(value)
        return self._known[id(value)]

    def _array(self, array: np.ndarray) -> dict[str, int]:
        dtype = _dtype(_description(array.dtype))
        self.arrays.append(array.astype(dtype, copy=False))
        return {"array": len(self.arrays) - 1}

    def _object(self, value: Any) -> dict[str, int]:
        kind = type(value)
        if self._kinds.get(kind.__name__) is not kind:
            raise CodecError(f"{kind.__name__} cannot be sent")
        said = {field.name: self.say(getattr(value, field.name)) for field in fields(kind)}
        self.objects.append({"kind": kind.__name__, "fields": said})
        return {"object": len(self.objects) - 1}


def _description(dtype: np.dtype) -> Any:
    """What JSON can say of it; records without what lies between their fields."""
    return dtype.str if dtype.names is None else [(name, dtype[name].str) for name in dtype.names]


def _dtype(described: Any) -> np.dtype:
    """Raises CodecError for elements that are no numbers, nor records of them."""
    dtype = np.dtype(described if isinstance(described, str) else [(str(name), str(kind)) for name, kind in described])
    parts = [dtype] if dtype.names is None else [dtype[name] for name in dtype.names]
    if any(part.kind not in NUMERIC for part in parts):
        raise CodecError(f"arrays of {dtype} cannot be sent")
    return dtype


def _product(shape: tuple[Any, ...]) -> int:
    """Elements of a shape; Python's own integers do not overflow."""
    count = 1
    for size in shape:
        if type(size) is not int or size < 0:
            raise CodecError(f"an array of shape {shape}")
        count *= size
    return count
