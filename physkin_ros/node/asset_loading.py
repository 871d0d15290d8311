"""Bodies and garment models from files to drapers and outfits: which paths are allowed, and what was encoded before.

A network can ask a running node for files, so those must lie below the `asset_roots`. Encodings are kept by the content
of the files they came from, so that a body that comes back is worn at once.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import sys
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Literal

import numpy as np

from physkin_core import (
    BUNDLED_AVATAR,
    Avatar,
    Draper,
    GarmentModel,
    Outfit,
    OutfitGarment,
    load_avatar,
    load_garment_model,
)
from physkin_core.model.fabric import fabric_of
from physkin_core.model.model_file import MODELS_PATH, shipped_models, split_fabric
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.rest_look import RestLook
from physkin_core.runtime.worn_garment import checked_fit
from physkin_ros.joints.nearest_names import nearest_names

__all__ = ["LARGEST_ASSET", "AssetError", "AssetRoots", "DraperLoader", "LoadedDraper", "OutfitLayer", "Outfitting"]

LARGEST_ASSET = 1 << 29
"""[bytes] A larger file is not opened while the node runs."""
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
KEPT = 16
"""Encodings, avatars and garment models that are kept of each."""
KEPT_OUTFITS = 4
"""Outfits that are kept, all their encodings among them."""


class AssetError(ValueError):
    """A file may not be used."""


class AssetRoots:
    """The folders that files may come from while the node runs.

    folders: as the parameter gives them; when there is none, those of `files`, which the node starts with.
    """

    def __init__(self, folders: Iterable[str], files: Iterable[str]) -> None:
        given = [Path(folder) for folder in folders if folder]
        self.folders = tuple(
            dict.fromkeys(path.resolve() for path in given or [Path(file).parent for file in files if file])
        )

    def check(self, path: str) -> None:
        """Raises AssetError for a file elsewhere (links are followed), one that is too large, and what is no file."""
        resolved = Path(path).resolve()
        if not any(resolved.is_relative_to(folder) for folder in self.folders):
            allowed = ", ".join(map(str, self.folders)) or "nothing but shipped garments and the bundled avatar"
            raise AssetError(f"{path} lies outside the parameter asset_roots; allowed: {allowed}")
        if not resolved.is_file():
            raise AssetError(f"{path}: no such file")
        if (size := resolved.stat().st_size) > LARGEST_ASSET:
            raise AssetError(f"{path} has {size} bytes; at most {LARGEST_ASSET} are read while the node runs")


@dataclass(frozen=True)
class Outfitting:
    """What to make a draper of: garment model and body files, the body's empty for the bundled avatar; the rest as
    `Draper` takes it, precision empty for the backend's default. tucked: of a garment of an outfit."""

    model: str = ""
    body_mesh: str = ""
    body_rig: str = ""
    precision: str = ""
    fit: float | None = None
    normals: Literal["skinned", "faces"] = "skinned"
    tucked: bool = False

    def check(self, roots: AssetRoots) -> None:
        """Raises AssetError for a file that may not be used while the node runs."""
        file, fabric = split_fabric(self.model)
        if fabric:
            fabric_of(fabric)
        if file and file not in shipped_models():  # shipped names win over files of the working folder
            if "/" not in file and not Path(file).suffix:
                near = nearest_names(file, shipped_models())
                hint = f"did you mean {near}?" if near else f"allowed: a file, or {', '.join(shipped_models())}"
                raise AssetError(f"no garment model {file!r}; {hint}")
            roots.check(file)
        for path in (self.body_mesh, self.body_rig):
            if path and Path(path) != BUNDLED_AVATAR:
                roots.check(path)


@dataclass(frozen=True)
class OutfitLayer:
    """Garment `index` of `outfit`, from the skin outwards, told as a `Draper` tells of its own; points are those of the
    vertices that are given."""

    outfit: Outfit
    index: int

    @property
    def model(self) -> GarmentModel:
        return self.outfit.models[self.index]

    @property
    def avatar(self) -> Avatar:
        """With the warnings of the whole outfit."""
        return self.outfit.avatar

    @property
    def bound(self) -> BoundGarment:
        """Of the vertices that are given alone."""
        return self.outfit.bounds[self.index]

    @property
    def faces(self) -> np.ndarray:
        """(f, 3) int32 triangles between the points of a cloud."""
        return self.outfit.faces[self.index]

    @property
    def vertex_count(self) -> int:
        """Points of a cloud."""
        return self.outfit.vertex_counts[self.index]

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.outfit.joint_names

    @property
    def fit(self) -> float:
        return self.outfit.fits[self.index]

    @property
    def backend(self) -> str:
        return self.outfit.backend

    @property
    def instruction_set(self) -> str:
        return self.outfit.instruction_set

    @property
    def precision(self) -> str:
        return self.outfit.precision

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of the last frame."""
        return self.outfit.node_transforms()[self.index]

    def mesh_fields(self) -> Mapping[str, object]:
        """What a `physkin_msgs/GarmentMesh` says of a garment of an outfit."""
        outfit, k = self.outfit, self.index
        return {
            "layer": k,
            "layers": len(outfit.models),
            "moved": outfit.moved[k],
            "model_vertex_count": len(outfit.hidden[k]),
            "visible": outfit.visible[k],
            "body_covered": outfit.body_mask if k == 0 else (),
        }


@dataclass(frozen=True)
class LoadedDraper:
    """A draper or a garment of an outfit, whether the body's encoding for it (or for the outfit) was known from before,
    how long that took [s], and how the garment sits."""

    draper: Draper | OutfitLayer
    cached: bool
    seconds: float
    at_rest: RestLook


class DraperLoader:
    """Makes drapers and outfits, from any thread. backend: of all of them."""

    def __init__(self, backend: str) -> None:
        self._backend = backend
        self._lock = Lock()  # one load at a time: a second core is for draping
        self._models: OrderedDict[str, tuple[GarmentModel, str]] = OrderedDict()
        self._avatars: OrderedDict[tuple[str, ...], Avatar] = OrderedDict()
        self._bindings: OrderedDict[tuple[object, ...], tuple[BoundGarment, RestLook]] = OrderedDict()
        self._outfits: OrderedDict[tuple[object, ...], Outfit] = OrderedDict()

    def load(self, wanted: Outfitting) -> LoadedDraper:
        """Read the files and bind the garment to the body. Raises ValueError or OSError naming what is wrong."""
        with self._lock:
            started = perf_counter()
            model, rig, model_key = self._model(wanted)
            avatar, body_key = self._avatar(wanted, model, rig)
            fit = checked_fit(model, wanted.fit)
            key = (*body_key, model_key, fit)
            known, at_rest = self._bindings.get(key, (None, None))
            draper = Draper(
                model,
                avatar,
                backend=self._backend,
                precision=wanted.precision or None,
                fit=fit,
                normals=wanted.normals,
                binding=known,
            )
            at_rest = at_rest or draper.at_rest
            _keep(self._bindings, key, (draper.bound, at_rest))
            _return_memory()
            return LoadedDraper(draper, known is not None, perf_counter() - started, at_rest)

    def load_outfit(self, wanted: Sequence[Outfitting], *, hide: bool) -> list[LoadedDraper]:
        """Put garments on over each other, the innermost first, body, precision and normals being those of the first.

        hide: leave out what is covered. Raises ValueError or OSError naming what is wrong, or what cannot be worn so.
        """
        with self._lock:
            started = perf_counter()
            first, models = wanted[0], [self._model(each) for each in wanted]
            avatar, body_key = self._avatar(first, *models[0][:2])
            garments = [
                OutfitGarment(model, tucked=each.tucked, fit=checked_fit(model, each.fit))
                for each, (model, *_) in zip(wanted, models)
            ]
            worn = ((key, garment.tucked, garment.fit) for (*_, key), garment in zip(models, garments))
            key = (avatar.source, *body_key, *worn, first.precision, first.normals, hide)
            known = self._outfits.get(key)
            outfit = (
                Outfit(
                    garments,
                    avatar,
                    backend=self._backend,
                    precision=first.precision or None,
                    normals=first.normals,
                    hide=hide,
                )
                if known is None
                else known.twin()
            )
            _keep(self._outfits, key, outfit, most=KEPT_OUTFITS)
            _return_memory()
            took = perf_counter() - started
            return [
                LoadedDraper(OutfitLayer(outfit, k), known is not None, took, at_rest)
                for k, at_rest in enumerate(outfit.at_rest)
            ]

    def _model(self, wanted: Outfitting) -> tuple[GarmentModel, str, str]:
        """Garment model, its rig as text, and what it is known by: its content and its fabric."""
        name, fabric = split_fabric(wanted.model)
        source = MODELS_PATH / f"{name}.safetensors" if name in shipped_models() else Path(name)
        key = f"{_digest(source)}:{fabric}" if source.is_file() else name
        if key not in self._models:
            model = load_garment_model(wanted.model)
            _keep(self._models, key, (model, json.dumps(model.rig.to_json())))
        return *self._models[key], key

    def _avatar(self, wanted: Outfitting, model: GarmentModel, rig: str) -> tuple[Avatar, tuple[str, ...]]:
        """The body in the canonical pose of the model's rig, and what its files are known by: their content."""
        body = Path(wanted.body_mesh or BUNDLED_AVATAR)
        content = _digests(body, wanted.body_rig)
        key = (str(body), *content, rig)
        avatar = self._avatars.get(key) or load_avatar(body, model.rig, rig_file=wanted.body_rig or None)
        _keep(self._avatars, key, avatar)
        return avatar, content


def _return_memory() -> None:
    """Give back to the system what loading has left free: where bodies are swapped for days, glibc keeps half as much
    again in pieces."""
    if trim := getattr(LIBC, "malloc_trim", None):
        trim(0)


def _keep(kept: OrderedDict, key: object, value: object, *, most: int | None = None) -> None:
    """Put an entry in as the latest, and drop the oldest when there are too many."""
    kept[key] = value
    kept.move_to_end(key)
    while len(kept) > (KEPT if most is None else most):
        kept.popitem(last=False)


def _digests(body: Path, rig_file: str) -> tuple[str, ...]:
    """Of everything that a body is read from: the mesh, its rig file, and the buffers beside a .gltf; what is too large
    to be read from there is left out."""
    files = [body, Path(rig_file) if rig_file else body.with_suffix(".rig.json")]
    if body.suffix.lower() == ".gltf":
        files += sorted(body.parent.glob("*.bin"))
    return tuple(_digest(file) for file in files if file.is_file() and file.stat().st_size <= LARGEST_ASSET)


def _digest(path: str | Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
