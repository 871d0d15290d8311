"""Loading, in the process that may die of it: files are read, checked, fitted and bound here.

What was loaded is known by a digest of the files that it came from, so that a body that comes back is worn at once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.file_reading import digest_of
from physkin_core.loader.kept import Kept
from physkin_core.loader.memory import return_memory
from physkin_core.loader.requests import (
    AvatarRequest,
    LoadedAvatar,
    LoadedOutfit,
    MotionRequest,
    OutfitRequest,
)
from physkin_core.look.avatar_look import avatar_colours
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, model_content, split_fabric
from physkin_core.motion.loading import load_motion
from physkin_core.outfit.bound_outfit import BoundOutfit, bind_outfit
from physkin_core.points.point_files import read_splat_file
from physkin_core.points.splats_on_outfit import SplatsOnOutfit, splats_on_outfit
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_core.runtime.layer import WornGarment
from physkin_core.separation.limb_separator import BoundLimbs, fit_limbs
from physkin_core.worker.shared_arrays import array_bytes

__all__ = ["KEPT_BYTES", "Loading"]

KEPT_BYTES = 144_000_000
"""Of models, avatars and outfits that were loaded last."""


class Loading:
    """Answers the requests of `physkin_core.loader.requests`. Raises ValueError or OSError naming what is wrong with a
    file, or what cannot be worn so."""

    def __init__(self) -> None:
        self._kept = Kept(KEPT_BYTES)

    def __call__(self, request: object) -> object:
        try:
            match request:
                case OutfitRequest():
                    return self._outfit(request)
                case AvatarRequest():
                    avatar = load_avatar(request.body, load_body_model().rig, **_skeleton_files(request))
                    avatar = replace(avatar, clothes=()).with_accessories()
                    return LoadedAvatar(avatar, avatar_colours(avatar))
                case MotionRequest():
                    return load_motion(request.motion, bones=request.bones, source_rate_hz=request.source_rate_hz)
            raise TypeError(f"{type(request).__name__} is no request")
        finally:
            return_memory()

    def _outfit(self, request: OutfitRequest) -> LoadedOutfit:
        """What a request for an outfit asks for."""
        models = [self._model(garment.model) for garment in request.garments]
        worn = [
            WornGarment(model, tucked=garment.tucked, fit=checked_fit(model, garment.fit))
            for (model, _), garment in zip(models, request.garments)
        ]
        body = Path(request.body)
        with _unchanged(_files_of(body, **_skeleton_files(request))) as body_digest:
            with_fabric = [(digest, garment.tucked, garment.fit) for (_, digest), garment in zip(models, worn)]
            key = digest_of((), body_digest, with_fabric, request.hide_covered, request.own_clothes)
            bound = self._kept.get(key)
            if cached := bound is not None:
                bound = replace(bound, avatar=replace(bound.avatar, source=str(body)))  # maybe it has another name
            else:
                avatar = self._avatar(request, body_digest, models[0][0])
                bound = bind_outfit(worn, avatar, hide_covered=request.hide_covered, own_clothes=request.own_clothes)
                bound = bound.without_networks()
        if not cached:
            self._keep(key, bound)
        limbs, no_limbs = self._limbs(key, bound) if request.limbs else (None, "")
        splats, refused = _splats(request.points, bound)
        return LoadedOutfit(
            key=key,
            bound=None if key in request.known else bound,
            cached=cached,
            limbs=limbs,
            limbs_refused=no_limbs,
            splats=splats,
            splats_refused=refused,
            colours=avatar_colours(bound.avatar.with_accessories()) if request.colours else None,
        )

    def _model(self, name: str) -> tuple[GarmentModel, str]:
        """A garment model, and what it is known by: its content and its fabric."""
        content = model_content(name)
        key = f"{hashlib.sha256(content).hexdigest()}:{split_fabric(name)[1]}"
        model = self._kept.get(key)
        if model is None:
            model = load_garment_model(name, content=content)
            self._keep(key, model)
        return model, key

    def _avatar(self, request: OutfitRequest, digest: str, model: GarmentModel) -> Avatar:
        """The body in the canonical pose of the model's rig. digest: of its files."""
        key = "avatar", digest, repr(model.rig.to_json())
        avatar = self._kept.get(key)
        if avatar is None:
            avatar = load_avatar(Path(request.body), model.rig, **_skeleton_files(request))
            self._keep(key, avatar)
        return replace(avatar, source=request.body)

    def _limbs(self, outfit: str, bound: BoundOutfit) -> tuple[BoundLimbs | None, str]:
        """Limbs that can be separated, or why there are none."""
        key = "limbs", outfit
        limbs = self._kept.get(key)
        if limbs is None:
            try:
                limbs = fit_limbs(bound.layers[0].model.rig, bound.avatar)
            except ValueError as error:
                return None, str(error)
            self._keep(key, limbs)
        return limbs, ""

    def _keep(self, key: Hashable, value: object) -> None:
        self._kept.keep(key, value, array_bytes(value))


def _splats(points: str, bound: BoundOutfit) -> tuple[SplatsOnOutfit | None, str]:
    """Splats of a file on an outfit; where they cannot be used, the reason. The outfit can be worn without them."""
    if not points:
        return None, ""
    try:
        return splats_on_outfit(points, read_splat_file(points), bound.layers), ""
    except (ValueError, OSError) as error:
        return None, str(error)


def _skeleton_files(request: OutfitRequest | AvatarRequest) -> dict[str, str | None]:
    """As of `load_avatar`."""
    return {"rig_file": request.rig_file or None, "bones": request.bones or None}


def _files_of(body: Path, rig_file: str | None, bones: str | None) -> list[Path]:
    """Everything that a body is read from: the mesh, its rig and bones file, and the buffers beside a .gltf."""
    files = [body, Path(rig_file or body.with_suffix(".rig.json")), Path(bones or body.with_suffix(".bones.json"))]
    if body.suffix.lower() == ".gltf":
        files += sorted(body.parent.glob("*.bin"))
    return files


@contextmanager
def _unchanged(files: Sequence[Path]) -> Iterator[str]:
    """Gives a digest of files, of those that are there, by content and kind. Raises ValueError at the end where it is
    another one by then: what was read may not be what it is of."""
    before = digest_of(files)
    yield before
    if digest_of(files) != before:
        raise ValueError(f"{files[0]} changed while it was read; load it again")
