"""A trained garment on other meshes of itself, without retraining (paper: Garment Remeshing).

Needs gpytoolbox (extra `[data]`). Dimensions: `n` garment vertices. Metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.runtime.binding import bind_points

__all__ = ["EDGE_LENGTHS", "carried_to", "cropped", "other_meshes", "remeshed"]

EDGE_LENGTHS = (0.030, 0.015, 0.010, 0.007)
CROP = 0.3
"""Share of the garment's height cut off its lower end."""


def remeshed(garment: Garment, edge_length: float) -> Garment:
    """The garment as even triangles of about `edge_length` [m]."""
    from physkin_training.prepare.garment_construction import remesh

    return Garment(*remesh(garment.vertices, garment.faces, edge_length))


def cropped(garment: Garment, share: float = CROP) -> Garment:
    """The garment without the lowest `share` of its height, with triangles as large as before.

    Raises ValueError when share is not between 0 and 1, or nothing remains.
    """
    from physkin_training.prepare.garment_construction import Shell, clip, largest_component, remesh

    if not 0 < share < 1:
        raise ValueError(f"share to crop must be between 0 and 1, got {share}")
    height = garment.vertices[:, 2]
    cut = height.min() + share * np.ptp(height)
    shell = Shell(garment.vertices, garment.faces, np.zeros((len(garment.vertices), 2)))
    shell = largest_component(clip(shell, height - cut))
    return Garment(*remesh(shell.vertices, shell.faces, float(garment.edge_lengths.mean())))


def other_meshes(garment: Garment) -> Iterator[tuple[str, Garment]]:
    """Name and mesh of the garment as it is, of all `EDGE_LENGTHS`, and cropped."""
    yield "as trained", garment
    for length in EDGE_LENGTHS:
        yield f"{1000 * length:g} mm", remeshed(garment, length)
    yield "cropped", cropped(garment)


def carried_to(model: GarmentModel, garment: Garment) -> GarmentModel:
    """The model with another mesh of its garment: the same networks and garment nodes, skinning weights and rest
    normals from the closest points of the trained mesh. Raises ValueError as `bind_points` does."""
    if garment is model.garment:
        return model
    bound = bind_points(model, garment.vertices)
    return replace(
        model,
        garment=garment,
        rest_normals=bound["normals"],
        influence_nodes=bound["influence_nodes"],
        influence_weights=bound["influence_weights"],
    )
