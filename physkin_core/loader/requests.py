"""What can be asked of the process that loads, and its answers.

Dimensions: `F` faces of a body, `V` its vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.outfit.bound_outfit import BoundOutfit
from physkin_core.outfit.coverage import OwnClothes
from physkin_core.points.splats_on_outfit import SplatsOnOutfit
from physkin_core.separation.limb_separator import BoundLimbs

__all__ = ["AvatarRequest", "GarmentRequest", "LoadedAvatar", "LoadedOutfit", "MotionRequest", "OutfitRequest"]


@dataclass(frozen=True)
class GarmentRequest:
    """A garment model, as `load_garment_model` takes it, and how it is to be worn: as of `WornGarment`."""

    model: str
    tucked: bool = False
    fit: float | None = None


@dataclass(frozen=True)
class OutfitRequest:
    """garments: from the skin outwards, to be put on the body of a file; rig_file, bones: empty for none. hide_covered,
    own_clothes: as of `Outfit`. limbs: fit a collision shape, too. points: file of splats on one of the garments, empty
    for none. colours: of the body's own materials, too. known: keys of outfits that need not be sent again.
    """

    garments: tuple[GarmentRequest, ...]
    body: str
    rig_file: str = ""
    bones: str = ""
    hide_covered: bool = True
    own_clothes: OwnClothes = "replace"
    limbs: bool = False
    points: str = ""
    colours: bool = False
    known: tuple[str, ...] = ()


@dataclass(frozen=True)
class LoadedOutfit:
    """key: the same for the same content of files, worn alike. bound: without networks, None where the key is known.
    cached: whether it was bound before. limbs, splats, colours: where they were asked for; splats are None, too, where
    they cannot be used, for which `splats_refused` is the reason.
    """

    key: str
    bound: BoundOutfit | None
    cached: bool
    limbs: BoundLimbs | None = None
    splats: SplatsOnOutfit | None = None
    splats_refused: str = ""
    colours: np.ndarray | None = None


@dataclass(frozen=True)
class AvatarRequest:
    """The body of a file, bound to the body model's rig; rig_file, bones: empty for none."""

    body: str
    rig_file: str = ""
    bones: str = ""


@dataclass(frozen=True)
class LoadedAvatar:
    """avatar: with its accessories, without its clothes. colours: (F, 3) sRGB in [0, 1] by its own materials; None
    where it has none."""

    avatar: Avatar
    colours: np.ndarray | None


@dataclass(frozen=True)
class MotionRequest:
    """A motion, as `load_motion` takes it."""

    motion: str
    bones: str | None = None
    source_rate_hz: float | None = None
