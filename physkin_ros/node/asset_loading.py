"""Bodies and garment models from files to outfits: which paths are allowed, and what was bound before.

A network can ask a running node for files, so those must lie below the `asset_roots`. Outfits are kept by the content
of the files they came from, so that a body that comes back is worn at once.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import sys
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from time import perf_counter

from physkin_core import (
    BUNDLED_AVATAR,
    Avatar,
    GarmentModel,
    Layer,
    Outfit,
    WornGarment,
    load_avatar,
    load_garment_model,
)
from physkin_core.model.fabric import fabric_of
from physkin_core.model.model_file import MODELS_PATH, shipped_models, split_fabric
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_ros.joints.nearest_names import nearest_names
from physkin_ros.node.settings import GarmentSettings

__all__ = ["LARGEST_ASSET", "AssetError", "AssetRoots", "LoadedLayer", "OutfitLoader"]

LARGEST_ASSET = 1 << 29
"""[bytes] A larger file is not opened while the node runs."""
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
KEPT = 8
"""Outfits, avatars and garment models that are kept of each, the latest."""


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

    def check_garment(self, model: str) -> None:
        """Raises AssetError for a garment model, a file or a shipped name with a fabric behind it, that may not be used
        while the node runs; ValueError for an unknown fabric."""
        file, fabric = split_fabric(model)
        if fabric:
            fabric_of(fabric)
        if file and file not in shipped_models():  # shipped names win over files of the working folder
            if "/" not in file and not Path(file).suffix:
                near = nearest_names(file, shipped_models())
                hint = f"did you mean {near}?" if near else f"allowed: a file, or {', '.join(shipped_models())}"
                raise AssetError(f"no garment model {file!r}; {hint}")
            self._check(file)

    def check_body(self, *paths: str) -> None:
        """The same of a body's files, empty for none."""
        for path in paths:
            if path and Path(path) != BUNDLED_AVATAR:
                self._check(path)

    def _check(self, path: str) -> None:
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
class LoadedLayer:
    """A garment of an outfit, its index from the skin outwards, whether the outfit was known from before, and how long
    that took [s]."""

    outfit: Outfit
    index: int
    cached: bool
    seconds: float

    @property
    def layer(self) -> Layer:
        """The garment as it is worn."""
        return self.outfit.layers[self.index]


class OutfitLoader:
    """Makes outfits, from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()  # one load at a time: a second core is for draping
        self._models: OrderedDict[str, tuple[GarmentModel, str]] = OrderedDict()
        self._avatars: OrderedDict[tuple[str, ...], Avatar] = OrderedDict()
        self._outfits: OrderedDict[tuple[object, ...], Outfit] = OrderedDict()

    def load(
        self, garments: Sequence[GarmentSettings], body_mesh: str, body_rig: str, *, hide: bool
    ) -> list[LoadedLayer]:
        """Put garments on a body over each other, the innermost first, precision and normals being those of the first.

        body_mesh, body_rig: files, the mesh empty for the bundled avatar. hide: leave out what is covered. Raises
        ValueError or OSError naming what is wrong, or what cannot be worn so.
        """
        with self._lock:
            started = perf_counter()
            first, models = garments[0], [self._model(each.model) for each in garments]
            avatar, body_key = self._avatar(body_mesh, body_rig, *models[0][:2])
            worn = [
                WornGarment(model, tucked=each.tucked and len(garments) > 1, fit=checked_fit(model, each.fit))
                for each, (model, *_) in zip(garments, models)
            ]
            known_by = ((key, garment.tucked, garment.fit) for (*_, key), garment in zip(models, worn))
            key = (*body_key, *known_by, first.precision, first.normals, hide)
            known = self._outfits.get(key)
            if known is None:
                outfit = Outfit(worn, avatar, precision=first.precision or None, normals=first.normals, hide=hide)
            else:
                outfit = known.twin()
                outfit.avatar = replace(outfit.avatar, source=avatar.source)  # the same body may have another name
            _keep(self._outfits, key, outfit)
            _return_memory()
            took = perf_counter() - started
            return [LoadedLayer(outfit, k, known is not None, took) for k in range(len(worn))]

    def _model(self, garment: str) -> tuple[GarmentModel, str, str]:
        """Garment model, its rig as text, and what it is known by: its content and its fabric."""
        name, fabric = split_fabric(garment)
        source = MODELS_PATH / f"{name}.safetensors" if name in shipped_models() else Path(name)
        key = f"{_digest(source)}:{fabric}" if source.is_file() else name
        if key not in self._models:
            model = load_garment_model(garment)
            _keep(self._models, key, (model, json.dumps(model.rig.to_json())))
        return *self._models[key], key

    def _avatar(self, body_mesh: str, body_rig: str, model: GarmentModel, rig: str) -> tuple[Avatar, tuple[str, ...]]:
        """The body in the canonical pose of the model's rig, and what its files are known by: their content."""
        body = Path(body_mesh or BUNDLED_AVATAR)
        content = _digests(body, body_rig)
        key = (str(body), *content, rig)
        avatar = self._avatars.get(key) or load_avatar(body, model.rig, rig_file=body_rig or None)
        _keep(self._avatars, key, avatar)
        return avatar, content


def _return_memory() -> None:
    """Give back to the system what loading has left free: where bodies are swapped for days, glibc keeps half as much
    again in pieces."""
    if trim := getattr(LIBC, "malloc_trim", None):
        trim(0)


def _keep(kept: OrderedDict, key: object, value: object) -> None:
    """Put an entry in as the latest, and drop the oldest when there are too many."""
    kept[key] = value
    kept.move_to_end(key)
    while len(kept) > KEPT:
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
