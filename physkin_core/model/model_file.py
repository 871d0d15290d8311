"""The garment model file: one safetensors file, read and written only here.

Large network weights are stored in ten bits or eight (`packed_weights`), small ones, biases and skinning weights in
half precision, indices in the smallest unsigned type, geometry in float32. The metadata hold the schema version, the
rig, material, training and scores, and a SHA-256 digest over tensors and metadata, so that a damaged or altered file is
refused.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from physkin_core.model.fabric import made_of
from physkin_core.model.garment import Garment, GarmentError
from physkin_core.model.garment_model import INDEX_ARRAYS, GarmentModel, GarmentModelError, Material
from physkin_core.model.mlp import Layer
from physkin_core.model.packed_weights import pack_weight, unpack_weights
from physkin_core.model.sway_network import SwayNetwork
from physkin_core.rig.rig import Rig, RigError

__all__ = [
    "SCHEMA_VERSION",
    "ModelFileError",
    "load_garment_model",
    "save_garment_model",
    "shipped_models",
    "split_fabric",
]

FORMAT = "physkin-garment"
SCHEMA_VERSION = 4
"""Files of version 1 lack "garment.normals"; they get those of the mesh. Before 3 all network weights are in half
precision, before 4 there is no sway network."""
LEAST_PACKED = 2**15
"""Network weights of so many numbers or more are packed. Smaller ones take little space; among them is the pose
modulator's first layer, whose rounding can move single vertices by almost a millimetre."""
MODEL_SUFFIX = ".safetensors"
MODELS_PATH = Path(__file__).parents[1] / "assets" / "models"
GEOMETRY_ARRAYS = ("garment.vertices", "garment.normals", "garment_nodes.rest")


class ModelFileError(ValueError):
    """A garment model file cannot be read, or does not hold a valid model."""


def load_garment_model(path: str | Path) -> GarmentModel:
    """Read and check a garment model; the bare name of a shipped one ("tshirt") means that, whatever files there are.
    With a colon and a fabric behind it ("skirt:denim", "my.safetensors:bend=1e-4") it is made of that, see `made_of`.

    Raises ModelFileError when the file is missing, truncated, altered, of a newer schema version, or holds an array of
    an unknown name, the wrong shape or type, an index out of range or a value that is not finite; ValueError for a
    fabric that is unknown, or that the model has not learnt.
    """
    file, fabric = split_fabric(path)
    model = _read(_resolve(file))
    return made_of(model, fabric) if fabric else model


def split_fabric(name: str | Path) -> tuple[str, str]:
    """What `load_garment_model` takes: the file or shipped name, and the fabric, empty where none is named."""
    file, colon, fabric = str(name).rpartition(":")
    return (file, fabric) if colon and file and not Path(name).is_file() else (str(name), "")


def _read(path: Path) -> GarmentModel:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except FileNotFoundError as error:
        raise ModelFileError(f"cannot read garment model {path}: no such file") from error
    except (OSError, SafetensorError, TypeError, AttributeError) as error:  # the last two: a type that NumPy lacks
        if path.suffix == MODEL_SUFFIX:
            raise ModelFileError(f"cannot read garment model {path}: {error}") from error
        raise ModelFileError(
            f"{path} is not a garment model, allowed are {MODEL_SUFFIX} files and {', '.join(shipped_models())}; "
            "physkin fit-garment makes one of a mesh"
        ) from error
    _check_header(path, metadata, tensors)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by GarmentModel
            arrays = {
                name: tensor.astype(np.float32, copy=False) if tensor.dtype.kind == "f" else tensor
                for name, tensor in unpack_weights(tensors).items()
            }
            for name in arrays.keys() & {"skinning.weights", "engine_skinning.weights"}:
                arrays[name] /= np.maximum(arrays[name].sum(axis=-1, keepdims=True), 1e-6)
        model = GarmentModel(
            name=metadata["name"],
            rig=Rig.from_json(json.loads(metadata["rig"])),
            garment=Garment(arrays["garment.vertices"], arrays["garment.faces"]),
            node_rest=arrays["garment_nodes.rest"],
            node_bone=arrays["garment_nodes.bone"],
            influence_nodes=arrays["skinning.nodes"],
            influence_weights=arrays["skinning.weights"],
            hyper_modulator=_with_prefix(arrays, "hyper_modulator."),
            pose_modulator=_layers(arrays, "pose_modulator."),
            node_deformer=_layers(arrays, "node_deformer."),
            activation=metadata["activation"],
            engine_nodes=arrays.get("engine_skinning.nodes"),
            engine_weights=arrays.get("engine_skinning.weights"),
            sway=SwayNetwork.from_arrays(_with_prefix(arrays, "sway.")),
            rest_normals=arrays["garment.normals"] if int(metadata["schema_version"]) > 1 else None,
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
    """Write a garment model (a checked `GarmentModel`) to `path`, replacing what is there in one step.

    Raises ModelFileError, and writes nothing, when a value is too large for the precision it is stored in.
    """
    from safetensors.numpy import save

    tensors = {}
    for name, array in model.arrays().items():
        tensors |= {key: np.ascontiguousarray(tensor) for key, tensor in _stored(name, array).items()}
    metadata = {
        "format": FORMAT,
        "schema_version": str(SCHEMA_VERSION),
        "name": model.name,
        "activation": model.activation,
        "rig": json.dumps(model.rig.to_json()),
        "material": json.dumps(asdict(model.material)),
        "training": json.dumps(dict(model.training)),
        "scores": json.dumps(dict(model.scores)),
    }
    metadata["sha256"] = _digest(metadata, tensors)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(save(tensors, metadata=metadata))
    partial.replace(path)


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


def _check_header(path: Path, metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> None:
    if metadata.get("format") != FORMAT:
        raise ModelFileError(f"{path} is not a garment model: format {metadata.get('format')!r}, expected {FORMAT!r}")
    version = metadata.get("schema_version", "")
    if not re.fullmatch("[1-9][0-9]{0,8}", version):
        raise ModelFileError(f"garment model {path} has schema version {version!r}, expected 1 to {SCHEMA_VERSION}")
    if int(version) > SCHEMA_VERSION:
        raise ModelFileError(
            f"garment model {path} has schema version {version}; this release reads up to {SCHEMA_VERSION}, update it"
        )
    if metadata.get("sha256") != _digest(metadata, tensors):
        raise ModelFileError(f"garment model {path} is damaged or was altered: its SHA-256 digest does not match")


def _digest(metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for key in sorted(set(metadata) - {"sha256"}):
        digest.update(f"{key}\0{metadata[key]}\0".encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name}\0{tensor.dtype.str}\0{tensor.shape}\0".encode())
        digest.update(np.ascontiguousarray(tensor).tobytes())
    return digest.hexdigest()


def _stored(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """What the file holds of an array, by name."""
    if name in INDEX_ARRAYS:
        return {name: array.astype(np.min_scalar_type(int(array.max())))}
    with np.errstate(over="ignore"):
        if name.endswith(".weight") and array.ndim == 2 and array.size >= LEAST_PACKED:
            stored = pack_weight(name, array)
        else:
            stored = {name: array.astype(np.float32 if name in GEOMETRY_ARRAYS else np.float16)}
    for tensor in stored.values():
        if not np.isfinite(tensor).all():
            largest = np.finfo(tensor.dtype).max
            raise ModelFileError(f"{name} holds {np.abs(array).max():.3g}; {tensor.dtype} stores at most {largest:.3g}")
    return stored


def _with_prefix(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _layers(arrays: Mapping[str, np.ndarray], prefix: str) -> tuple[Layer, ...]:
    layers = []
    while f"{prefix}{len(layers)}.weight" in arrays:
        index = len(layers)
        layers.append((arrays[f"{prefix}{index}.weight"], arrays[f"{prefix}{index}.bias"]))
    return tuple(layers)
