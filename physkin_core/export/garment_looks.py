"""What garments look like in exported files: texture places and materials of a mesh of each, laid on what is worn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from physkin_core.look.surfaces import surfaces_of
from physkin_core.mesh_file import Look, read_mesh
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import closest_points

__all__ = ["garment_looks"]

LIES_ON = 0.002
"""[m] on average: so close to a garment lies a mesh of it. A finer or repaired one does, another size does not."""


def garment_looks(paths: Sequence[Path], outfit: Outfit) -> list[Look | None]:
    """The looks of an outfit's garments on the faces that are given of them; None for those without.

    paths: meshes that lie where the garments' own do, as `physkin fit-garment` writes them. Which is whose is told by
    that. Raises GarmentError for what is no readable mesh, and ValueError for a mesh of no garment, a second one of
    the same garment, one without texture places and materials, colours that are not three numbers from 0 to 1, and
    pictures that are missing or not PNG or JPEG.
    """
    looks: list[Look | None] = [None] * len(outfit.layers)
    for path in paths:
        mesh = read_mesh(path)
        if not str(mesh.look):
            raise ValueError(f"{path} has neither texture places nor materials: nothing to give a garment")
        templates = [layer.model.garment.vertices for layer in outfit.layers]
        apart = [closest_points(points, mesh.vertices, mesh.faces)[0].mean() for points in templates]
        k = int(np.argmin(apart))
        layer, name = outfit.layers[k], outfit.layers[k].name
        if apart[k] > LIES_ON:
            raise ValueError(
                f"{path} is no mesh of a garment worn: {name} is the closest, {1000 * apart[k]:.0f} mm off on average, "
                f"at most {1000 * LIES_ON:.0f} are allowed; give garment.obj as fit-garment wrote it, with its look"
            )
        if looks[k] is not None:
            raise ValueError(f"{path} is a second look for {name}; a garment has one")
        given = layer.model.garment.vertices[layer.visible]
        looks[k] = mesh.look.on((mesh.vertices, mesh.faces), given, layer.faces)
        try:  # what is wrong is told before hours of work
            surfaces_of(looks[k], name, (1.0, 1.0, 1.0), len(layer.faces))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    return looks
