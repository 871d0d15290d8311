"""What energies have in common. A new one needs its own file and a place in the list of `PhysicsLosses`.

An energy is a sum over elements: faces, hinges or single vertices. One pass writes the energy [J] of every element and
adds dE/dx [N] to a shared gradient. For Newton's method it also gives its second derivative [N/m], a 3 x 3 block for
every pair of an element's vertices: the exact one, or one made positive semidefinite element by element.

Dimensions: `B` samples, `n` garment vertices, `e` elements of `c` vertices, `z` blocks. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import torch
import warp as wp

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material

if TYPE_CHECKING:
    from physkin_training.physics.rest_data import RestData

__all__ = ["Blocks", "Cloth", "Drapes", "Energy"]

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True)
class Cloth:
    """Samples of a garment. rest_row: (B,) int32, which of the rest shapes each has; may be changed in place."""

    garment: Garment
    material: Material
    rest: RestData
    rest_row: torch.Tensor

    @property
    def device(self) -> torch.device:
        """Where the samples are."""
        return self.rest_row.device

    @cached_property
    def row(self) -> wp.array:
        """`rest_row`, for kernels."""
        return wp.from_torch(self.rest_row)

    @property
    def lame(self) -> tuple[float, float]:
        """Both stiffnesses [N/m] of the membrane, mu and lambda, in plane stress."""
        young, poisson = self.material.youngs_modulus, self.material.poisson_ratio
        return young / (2 * (1 + poisson)), young * poisson / (1 - poisson**2)

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """(B, *shape)."""
        return torch.zeros(len(self.rest_row), *shape, dtype=dtype, device=self.device)

    def array(self, values: np.ndarray, dtype: type) -> wp.array:
        """The same for all samples, for kernels: of dtype wp.int32, wp.float32 or wp.bool."""
        values = np.ascontiguousarray(values, dtype=wp.dtype_to_numpy(dtype))
        return wp.array(values, dtype=dtype, device=wp.device_from_torch(self.device))


@dataclass(frozen=True)
class Drapes:
    """Where the cloth is: vertices x (B, n, 3) under gravity (B, 3) against one mesh of all samples' posed bodies,
    sample s displaced by body_offset[s] (B, 3). Energies add to gradient (B, n, 3) [N], and stretch the sums of face
    normals to normals (B, n, 3). All are contiguous."""

    x: torch.Tensor
    gravity: torch.Tensor
    body: wp.Mesh
    body_offset: torch.Tensor
    gradient: torch.Tensor
    normals: torch.Tensor

    @cached_property
    def points(self) -> wp.array:
        """`x`, for kernels, as `forces` is the gradient."""
        return wp.from_torch(self.x, dtype=wp.vec3)

    @cached_property
    def forces(self) -> wp.array:
        return wp.from_torch(self.gradient, dtype=wp.vec3)

    @cached_property
    def offset(self) -> wp.array:
        return wp.from_torch(self.body_offset, dtype=wp.vec3)


@dataclass(frozen=True)
class Blocks:
    """Where an energy adds its second derivative: all (B, z) mat33, and slots (e, c * c) int32 of each element's own,
    row by row. active: (B,) bool, samples to work on. exact: (B,) bool, else blocks are positive semidefinite."""

    all: wp.array
    slots: wp.array
    active: wp.array
    exact: wp.array


class Energy:
    """elements: (e, c) int, the vertices that each element's energy depends on. values: (B, e) [J] where evaluated
    last."""

    name: ClassVar[str]

    def __init__(self, cloth: Cloth, elements: np.ndarray) -> None:
        self.cloth, self.elements = cloth, elements
        self.values = cloth.zeros(len(elements))
        self._energy = wp.from_torch(self.values)

    def evaluate(self, drapes: Drapes) -> None:
        """Write `values`, and add to the gradient."""
        raise NotImplementedError

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        """At drapes that it was evaluated at last. None for a linear energy."""

    def _launch(self, kernel: wp.Kernel, *arguments: object) -> None:
        """Of every element of every sample."""
        wp.launch(kernel, dim=self.values.shape, inputs=arguments, device=wp.device_from_torch(self.cloth.device))

    def _add_vertex_blocks(
        self, blocks: Blocks, across: wp.array | None, along: wp.array | None = None, direction: wp.array | None = None
    ) -> None:
        """Of single vertices: `across` (B, e) [N/m] in all directions, and `along` (B, e) more in `direction`."""
        self._launch(add_vertex_blocks_kernel, blocks.active, blocks.slots, across, along, direction, blocks.all)


@wp.kernel
def add_vertex_blocks_kernel(
    active: wp.array(dtype=wp.bool),
    slots: wp.array2d(dtype=wp.int32),
    across: wp.array2d(dtype=wp.float32),
    along: wp.array2d(dtype=wp.float32),
    direction: wp.array2d(dtype=wp.vec3),
    blocks: wp.array2d(dtype=wp.mat33),
):
    """Arrays that are left out have no rows."""
    s, k = wp.tid()
    if not active[s]:
        return
    if across.shape[0] > 0:
        wp.atomic_add(blocks, s, slots[k, 0], across[s, k] * wp.identity(n=3, dtype=wp.float32))
    if along.shape[0] > 0:
        wp.atomic_add(blocks, s, slots[k, 0], along[s, k] * wp.outer(direction[s, k], direction[s, k]))
