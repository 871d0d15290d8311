"""The band that holds a garment up: squared distance of its vertices beyond a slack from where they are worn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy

if TYPE_CHECKING:
    from physkin_training.physics.wearing import Wearing

__all__ = ["BAND_SLACK", "BAND_STIFFNESS", "Band"]

wp.set_module_options({"enable_backward": False})

BAND_STIFFNESS = 1.0e5
"""[J/m4]: energy = stiffness * vertex area * (distance beyond the slack)^2."""

BAND_SLACK = 0.015
"""How far [m] a vertex of the band may move from its place on the body before it is held."""


@wp.kernel
def band_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body_points: wp.array(dtype=wp.vec3),
    body_offset: wp.array(dtype=wp.vec3),
    vertices_per_body: wp.int32,
    band: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
    across: wp.array2d(dtype=wp.float32),
    along: wp.array2d(dtype=wp.float32),
    direction: wp.array2d(dtype=wp.vec3),
):
    """One vertex of one sample against the body vertex where it is worn."""
    s, k = wp.tid()
    v = band[k]
    away = x[s, v] + body_offset[s] - body_points[s * vertices_per_body + place[k]]
    distance = wp.length(away)
    beyond = distance - limit[k]
    energy[s, k] = 0.0
    across[s, k] = 0.0
    along[s, k] = 0.0
    if beyond > 0.0:
        stiffness = BAND_STIFFNESS * vertex_area[rest_row[s], v]
        energy[s, k] = stiffness * beyond * beyond
        wp.atomic_add(gradient, s, v, away * (2.0 * stiffness * beyond / distance))
        across[s, k] = 2.0 * stiffness * beyond / distance
        along[s, k] = 2.0 * stiffness - across[s, k]
        direction[s, k] = away / distance


class Band(Energy):
    """Nothing without `wearing`. isotropic: whether the second derivative is as stiff in every direction as it is along
    the pull, a bound for solvers that take long steps; default False. It is positive semidefinite in either case."""

    name = "band"

    def __init__(self, cloth: Cloth, wearing: Wearing | None) -> None:
        band = np.empty(0, dtype=np.int32) if wearing is None else wearing.band
        super().__init__(cloth, band[:, None])
        self.isotropic = False
        self._vertex_area = wp.from_torch(cloth.rest.vertex_area)
        if len(band):
            self._places = (
                cloth.array(wearing.band, wp.int32),
                cloth.array(wearing.band_place, wp.int32),
                cloth.array(wearing.band_distance + BAND_SLACK, wp.float32),
            )
        across, along, direction = (cloth.zeros(len(band), *shape) for shape in ((), (), (3,)))
        self._stiffness = wp.from_torch(across), wp.from_torch(along), wp.from_torch(direction, dtype=wp.vec3)

    def evaluate(self, drapes: Drapes) -> None:
        if not len(self.elements):
            return
        points = drapes.body.points
        body = (points, drapes.offset, len(points) // len(drapes.x))
        rest = (self.cloth.row, self._vertex_area)
        self._launch(
            band_kernel, drapes.points, *body, *self._places, *rest, self._energy, drapes.forces, *self._stiffness
        )

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        if not len(self.elements):
            return
        across, along, direction = self._stiffness
        if self.isotropic:
            self._add_vertex_blocks(blocks, across)
            self._add_vertex_blocks(blocks, along)
        else:
            self._add_vertex_blocks(blocks, across, along, direction)
