"""What energies have in common.

A new one needs its own file, and in physics_losses.py a field of `Energies`, a name in `TERMS` and a place in the list
of `PhysicsLosses`.

An energy is a sum over elements: faces, hinges or single vertices. One pass writes the energy [J] of every element and
adds dE/dx [N] to a shared gradient. For Newton's method it also gives its second derivative [N/m], a 3 x 3 block for
every pair of an element's vertices: the exact one, or one made positive semidefinite element by element.

Dimensions: `B` samples, `n` garment vertices, `f` faces, `q` hinges, `e` elements of `c` vertices, `z` blocks, `R` rest
shapes. Metres, root frame.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.energies.rest_data import RestData
from physkin_training.quiet_warp import wp

__all__ = ["Blocks", "Cloth", "Drapes", "Energy", "Rest", "view"]

wp.set_module_options({"enable_backward": False})


@wp.struct
class Rest:
    """Tables of `RestData`, and which rest shape each sample has, row (B,)."""

    row: wp.array(dtype=wp.int32)
    inverse: wp.array2d(dtype=wp.mat22)
    face_area: wp.array2d(dtype=wp.float32)
    vertex_area: wp.array2d(dtype=wp.float32)
    hinge_angle: wp.array2d(dtype=wp.float32)
    bend_stiffness: wp.array2d(dtype=wp.float32)
    weight: wp.array2d(dtype=wp.float32)


@wp.struct
class Drapes:
    """Where the cloth is: vertices x (B, n) under gravity (B,), against one mesh of all samples' posed bodies, sample s
    displaced by offset[s] (B,). Energies add to gradient (B, n), and stretch to the sums of face normals (B, n)."""

    x: wp.array2d(dtype=wp.vec3)
    gravity: wp.array(dtype=wp.vec3)
    body: wp.uint64
    body_points: wp.array(dtype=wp.vec3)
    offset: wp.array(dtype=wp.vec3)
    gradient: wp.array2d(dtype=wp.vec3)
    normals: wp.array2d(dtype=wp.vec3)


@wp.struct
class Blocks:
    """Where an energy adds its second derivative: all (B, z), and slots (e, c * c) of each element's own, row by row.
    active: (B,), samples to work on. exact: (B,), else blocks are positive semidefinite."""

    all: wp.array2d(dtype=wp.mat33)
    slots: wp.array2d(dtype=wp.int32)
    active: wp.array(dtype=wp.bool)
    exact: wp.array(dtype=wp.bool)


@dataclass(frozen=True)
class Cloth:
    """Samples of a garment. rest_row: (B,) int32, which of the rest shapes each has; may be changed in place."""

    garment: Garment
    material: Material
    rest: "RestData"
    rest_row: torch.Tensor

    @property
    def tables(self) -> Rest:
        """The rest shapes, for kernels."""
        tables, rest = Rest(), self.rest
        tables.row, tables.inverse = wp.from_torch(self.rest_row), view(rest.rest_inverse, wp.mat22)
        for name in ("face_area", "vertex_area", "hinge_angle", "bend_stiffness", "weight"):
            setattr(tables, name, wp.from_torch(getattr(rest, name)))
        return tables

    @property
    def device(self) -> torch.device:
        """Where the samples are."""
        return self.rest_row.device

    @property
    def lame(self) -> tuple[float, float]:
        """Both stiffnesses [N/m] of the membrane, mu and lambda, in plane stress."""
        young, poisson = self.material.youngs_modulus, self.material.poisson_ratio
        return young / (2 * (1 + poisson)), young * poisson / (1 - poisson**2)

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """(B, *shape)."""
        return torch.zeros(len(self.rest_row), *shape, dtype=dtype, device=self.device)

    def array(self, values: np.ndarray, dtype: type = wp.int32) -> wp.array:
        """The same for all samples, for kernels: of dtype wp.int32, wp.float32 or wp.bool."""
        values = np.ascontiguousarray(values, dtype=wp.dtype_to_numpy(dtype))
        return wp.array(values, dtype=dtype, device=wp.device_from_torch(self.device))


class Energy:
    """elements: (e, c) int, the vertices that each element's energy depends on. values: (B, e) [J] where evaluated
    last, and state, (B, ...) each: what else its second derivative needs to know of that."""

    name: ClassVar[str]
    state: tuple[torch.Tensor, ...] = ()

    def __init__(self, cloth: Cloth, elements: np.ndarray) -> None:
        self.cloth, self.elements = cloth, elements
        self.values = cloth.zeros(len(elements))
        self._rest, self._elements, self._energy = cloth.tables, cloth.array(elements), wp.from_torch(self.values)

    def evaluate(self, drapes: Drapes) -> None:
        """Write `values`, and add to the gradient."""
        raise NotImplementedError

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        """At drapes that it was evaluated at last. None for a linear energy."""

    def add_coupling(self, active: wp.array, x: wp.array, product: wp.array) -> None:
        """Add the second derivative that was added last to a product with x (B, n), as far as it couples vertices that
        `elements` do not, in samples `active` (B,). For all but self-contact there is none."""

    def _launch(self, kernel: wp.Kernel, *arguments: object) -> None:
        """Run a kernel for every element of every sample."""
        wp.launch(kernel, dim=self.values.shape, inputs=arguments, device=wp.device_from_torch(self.cloth.device))

    def _add_vertex_blocks(self, blocks: Blocks, *stiffness: wp.array | None) -> None:
        """Add stiffness of single vertices: (B, e) [N/m] in all directions, and (B, e) more in directions (B, e), each
        if given."""
        self._launch(add_vertex_blocks_kernel, *stiffness, *[None] * (3 - len(stiffness)), blocks)


@wp.kernel
def add_vertex_blocks_kernel(
    across: wp.array2d(dtype=wp.float32),
    along: wp.array2d(dtype=wp.float32),
    direction: wp.array2d(dtype=wp.vec3),
    blocks: Blocks,
):
    """Arrays that are left out have no rows."""
    s, k = wp.tid()
    if not blocks.active[s]:
        return
    if across.shape[0] > 0:
        wp.atomic_add(blocks.all, s, blocks.slots[k, 0], across[s, k] * wp.identity(n=3, dtype=wp.float32))
    if along.shape[0] > 0:
        wp.atomic_add(blocks.all, s, blocks.slots[k, 0], along[s, k] * wp.outer(direction[s, k], direction[s, k]))


def view(tensor: torch.Tensor, dtype: type = wp.vec3) -> wp.array:
    """A tensor of vectors or matrices, for kernels."""
    return wp.from_torch(tensor, dtype=dtype)
