"""The band that holds a garment up: squared distance of its vertices from where they are worn, beyond a slack."""

import numpy as np

from physkin_training.contact.wearing import Wearing
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["BAND_SLACK", "BAND_STIFFNESS", "Band"]

wp.set_module_options({"enable_backward": False})

BAND_STIFFNESS = 1.0e5
"""[J/m4]: energy = stiffness * vertex area * (distance beyond the slack)^2."""

BAND_SLACK = 0.015
"""How far [m] a vertex of the band may move from its place on the body before it is held."""


@wp.kernel
def band_kernel(
    rest: Rest,
    drapes: Drapes,
    band: wp.array2d(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    across: wp.array2d(dtype=wp.float32),
    along: wp.array2d(dtype=wp.float32),
    direction: wp.array2d(dtype=wp.vec3),
):
    """One vertex of one sample against the body vertex where it is worn."""
    s, k = wp.tid()
    v = band[k, 0]
    worn = s * (drapes.body_points.shape[0] / drapes.x.shape[0]) + place[k]
    away = drapes.x[s, v] + drapes.offset[s] - drapes.body_points[worn]
    distance = wp.length(away)
    beyond = distance - limit[k]
    energy[s, k] = 0.0
    across[s, k] = 0.0
    along[s, k] = 0.0
    if beyond > 0.0:
        stiffness = BAND_STIFFNESS * rest.vertex_area[rest.row[s], v]
        energy[s, k] = stiffness * beyond * beyond
        wp.atomic_add(drapes.gradient, s, v, away * (2.0 * stiffness * beyond / distance))
        across[s, k] = 2.0 * stiffness * beyond / distance
        along[s, k] = 2.0 * stiffness - across[s, k]
        direction[s, k] = away / distance


class Band(Energy):
    """Nothing without `wearing`. isotropic: whether the second derivative is as stiff in every direction as it is along
    the pull, a bound for solvers that take long steps; default False. It is positive semidefinite in either case."""

    name = "band"

    def __init__(self, cloth: Cloth, wearing: "Wearing | None") -> None:
        k = 0 if wearing is None else len(wearing.band)
        super().__init__(cloth, np.empty((0, 1), dtype=np.int32) if wearing is None else wearing.band[:, None])
        self.isotropic = False
        self._place = cloth.array(wearing.band_place if k else [])
        self._limit = cloth.array(wearing.band_distance + BAND_SLACK if k else [], wp.float32)
        self.state = across, along, direction = cloth.zeros(k), cloth.zeros(k), cloth.zeros(k, 3)
        self._stiffness = wp.from_torch(across), wp.from_torch(along), view(direction)

    def evaluate(self, drapes: Drapes) -> None:
        given = self._rest, drapes, self._elements, self._place, self._limit
        self._launch(band_kernel, *given, self._energy, *self._stiffness)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        across, along, direction = self._stiffness
        if self.isotropic:
            self._add_vertex_blocks(blocks, across)
            self._add_vertex_blocks(blocks, along)
        else:
            self._add_vertex_blocks(blocks, across, along, direction)
