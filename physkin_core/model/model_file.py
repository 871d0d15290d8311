"""The garment model file: one safetensors file, read and written only here.

Large network weights are stored in ten bits or eight (`packed_weights`), small ones and biases in half precision,
geometry and skinning weights in whole steps (`physkin_core.model.model_arrays`), indices in the smallest unsigned type;
then whatever becomes smaller so is deflated (`deflated_tensors`). Rig, material, training and scores are JSON texts,
tensors of bytes. The metadata hold name, schema version, what is deflated, and a SHA-256 digest over tensors and
metadata as they are stored, so that a damaged or altered file is refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np

from physkin_core.file_reading import ContentError, read_bytes, reading, shown
from physkin_core.formats.deflated_tensors import deflate_tensors, inflate_tensors
from physkin_core.formats.packed_weights import pack_weight, unpack_weights
from physkin_core.model.fabric import with_fabric
from physkin_core.model.faces_of_panels import with_faces, without_faces
from physkin_core.model.garment import GarmentError
from physkin_core.model.garment_model import GarmentModel, Material
from physkin_core.model.model_arrays import Array, GarmentModelError, described_arrays, read_described
from physkin_core.rig.rig import Rig, RigError
from physkin_core.tensor_file import DIGEST, content_digest, read_tensors, write_tensors

__all__ = [
    "SCHEMA_VERSION",
    "ModelFileError",
    "load_garment_model",
    "model_content",
    "save_garment_model",
    "shipped_models",
    "split_fabric",
]

FORMAT = "physkin-garment"
SCHEMA_VERSION = 8
LEAST_PACKED = 2**15
"""Network weights of so many numbers or more are packed, and those that lie on steps. Smaller ones take little space;
among them is the pose modulator's first layer, whose rounding can move single vertices by almost a millimetre."""
TEXTS = ("rig", "material", "training", "scores")
"""Plain data in JSON, in tensors of bytes NAME.json."""
MODEL_SUFFIX = ".safetensors"
MODELS_PATH = Path(__file__).parents[1] / "assets" / "models"
_in_use: WeakValueDictionary[tuple[object, ...], GarmentModel] = WeakValueDictionary()
"""Models that somebody uses, by the file as it was when it was read (path, inode, time, size), and fabric."""


class ModelFileError(ValueError):
    """A garment model file cannot be read, or does not hold a valid model."""


def load_garment_model(path: str | Path, *, content: bytes | None = None) -> GarmentModel:
    """Read a garment model and check it. A file that is read again while its model is in use gives the same object.

    Args:
        path: the name of an included garment ("tshirt"), or a file. A fabric and a colour may follow: "skirt:denim",
            "skirt:denim:navy", "skirt:#334", "my.safetensors:bend=1e-4"; see `with_fabric`.
        content: the bytes of the file, if they were read already (`model_content`). None: they are read.

    Returns:
        The garment model.

    Raises:
        ModelFileError: if the file is missing, truncated, altered or of another schema version, or has an array of an
            unknown name, a wrong shape or type, an index out of range or a value that is not finite.
        ValueError: for an unknown fabric or colour, or a fabric that the model has not learnt.

    Examples:
        >>> tshirt = physkin.load_garment_model("tshirt")
        >>> jeans = physkin.load_garment_model("trousers:denim:indigo")
    """
    file, fabric = split_fabric(path)
    path = _resolve(file)
    with reading(f"garment model {path}", ModelFileError):
        if content is not None:
            model = _read_model(path, content)
        else:
            state = path.stat()
            kept = path.absolute(), state.st_ino, state.st_mtime_ns, state.st_size
            model = _kept((*kept, ""), lambda: _read_model(path, read_bytes(path)))
    if not fabric:
        return model
    return (
        with_fabric(model, fabric)
        if content is not None
        else _kept((*kept, fabric), lambda: with_fabric(model, fabric))
    )


def _kept(key: tuple[object, ...], make: Callable[[], GarmentModel]) -> GarmentModel:
    model = _in_use.get(key)
    if model is None:
        model = _in_use[key] = make()
    return model


def model_content(path: str | Path) -> bytes:
    """The bytes of the file that `load_garment_model` reads, to tell it from others before it is loaded. Raises
    ModelFileError."""
    file = _resolve(split_fabric(path)[0])
    with reading(f"garment model {file}", ModelFileError):
        return read_bytes(file)


def _read_model(path: Path, content: bytes) -> GarmentModel:
    metadata, tensors = _contents(path, content)
    version = int(metadata["schema_version"])
    if version != SCHEMA_VERSION:
        remedy = "train it anew" if version < SCHEMA_VERSION else "update PhySkin"
        raise ModelFileError(
            f"garment model {path} has schema version {version}, this release reads {SCHEMA_VERSION}; {remedy}"
        )
    return _model(path, metadata, tensors)


def split_fabric(name: str | Path) -> tuple[str, str]:
    """What `load_garment_model` takes: the file or shipped name, and the fabric, its colour behind it, empty where none
    is named."""
    file, fabric = str(name), ""
    for _ in ("colour", "fabric"):
        rest, colon, part = file.rpartition(":")
        if not colon or not rest or Path(file).is_file():
            break
        file, fabric = rest, f"{part}:{fabric}" if fabric else part
    return file, fabric


def _contents(path: Path, content: bytes) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Metadata and tensors of a file of any schema version, with the digest checked."""
    try:
        metadata, tensors = read_tensors(content)
    except ContentError as error:
        if path.suffix == MODEL_SUFFIX:
            raise
        raise ModelFileError(
            f"{path} is not a garment model, allowed are {MODEL_SUFFIX} files and {', '.join(shipped_models())}; "
            "physkin fit-garment makes one of a mesh"
        ) from error
    if metadata.get("format") != FORMAT:
        raise ContentError(
            f"its format is {shown(metadata.get('format'))}, expected {FORMAT!r}: it is not a garment model"
        )
    version = metadata.get("schema_version", "")
    if not re.fullmatch("[1-9][0-9]{0,8}", version):
        raise ContentError(f"it has schema version {shown(version)}, expected {SCHEMA_VERSION}")
    if metadata.get(DIGEST) != content_digest(metadata, tensors):
        raise ContentError("it is damaged or was altered: its SHA-256 digest does not match")
    metadata, tensors = inflate_tensors(metadata, tensors)
    texts = {key: tensors.pop(f"{key}.json") for key in TEXTS if f"{key}.json" in tensors}
    return metadata | {key: _text(key, text) for key, text in texts.items()}, with_faces(tensors)


def _text(key: str, stored: np.ndarray) -> str:
    if stored.dtype != np.uint8 or stored.ndim != 1:
        raise ContentError(f"{key}.json is {stored.dtype} of shape {stored.shape}, expected uint8 (bytes,)")
    return stored.tobytes().decode()


def _model(path: Path, metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> GarmentModel:
    """The model that metadata and tensors of a file hold."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by GarmentModel
            arrays = {
                name: tensor.astype(np.float32, copy=False) if tensor.dtype.kind == "f" else tensor
                for name, tensor in unpack_weights(tensors).items()
            }
            described = read_described(GarmentModel, arrays)
        model = GarmentModel(
            name=metadata["name"],
            rig=Rig.from_json(json.loads(metadata["rig"])),
            **described,
            material=Material(**json.loads(metadata["material"])),
            training=json.loads(metadata["training"]),
            scores=json.loads(metadata["scores"]),
        )
    except KeyError as error:
        raise ModelFileError(f"garment model {path} lacks {error}") from error
    except (GarmentModelError, GarmentError, RigError, TypeError, ValueError) as error:
        raise ModelFileError(f"garment model {path} is not valid: {error}") from error
    if unknown := sorted(arrays.keys() - model.arrays().keys()):
        raise ModelFileError(f"garment model {path} holds unknown arrays: {', '.join(unknown)}")
    return model


def save_garment_model(model: GarmentModel, path: str | Path) -> None:
    """Write a garment model, replacing an existing file in one step.

    Args:
        model: a checked garment model.
        path: the file to write.

    Raises:
        ModelFileError: if a value is too large for the precision it is stored in; nothing is written then.

    Examples:
        >>> silk = physkin.load_garment_model("dress:silk")
        >>> physkin.save_garment_model(silk, "silk_dress.safetensors")
    """
    length = np.linalg.norm(model.rest_normals, axis=1, keepdims=True)
    normals = np.where(np.abs(length - 1) < 0.01, model.rest_normals, model.rest_normals / length)
    tensors: dict[str, np.ndarray] = {}
    for name, array, kind in described_arrays(replace(model, rest_normals=normals)):
        tensors |= _stored(name, array, kind)
    plain = (model.rig.to_json(), asdict(model.material), dict(model.training), dict(model.scores))
    texts = {f"{key}.json": np.frombuffer(json.dumps(data).encode(), np.uint8) for key, data in zip(TEXTS, plain)}
    deflated, stored = deflate_tensors(texts | without_faces(tensors))
    metadata = {"format": FORMAT, "name": model.name, **deflated, "schema_version": str(SCHEMA_VERSION)}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_tensors(path, metadata, stored)


def shipped_models() -> list[str]:
    """Names of the garment models that come with the package, as `load_garment_model` takes them."""
    return sorted(file.stem for file in MODELS_PATH.glob(f"*{MODEL_SUFFIX}"))


def _resolve(path: str | Path) -> Path:
    candidate, shipped = Path(path), shipped_models()
    if str(path) in shipped:
        return MODELS_PATH / f"{path}{MODEL_SUFFIX}"
    if candidate.suffix == "" and not candidate.is_file():
        raise ModelFileError(f"no garment model {str(path)!r}: give a file, or one of {', '.join(shipped) or 'none'}")
    return candidate


def _stored(name: str, array: np.ndarray, kind: Array) -> dict[str, np.ndarray]:
    """What the file holds of an array, by name."""
    if kind.below:
        return {name: array.astype(np.min_scalar_type(int(array.max())))}
    if kind.step:
        return {name: _in_steps(name, array, kind)}
    with np.errstate(over="ignore"):
        stored: dict[str, np.ndarray] = {name: array.astype(kind.stored)}
        if array.ndim == 2 and kind.stored is np.float16:
            packed = pack_weight(name, array)
            in_ten_bits = f"{name}.low" in packed
            if not in_ten_bits or (name.endswith(".weight") and array.size >= LEAST_PACKED):
                stored = packed
    for tensor in stored.values():
        if not np.isfinite(tensor).all():
            largest = np.finfo(tensor.dtype).max
            raise ModelFileError(f"{name} holds {np.abs(array).max():.3g}; {tensor.dtype} stores at most {largest:.3g}")
    return stored


def _in_steps(name: str, array: np.ndarray, kind: Array) -> np.ndarray:
    """Whole steps, the closest; of rows that sum to 1 the closest that do."""
    exact = array / kind.step
    steps = np.floor(exact) if kind.sums_to_one else np.rint(exact)
    if kind.sums_to_one:
        missing = np.rint(1 / kind.step) - steps.sum(axis=1, keepdims=True)
        steps += (steps - exact).argsort(axis=1).argsort(axis=1) < missing
    largest = np.abs(steps).max()
    for whole in (np.int8, np.int16, np.int32):
        if largest <= np.iinfo(whole).max:
            return steps.astype(whole)
    most = np.iinfo(np.int32).max * kind.step
    raise ModelFileError(f"{name} holds {largest * kind.step:.3g}; steps of {kind.step:.3g} store at most {most:.3g}")
