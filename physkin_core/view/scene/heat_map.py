"""Bands of colour for values of faces, or of a body's own colours. The page's meshes have one colour each, so a mesh a
band is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.mesh.look import few_colours

__all__ = ["SKIN_BANDS", "STRAIN_BANDS", "Bands", "Colour", "Part", "as_bytes", "own_bands", "parts_of"]

Colour = tuple[float, float, float]
"""sRGB in [0, 1]."""


def as_bytes(colour: Colour) -> tuple[int, int, int]:
    """sRGB from 0 to 255."""
    return tuple(round(255 * channel) for channel in colour)


@dataclass(frozen=True)
class Bands:
    """limits: ascending, between one band and the next. colours: sRGB in [0, 1], one more than limits; None for what
    keeps the mesh's own colour. labels: of each band, for the legend."""

    limits: tuple[float, ...]
    colours: tuple[Colour | None, ...]
    labels: tuple[str, ...]

    def band(self, values: np.ndarray) -> np.ndarray:
        """(f,) the band of each value (f,); a limit belongs to the band above it."""
        return np.searchsorted(self.limits, values, side="right")


STRAIN_BANDS = Bands(
    limits=(2.0, 5.0, 10.0, 20.0, 40.0),
    colours=(
        (0.20, 0.33, 0.60),
        (0.36, 0.63, 0.77),
        (0.72, 0.86, 0.73),
        (0.98, 0.84, 0.47),
        (0.93, 0.50, 0.26),
        (0.72, 0.13, 0.17),
    ),
    labels=("below 2 %", "2 to 5 %", "5 to 10 %", "10 to 20 %", "20 to 40 %", "above 40 %"),
)
"""Of edge strain [%]."""

SKIN_BANDS = Bands(limits=(0.5,), colours=(None, (0.85, 0.10, 0.20)), labels=("covered or bare", "shows"))
"""Of skin, 1 where it shows."""

MOST_COLOURS = 16
"""Of a body: each is a mesh of its own."""


def own_bands(
    colours: np.ndarray | None, faces: np.ndarray | slice = slice(None)
) -> tuple[Bands | None, np.ndarray | None]:
    """The colours of a body's own materials, few enough to draw, and which of them each of its faces has, as values of
    the bands. colours: (F, 3) sRGB in [0, 1] of all its faces. None, twice, where it has no materials. faces: (F,) a
    mask of those that are drawn."""
    if colours is None:
        return None, None
    palette, index = few_colours(colours[faces], MOST_COLOURS)
    limits = tuple(np.arange(1, len(palette)) - 0.5)
    return Bands(limits, tuple(map(tuple, palette.tolist())), labels=()), index.astype(float)


@dataclass(frozen=True)
class Part:
    """Some faces of a mesh. vertices: (u,) those that the faces use; faces: (f, 3) uint32 indices of these."""

    vertices: np.ndarray
    faces: np.ndarray


def parts_of(faces: np.ndarray, band: np.ndarray, *, bands: int, vertex_count: int) -> list[Part]:
    """A mesh's faces (f, 3) apart by their band (f,), one part for each of so many bands."""

    def part(chosen: np.ndarray) -> Part:
        used = np.zeros(vertex_count, dtype=bool)
        used[chosen] = True
        return Part(np.flatnonzero(used), (np.cumsum(used) - 1)[chosen].astype(np.uint32))

    return [part(faces[band == k]) for k in range(bands)]
