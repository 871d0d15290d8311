"""Gravity: potential energy, height measured from the root against the direction of gravity."""

import numpy as np

from physkin_training.energies.energy import Cloth, Drapes, Energy, Rest
from physkin_training.quiet_warp import wp

__all__ = ["Gravity"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def gravity_kernel(rest: Rest, drapes: Drapes, energy: wp.array2d(dtype=wp.float32)):
    """One vertex of one sample."""
    s, v = wp.tid()
    pull = rest.weight[rest.row[s], v]
    energy[s, v] = -pull * wp.dot(drapes.x[s, v], drapes.gravity[s])
    wp.atomic_add(drapes.gradient, s, v, drapes.gravity[s] * -pull)


class Gravity(Energy):
    """Linear: it has no second derivative."""

    name = "gravity"

    def __init__(self, cloth: Cloth) -> None:
        super().__init__(cloth, np.arange(len(cloth.garment.vertices))[:, None])

    def evaluate(self, drapes: Drapes) -> None:
        self._launch(gravity_kernel, self._rest, drapes, self._energy)
