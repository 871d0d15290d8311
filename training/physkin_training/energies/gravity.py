"""Gravity: potential energy, height measured from the root against the direction of gravity."""

import numpy as np
import warp as wp

from physkin_training.energies.energy import Cloth, Drapes, Energy

__all__ = ["Gravity"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def gravity_kernel(
    x: wp.array2d(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    weight: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """One vertex of one sample."""
    s, v = wp.tid()
    pull = weight[rest_row[s], v]
    energy[s, v] = -pull * wp.dot(x[s, v], direction[s])
    wp.atomic_add(gradient, s, v, direction[s] * -pull)


class Gravity(Energy):
    """Linear: it has no second derivative."""

    name = "gravity"

    def __init__(self, cloth: Cloth) -> None:
        super().__init__(cloth, np.arange(len(cloth.garment.vertices))[:, None])
        self._weight = wp.from_torch(cloth.rest.weight)

    def evaluate(self, drapes: Drapes) -> None:
        direction = wp.from_torch(drapes.gravity, dtype=wp.vec3)
        self._launch(
            gravity_kernel, drapes.points, direction, self.cloth.row, self._weight, self._energy, drapes.forces
        )
