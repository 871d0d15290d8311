"""What cloth looks like: tiles of threads in the garment's colour, laid along the grain of what was cut flat.

A tile's shades are indices into its palette, from the darkest gap to the lightest thread. To dye cloth is to write
another palette, so that no picture is decoded. Dimensions: `f` faces of a garment, `s` shades of a tile.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from physkin_core.mesh.look import LIBRARY, Look
from physkin_core.model.fabric import split_colour
from physkin_core.model.garment_model import SkinnedGarment
from physkin_core.picture import layer_colours

__all__ = ["CLOTHS", "Cloth", "Colour", "cloth_colour", "cloth_colours", "cloth_look", "cloth_of", "dyed"]

FABRICS_PATH = Path(__file__).parents[1] / "assets" / "fabrics"
Colour = tuple[float, float, float]
"""sRGB in [0, 1]."""


@dataclass(frozen=True)
class Cloth:
    """How a fabric looks. tile: its name in the library of tiles. colour: its usual one, a name; None for that of the
    layer. dark: how much of the colour's light is left in the darkest gap; white: how much of the lightest thread is
    not dyed; dyed_at: the shade in [0, 1] that has the colour itself. thickness: [m] of a hem's edge."""

    tile: str
    colour: str | None = None
    dark: float = 0.35
    white: float = 0.15
    dyed_at: float = 0.6
    thickness: float = 0.0015


CLOTHS = {
    "jersey": Cloth("jersey"),
    "rib": Cloth("rib", thickness=0.0025),
    "cotton": Cloth("poplin", white=0.2),
    "silk": Cloth("satin", dark=0.6, white=0.1, thickness=0.0008),
    "wool": Cloth("wool", "grey", dark=0.25, white=0.3, dyed_at=0.5, thickness=0.0025),
    "denim": Cloth("denim", "indigo", dark=0.2, white=0.75, dyed_at=0.5, thickness=0.002),
    "leather": Cloth("leather", "brown", white=0.05, thickness=0.002),
}
"""By the name of the fabric."""


def cloth_of(garment: SkinnedGarment) -> Cloth:
    """What a garment is made of; jersey where no fabric was named."""
    return CLOTHS.get(split_colour(garment.fabric)[0], CLOTHS["jersey"])


def cloth_colour(fabric: str, usual: Colour) -> Colour:
    """The colour of what was made of a fabric, as `made_of` takes it: the one named, the fabric's own, or the usual."""
    name, colour = split_colour(fabric)
    own = CLOTHS[name].colour if name in CLOTHS else None
    if colour is None and own is not None:
        return split_colour(own)[1] or usual
    return usual if colour is None else colour


def cloth_colours(garments: Sequence[SkinnedGarment]) -> list[Colour]:
    """Of garments worn over each other, from the skin outwards."""
    usual = layer_colours(len(garments))
    return [cloth_colour(garment.fabric, colour) for garment, colour in zip(garments, usual)]


def cloth_look(garment: SkinnedGarment, faces: np.ndarray, colour: Colour) -> Look | None:
    """The look of some faces, a mask (f,), of a garment in its fabric and in a colour; None for a garment that was not
    cut flat: nobody knows where its grain runs."""
    mesh = garment.garment
    if mesh.panel_places is None or mesh.panel_faces is None:
        return None
    uv = mesh.panel_places[mesh.panel_faces[faces]]
    cloth = cloth_of(garment)
    files = _cloth_files(cloth, colour)
    return Look(uv, np.zeros(len(uv), dtype=int), np.full(len(uv), -1), (cloth.tile,), (), files)


@lru_cache(maxsize=16)
def _cloth_files(cloth: Cloth, colour: Colour) -> dict[str, bytes]:
    """A material library of one cloth, and its pictures."""
    library = (FABRICS_PATH / LIBRARY).read_text()
    own = re.search(rf"newmtl {cloth.tile}\n.*?(?=newmtl|\Z)", library, re.DOTALL)
    tile, normals = f"{cloth.tile}.png", f"{cloth.tile}_normal.png"
    return {
        LIBRARY: own[0].encode(),
        tile: dyed((FABRICS_PATH / tile).read_bytes(), cloth, colour),
        normals: (FABRICS_PATH / normals).read_bytes(),
    }


def dyed(picture: bytes, cloth: Cloth, colour: Colour) -> bytes:
    """A tile, a PNG with a palette, in a colour."""
    at = picture.index(b"PLTE") - 4
    (length,) = struct.unpack(">I", picture[at : at + 4])
    shade = np.linspace(0, 1, length // 3)
    linear = np.array(colour) ** 2.2
    ramp = np.stack([cloth.dark * linear, linear, linear + cloth.white * (1 - linear)])
    levels = np.stack([np.interp(shade, [0, cloth.dyed_at, 1], channel) for channel in ramp.T], axis=1)
    chunk = b"PLTE" + np.round(255 * levels ** (1 / 2.2)).astype(np.uint8).tobytes()
    return picture[: at + 4] + chunk + struct.pack(">I", zlib.crc32(chunk)) + picture[at + 12 + length :]
