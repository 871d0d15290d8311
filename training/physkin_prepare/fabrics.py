"""Make what fabrics look like, CC0: of each a small tile of its shades and one of its normals, and the library of both.

`python -m physkin_prepare.fabrics [--output physkin_core/assets/fabrics]`

A fabric is threads: where each lies is computed for every pixel, how high it is there, and how light. Shades are
indices into a palette, from the darkest gap to the lightest thread, so that whoever dyes the cloth changes the palette
alone. Everything is periodic. x runs across the grain (weft), y along it (warp), upwards.
Letters: `P` pixels a side of a tile.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from physkin_core.mesh.look import LIBRARY

__all__ = ["FABRIC_TILES", "FabricTile", "main"]

P = 256
SHADES = 32
"""Of the palette."""
NORMAL_STEP = 6
"""Normals are stored in steps of this: coarser ones compress better and look no different."""
FILTER = 1.0
"""[pixels] Tiles are softened by this."""
BROAD, LEFT = 7.0, 0.15
"""[pixels] What is lighter or darker over more than this would be seen again in every tile: so much of it is left."""

Y, X = np.mgrid[0:P, 0:P] / P


@dataclass(frozen=True)
class FabricTile:
    """make: of a random generator, height [m] and shade in [0, 1] of the tile, (P, P), first rows at the bottom. size:
    of the tile [m]. roughness, sheen: as glTF has them."""

    make: Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]
    size: float
    roughness: float
    sheen: float = 0.0


def _noise(rng: np.random.Generator, *sigma: float) -> np.ndarray:
    """(P, P) periodic, about 0 with a standard deviation of 1, smooth over sigma pixels along y and x."""
    smooth = gaussian_filter(rng.standard_normal((P, P)), sigma, mode="wrap")
    return smooth / smooth.std()


def _wrapped(image: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """An image looked up at fractional pixels."""
    return map_coordinates(image, [y % P, x % P], order=1, mode="grid-wrap")


def _woven(
    rng: np.random.Generator, draft: np.ndarray, threads: int, *, undulation: float, unevenness: float, fibre: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height in thread radii, brightness about 0, and where warp lies on top. draft: (h, w) bool, where it does.
    threads: of warp and of weft in a tile. undulation: how far they go up and down. unevenness: of their thickness and
    shade. fibre: how much of the fibres is seen."""
    wander = _noise(rng, 24, 3), _noise(rng, 3, 24)
    x, y = X * threads + unevenness * wander[0], Y * threads + unevenness * wander[1]
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)

    def over(along: np.ndarray, lane: np.ndarray, lifted: np.ndarray) -> np.ndarray:
        """How high the thread of a lane is, smoothly from one crossing to the next. lifted: (along, lane) bool."""
        k, t = np.floor(along - 0.5).astype(int), (along - 0.5) % 1
        t = (1 - np.cos(np.pi * np.clip(1.6 * t - 0.3, 0, 1))) / 2
        here, next_one = (lifted[at % len(lifted), lane % lifted.shape[1]] for at in (k, k + 1))
        return 2 * (here * (1 - t) + next_one * t) - 1

    shade_of = rng.normal(0, unevenness, (2, threads))
    warp_shape, weft_shape = (np.sqrt(np.maximum(1 - (1.9 * (z % 1 - 0.5)) ** 2, 0.02)) for z in (x, y))
    warp = undulation * over(y, column, draft) + warp_shape
    weft = -undulation * over(x, row, draft.T) + weft_shape
    on_top = warp > weft
    twist = np.where(on_top, np.sin(2 * np.pi * (2.5 * x + 0.8 * y)), np.sin(2 * np.pi * (2.5 * y + 0.8 * x)))
    bright = np.where(on_top, shade_of[0][column % threads], shade_of[1][row % threads])
    bright = bright + fibre * (0.5 * twist + np.where(on_top, _noise(rng, 3, 0.7), _noise(rng, 0.7, 3)))
    return np.maximum(warp, weft), bright, on_top


def _gaps(height: np.ndarray, depth: float = 1.6) -> np.ndarray:
    """From 0 in gaps between threads to 1 on top of them."""
    low, high = np.percentile(height, [2, 95])
    return np.clip((height - low) / (high - low), 0, 1) ** (1 / depth)


def _denim(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Three up, one down, from lower left to upper right; warp is dyed, weft is not."""
    i, j = np.mgrid[0:4, 0:4]
    height, bright, on_top = _woven(rng, (j - i) % 4 != 0, 32, undulation=0.55, unevenness=0.16, fibre=0.10)
    dyed = 0.16 + 0.36 * _gaps(height) + 0.55 * bright + 0.08 * _noise(rng, 5, 2)
    plain = 0.46 + 0.36 * _gaps(height) + 0.3 * bright
    return height * 0.13e-3, np.where(on_top, np.clip(dyed, 0, 0.62), plain)


def _poplin(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Plain weave of fine even threads."""
    height, bright, _ = _woven(rng, np.eye(2, dtype=bool), 32, undulation=0.5, unevenness=0.06, fibre=0.05)
    return height * 0.06e-3, 0.44 + 0.24 * _gaps(height) + 0.7 * bright


def _wool(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two up, two down, of threads of mixed fibres, under a nap that hides half of it."""
    i, j = np.mgrid[0:4, 0:4]
    height, bright, _ = _woven(rng, (j - i) % 4 < 2, 20, undulation=0.5, unevenness=0.2, fibre=0.16)
    angle = _noise(rng, 9, 9)
    hairs = sum(_wrapped(_noise(rng, 0.7, 7), P * (Y + s * X) + 6 * angle, P * X) for s in (-1, 0, 1))
    hairs /= hairs.std()
    height = 0.8 * gaussian_filter(height, 1.2, mode="wrap") + 0.08 * hairs
    return height * 0.16e-3, 0.30 + 0.34 * _gaps(height) + 0.4 * bright + 0.055 * hairs


def _satin(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Eight-shaft satin: warp floats over seven, so that hardly a crossing is seen."""
    draft = np.ones((8, 8), dtype=bool)
    draft[np.arange(8), 3 * np.arange(8) % 8] = False
    height, bright, _ = _woven(rng, draft, 64, undulation=0.12, unevenness=0.05, fibre=0.04)
    height = gaussian_filter(height, (2.0, 0.7), mode="wrap")
    return height * 0.03e-3, 0.62 + 0.12 * _gaps(height) + 0.5 * bright


def _knit(rng: np.random.Generator, wales: int, courses: int) -> tuple[np.ndarray, np.ndarray]:
    """Height in yarn radii and brightness of the face of a jersey: columns (wales) of V-shaped stitches."""
    x = X * wales + 0.05 * _noise(rng, 14, 6)
    y = Y * courses + 0.06 * _noise(rng, 6, 14)
    across = x % 1 - 0.5
    leg = 2 * np.abs(across)  # 0 in the middle of a wale, 1 between two
    along = y - 0.75 * leg**1.3
    profile = np.sqrt(np.maximum(1 - (1.75 * (along % 1 - 0.5)) ** 2, 0.0))
    arch = np.sin(np.pi * np.clip(0.10 + 0.86 * leg, 0, 1)) ** 0.7
    height = profile * (0.35 + 0.65 * arch) + 0.9 * arch
    stitch = rng.normal(0, 1, (courses, wales))[np.floor(along).astype(int) % courses, np.floor(x).astype(int) % wales]
    course = rng.normal(0, 1, courses)[np.floor(along).astype(int) % courses]
    fibres = np.sin(2 * np.pi * (3 * (along % 1) + np.sign(across) * 4 * leg))
    return height, 0.025 * stitch + 0.03 * course + 0.035 * fibres + 0.03 * _noise(rng, 1, 1)


def _jersey(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    height, bright = _knit(rng, 16, 20)
    return height * 0.12e-3, 0.28 + 0.5 * _gaps(height, 1.3) + bright


def _rib(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two wales of face, two of back, which lie deep between them."""
    stitches, bright = _knit(rng, 16, 20)
    swell = 0.5 - 0.5 * np.cos(2 * np.pi * np.clip(1.3 * (4 * X % 1) - 0.15, 0, 1))
    height = stitches * (0.3 + 0.7 * swell) + 3.0 * swell
    return height * 0.13e-3, 0.22 + 0.18 * _gaps(stitches, 1.3) + 0.28 * swell + bright


def _leather(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pebbles: cells about scattered points, with creases between them."""
    grid = (np.stack(np.mgrid[0:20, 0:20], axis=-1) + 0.5 + rng.uniform(-0.42, 0.42, (20, 20, 2))) / 20
    bent = np.stack([Y + 0.006 * _noise(rng, 5, 5), X + 0.006 * _noise(rng, 5, 5)], axis=-1) % 1
    near, _ = cKDTree(grid.reshape(-1, 2) % 1, boxsize=1).query(bent.reshape(-1, 2), k=2)
    pebble = np.clip((near[:, 1] - near[:, 0]).reshape(P, P) * 45, 0, 1)
    pebble = gaussian_filter(np.sin(np.pi / 2 * pebble), 1.2, mode="wrap")
    height = pebble + 0.10 * _noise(rng, 5, 5) + 0.02 * _noise(rng, 1, 1)
    return height * 0.10e-3, 0.32 + 0.26 * pebble + 0.02 * _noise(rng, 4, 4)


FABRIC_TILES = {
    "poplin": FabricTile(_poplin, 0.0112, 0.85, 0.1),
    "denim": FabricTile(_denim, 0.0176, 0.9),
    "jersey": FabricTile(_jersey, 0.0160, 0.9, 0.2),
    "rib": FabricTile(_rib, 0.0176, 0.9, 0.2),
    "wool": FabricTile(_wool, 0.0200, 1.0, 0.5),
    "satin": FabricTile(_satin, 0.0160, 0.42, 0.2),
    "leather": FabricTile(_leather, 0.0320, 0.45),
}
"""What is shipped. Threads are some tenths of a millimetre thick, as those of the cloth are."""


STITCHES = {
    "seam": (True, (), 0.0),
    "felled": (True, (0.0022, 0.0082), 0.011),
    "hem": (False, (0.019,), 0.0),
    "twin_hem": (False, (0.0185, 0.0235), 0.0),
    "thick_hem": (False, (0.0125,), 0.0035),
}
"""Of a line of stitches whether there is a seam at the edge, how far from that the threads are, and up to where cloth
is worn pale, as it is where it lies double and thick [m]."""
STITCH, STITCH_PIXEL = (0.0032, 0.0512), 1e-4
"""[m] How long a stitch is, how far from the edge pictures of stitches reach, and a pixel of these."""
THREAD_RADIUS = 0.00042
SHADOWS, WORN = 12, 4
"""Of a stitch's palette: first so many shadows, then so many of worn cloth, both ever less transparent, then the
thread."""


def _stitch_file(seam: bool, threads: Sequence[float], worn: float) -> bytes:
    """A PNG of a line of stitches: the edge below, transparent where there is only cloth."""
    width, height = (round(length / STITCH_PIXEL) for length in STITCH)
    y, x = (np.mgrid[0:height, 0:width] + 0.5) * STITCH_PIXEL
    shadow, thread = np.zeros((height, width)), np.zeros((height, width))
    if seam:
        shadow = np.maximum(shadow, 0.8 * np.exp(-((y / 0.0006) ** 2)))
    for place in threads:
        ends = np.maximum(np.abs(x - STITCH[0] / 2) - 0.0009, 0)
        away = np.hypot(ends, y - place) / THREAD_RADIUS
        thread = np.maximum(thread, np.sqrt(np.maximum(1 - away**2, 0)))
        shadow = np.maximum(shadow, 0.75 * np.exp(-((np.maximum(away - 1, 0) / 0.9) ** 2)))
        shadow = np.maximum(shadow, 0.35 * np.exp(-(((y - place) / 0.0009) ** 2)))
    twist = 0.12 * np.sin(2 * np.pi * (x + 0.7 * y) / 0.0004)
    shade = np.clip(0.25 + 0.65 * thread + twist, 0, 0.99)
    pale = np.exp(-((y / max(worn, 1e-6)) ** 4))
    index = np.where(pale * WORN > 0.5, SHADOWS + 0.99 * WORN * pale, 0)
    index = np.where(shadow * SHADOWS > np.where(index, 3, 0), 0.99 * SHADOWS * shadow, index)
    index = np.where(thread > 0.25, SHADOWS + WORN + (SHADES - SHADOWS - WORN) * shade, index).astype(np.uint8)
    image = Image.fromarray(index[::-1], mode="P")
    image.putpalette(bytes(3 * SHADES))
    opacity = np.concatenate([0.7 * np.arange(SHADOWS) / (SHADOWS - 1), 0.2 * np.arange(1, WORN + 1) / WORN])
    opacity = np.pad(opacity, (0, SHADES - len(opacity)), constant_values=1)
    return _png(image, transparency=np.round(255 * opacity).astype(np.uint8).tobytes())


def _shade_file(shade: np.ndarray) -> bytes:
    """A PNG with a grey palette."""
    shade = shade - (1 - LEFT) * (gaussian_filter(shade, BROAD, mode="wrap") - shade.mean())
    index = np.clip(gaussian_filter(shade, FILTER / 2, mode="wrap") * SHADES, 0, SHADES - 1).astype(np.uint8)
    image = Image.fromarray(index[::-1], mode="P")
    image.putpalette(np.repeat(np.linspace(0, 255, SHADES).round().astype(np.uint8), 3).tobytes())
    return _png(image)


def _normal_file(height: np.ndarray, size: float) -> bytes:
    """A PNG of tangent-space normals: red across the grain, green along it, blue out of the cloth."""
    smooth = gaussian_filter(height, FILTER, mode="wrap") * P / size
    slopes = [(np.roll(smooth, -1, axis) - np.roll(smooth, 1, axis)) / 2 for axis in (1, 0)]
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(smooth)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    stepped = np.round(normals * 127 / NORMAL_STEP) * NORMAL_STEP + 128
    return _png(Image.fromarray(stepped[::-1].clip(0, 255).astype(np.uint8)))


def _png(image: Image.Image, **options: bytes) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True, **options)
    return buffer.getvalue()


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line: write tiles and library."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--output", type=Path, default=Path("physkin_core/assets/fabrics"), help="folder for them")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    library = []
    for name, tile in FABRIC_TILES.items():
        height, shade = tile.make(np.random.default_rng(sum(name.encode())))
        for suffix, content in (("", _shade_file(shade)), ("_normal", _normal_file(height, tile.size))):
            (options.output / f"{name}{suffix}.png").write_bytes(content)
            print(f"{name}{suffix}.png: {len(content) / 1e3:.1f} kB")
        repeats = f"-s {1 / tile.size:.6g} {1 / tile.size:.6g} 1"
        library += [f"newmtl {name}", "Kd 1 1 1", f"Pr {tile.roughness:g}", f"Ps {tile.sheen:g}"]
        library += [f"map_Kd {repeats} {name}.png", f"norm {repeats} {name}_normal.png", ""]
    for name, line in STITCHES.items():
        (options.output / f"{name}.png").write_bytes(_stitch_file(*line))
    (options.output / LIBRARY).write_text("\n".join(library))


if __name__ == "__main__":
    main()
