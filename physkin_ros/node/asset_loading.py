"""Bodies and garment models from files to outfits: which paths are allowed, and who reads them.

A network can ask a running node for files, so those must lie below the `asset_roots`, and the node opens none of them:
a process of its own does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from physkin_core import BUNDLED_AVATAR, Outfit
from physkin_core.file_reading import LARGEST_FILE
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.loader.requests import GarmentRequest, OutfitRequest
from physkin_core.model.fabric import parse_fabric
from physkin_core.model.model_file import shipped_models, split_fabric
from physkin_core.points.splats_on_outfit import SplatsOnOutfit
from physkin_core.rig.nearest_names import nearest_names
from physkin_core.separation.limb_separator import BoundLimbs
from physkin_ros.node.settings import AvatarSettings

__all__ = ["AssetError", "AssetRoots", "LoadedWear", "OutfitLoader"]


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
            parse_fabric(fabric)
        if file and file not in shipped_models():  # shipped names win over files of the working folder
            if "/" not in file and not Path(file).suffix:
                near = nearest_names(file, shipped_models())
                hint = f"did you mean {near}?" if near else f"allowed: a file, or {', '.join(shipped_models())}"
                raise AssetError(f"no garment model {file!r}; {hint}")
            self._check(file)

    def check_body(self, path: str) -> None:
        """The same of a body, empty for the bundled one."""
        if path and Path(path) != BUNDLED_AVATAR:
            self._check(path)

    def _check(self, path: str) -> None:
        """Raises AssetError for a file elsewhere (links are followed), one that is too large, and what is no file."""
        try:
            resolved = Path(path).resolve()
        except RuntimeError as error:  # up to Python 3.12; later ones find no file there
            raise AssetError(f"{path}: its links form a loop") from error
        if not any(resolved.is_relative_to(folder) for folder in self.folders):
            allowed = ", ".join(map(str, self.folders)) or "nothing but shipped garments and the bundled avatar"
            raise AssetError(f"{path} lies outside the parameter asset_roots; allowed: {allowed}")
        if not resolved.is_file():
            raise AssetError(f"{path}: no such file")
        if (size := resolved.stat().st_size) > LARGEST_FILE:
            raise AssetError(f"{path} has {size} bytes; at most {LARGEST_FILE} are read while the node runs")


@dataclass(frozen=True)
class LoadedWear:
    """An outfit on a body, whether it was known from before, and how long that took [s]. limbs: of the body, where
    they are to be separated. splats: on the only garment, where its settings name a file of them."""

    outfit: Outfit
    cached: bool
    seconds: float
    limbs: BoundLimbs | None
    splats: SplatsOnOutfit | None


class OutfitLoader:
    """Has outfits made by a process of its own, from any thread. seconds, memory [MiB]: that one of them may take."""

    def __init__(self, *, seconds: float, memory: int) -> None:
        self._loader = AssetLoader(seconds=seconds, memory=memory)

    def load(self, avatar: AvatarSettings) -> LoadedWear:
        """What an avatar is to wear. Raises ValueError naming what is wrong, or what cannot be worn so."""
        started, first = perf_counter(), avatar.garments[0]
        request = OutfitRequest(
            tuple(GarmentRequest(each.model, each.tucked, each.fit) for each in avatar.garments),
            avatar.body_mesh or str(BUNDLED_AVATAR),
            hide_covered=avatar.hide_covered,
            limbs=avatar.separate_limbs,
            points=first.splats,
        )
        outfit, loaded = self._loader.outfit(request, precision=avatar.precision or None)
        if loaded.splats_refused:
            raise ValueError(f"parameter {first.prefix}splats: {loaded.splats_refused}")
        return LoadedWear(outfit, loaded.cached, perf_counter() - started, loaded.limbs, loaded.splats)

    def cancel(self) -> None:
        """Let what is being loaded fail at once."""
        self._loader.cancel()

    def close(self) -> None:
        """End the process."""
        self._loader.close()
