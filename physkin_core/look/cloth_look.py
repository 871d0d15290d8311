"""What cloth looks like: tiles of threads in the garment's colour, laid along the grain of what was cut flat.

A tile's shades are indices into its palette, from the darkest gap to the lightest thread. To dye cloth is to write
another palette, so that no picture is decoded. Dimensions: `f` faces of a garment, `s` shades of a tile.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from physkin_core.mesh.finishing import Finish, stitching, turned_up
from physkin_core.mesh.look import LIBRARY, Look
from physkin_core.mesh.surfaces import Picture, Surface, surfaces_of
from physkin_core.mesh.tiles_seen import colours_seen
from physkin_core.model.fabric import COLOURS, split_colour
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import SkinnedGarment
from physkin_core.pictures.picture import layer_colours

__all__ = [
    "CLOTHS",
    "Cloth",
    "Colour",
    "cloth_colour",
    "cloth_colours",
    "cloth_look",
    "cloth_of",
    "dyed",
    "seen_from_afar",
]

FABRICS_PATH = Path(__file__).parents[1] / "assets" / "fabrics"
SHADES, SHADOWS, WORN = 32, 12, 4
"""Of palettes; of that of stitches the first are shadows on the cloth, then come worn cloth and the thread."""
STITCH_REPEATS = 1 / 0.0032, 1 / 0.0512
"""Of a picture of stitches in a metre along the edge and away from it."""
PALE = 0.6
"""Linear; what worn cloth tends to."""
LIFT = 0.0003
"""[m] Stitches lie so far above the cloth."""
HEM_DEPTH = 0.026
"""[m] Hems are turned up so far, or as far as whole faces go."""
Colour = tuple[float, float, float]
"""sRGB in [0, 1]."""


@dataclass(frozen=True)
class Cloth:
    """How a fabric looks. tile: its name in the library of tiles. colour: its usual one, a name; None for that of the
    layer. dark: how much of the colour's light is left in the darkest gap; white: how much of the lightest thread is
    not dyed; dyed_at: the shade in [0, 1] that has the colour itself. thickness: [m] of a hem's edge."""

    tile: str
    colour: str | None = None
    hem: str = "twin_hem"
    felled: str = "seam"
    thread: str | None = None
    dark: float = 0.35
    white: float = 0.15
    dyed_at: float = 0.6
    thickness: float = 0.0015


CLOTHS = {
    "jersey": Cloth("jersey"),
    "rib": Cloth("rib", thickness=0.0025),
    "cotton": Cloth("poplin", hem="hem", white=0.2, thickness=0.001),
    "silk": Cloth("satin", hem="hem", dark=0.6, white=0.1, thickness=0.0008),
    "wool": Cloth("wool", "grey", hem="hem", dark=0.25, white=0.3, dyed_at=0.5, thickness=0.0025),
    "denim": Cloth(
        "denim", "indigo", "thick_hem", "felled", "ochre", dark=0.2, white=0.75, dyed_at=0.5, thickness=0.002
    ),
    "leather": Cloth("leather", "brown", "thick_hem", "felled", white=0.05, thickness=0.002),
}
"""By the name of the fabric."""


def cloth_of(fabric: str) -> Cloth:
    """How a fabric looks, as `with_fabric` takes it; as jersey where it has no name."""
    return CLOTHS.get(split_colour(fabric)[0], CLOTHS["jersey"])


def cloth_colour(fabric: str, usual: Colour) -> Colour:
    """The colour that `fabric`, as `with_fabric` takes it, names; else the fabric's own; else the usual one."""
    name, colour = split_colour(fabric)
    own = CLOTHS[name].colour if name in CLOTHS else None
    if colour is None and own is not None:
        return _named(own)
    return usual if colour is None else colour


def seen_from_afar(fabric: str, colour: Colour) -> Colour:
    """What cloth of a fabric in a colour looks like where no threads are drawn. Raises whatever pillow does where there
    is none."""
    name, _ = split_colour(fabric)
    if name not in CLOTHS:
        return colour
    tile = f"{CLOTHS[name].tile}.png"
    picture = Picture(tile, _cloth_files(CLOTHS[name], colour)[tile], "image/png")
    red, green, blue = colours_seen(picture, (1.0, 1.0), np.inf)[0, 0, :3] ** (1 / 2.2)
    return float(red), float(green), float(blue)


def _named(colour: str) -> Colour:
    red, green, blue = COLOURS[colour]
    return red / 255, green / 255, blue / 255


def cloth_colours(garments: Sequence[SkinnedGarment]) -> list[Colour]:
    """Of garments worn over each other, from the skin outwards."""
    usual = layer_colours(len(garments))
    return [cloth_colour(garment.fabric, colour) for garment, colour in zip(garments, usual)]


def cloth_look(mesh: Garment, fabric: str, faces: np.ndarray, colour: Colour) -> Look | None:
    """The look of some faces, a mask (f,), of a garment made of a fabric, as `with_fabric` takes it, in a colour, and
    finishes on these faces' own vertices; None for a garment that was not cut flat: nobody knows where its grain
    runs."""
    if mesh.panel_places is None or mesh.panel_faces is None:
        return None
    uv = mesh.panel_places[mesh.panel_faces]
    cloth = cloth_of(fabric)
    files = _cloth_files(cloth, colour)
    look = Look(uv, np.zeros(len(uv), dtype=int), np.full(len(uv), -1), (cloth.tile,), (), files)
    (surface,) = surfaces_of(look, cloth.tile, (1.0, 1.0, 1.0), len(uv))
    finishes = [
        (finish, surface if name is None else _stitch_surface(name, cloth, colour))
        for name, finish in _finishes(mesh, cloth)
    ]
    return replace(look, finishes=tuple(finishes)).of_faces(faces, mesh.faces)


@lru_cache(maxsize=16)  # a film asks in every frame
def _finishes(mesh: Garment, cloth: Cloth) -> list[tuple[str | None, Finish]]:
    """Of a whole garment, with the pictures of those that are stitches."""
    lines = stitching(mesh, LIFT)
    hem = turned_up(mesh, HEM_DEPTH, cloth.thickness)
    return [(None, hem), ("seam", lines["seams"]), (cloth.felled, lines["felled"]), (cloth.hem, lines["hems"])]


@lru_cache(maxsize=64)
def _stitch_surface(name: str, cloth: Cloth, colour: Colour) -> Surface:
    thread = cloth_colour(cloth.thread or "", colour)
    shadow, light = 0.12 * np.array(colour) ** 2.2, np.array(thread) ** 2.2
    light = light + cloth.white / 2 * (1 - light) if cloth.thread is None else light  # shines as cloth does
    pale = (1 - cloth.white) * np.array(colour) ** 2.2 + cloth.white * PALE
    shades = np.linspace(0.45, 1.15, SHADES - SHADOWS - WORN)[:, None]
    ramp = np.concatenate([np.tile(shadow, (SHADOWS, 1)), np.tile(pale, (WORN, 1)), shades * light])
    content = _with_palette((FABRICS_PATH / f"{name}.png").read_bytes(), ramp)
    picture = Picture(f"{name}.png", content, "image/png")
    return Surface(name, (1.0, 1.0, 1.0), np.empty(0, dtype=int), picture, STITCH_REPEATS, blended=True)


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
    shade = np.linspace(0, 1, SHADES)
    linear = np.array(colour) ** 2.2
    ramp = np.stack([cloth.dark * linear, linear, linear + cloth.white * (1 - linear)])
    levels = np.stack([np.interp(shade, [0, cloth.dyed_at, 1], channel) for channel in ramp.T], axis=1)
    return _with_palette(picture, levels)


def _with_palette(picture: bytes, levels: np.ndarray) -> bytes:
    """A PNG that has one, with another one: linear RGB (s, 3)."""
    at = picture.index(b"PLTE") - 4
    (length,) = struct.unpack(">I", picture[at : at + 4])
    chunk = b"PLTE" + np.round(255 * np.clip(levels, 0, 1) ** (1 / 2.2)).astype(np.uint8).tobytes()
    return picture[: at + 4] + chunk + struct.pack(">I", zlib.crc32(chunk)) + picture[at + 12 + length :]
