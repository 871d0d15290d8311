"""Loading, in the process that may die of it: files are read, checked, fitted and bound here.

What was loaded is known by a digest of the files that it came from, so that a body that comes back is worn at once.
"""

from __future__ import annotations

import ctypes
import hashlib
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.file_reading import LARGEST_FILE, shown
from physkin_core.loader.kept import Kept
from physkin_core.loader.requests import (
    CODEC,
    AvatarRequest,
    GarmentRequest,
    LoadedAvatar,
    LoadedOutfit,
    MotionRequest,
    OutfitRequest,
)
from physkin_core.look.face_colours import avatar_colours
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, model_source, split_fabric
from physkin_core.motion.loading import load_motion
from physkin_core.outfit.bound_outfit import BoundOutfit, bind_outfit
from physkin_core.points.point_files import PointFile, read_splat_file
from physkin_core.points.splats_on_outfit import SplatsOnOutfit, splats_on_outfit
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_core.runtime.layer import WornGarment
from physkin_core.separation.limb_separator import fit_limbs

__all__ = ["Loading"]

KEPT_BYTES = 128_000_000
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


class Loading:
    """Answers requests. Raises ValueError or OSError naming what is wrong with a file, or what cannot be worn so."""

    def __init__(self) -> None:
        self._kept = Kept(KEPT_BYTES)

    def __call__(self, request: object) -> object:
        try:
            match request:
                case OutfitRequest():
                    return self._outfit(request)
                case AvatarRequest():
                    avatar = load_avatar(request.body, load_body_model().rig, rig_file=request.rig_file or None)
                    avatar = avatar.with_accessories()
                    return LoadedAvatar(avatar, avatar_colours(avatar))
                case MotionRequest():
                    return load_motion(request.motion)
            raise TypeError(f"no request: {type(request).__name__}")
        finally:
            _return_memory()
