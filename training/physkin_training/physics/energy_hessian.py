"""Second derivatives of the physics losses: one 3 x 3 block for every pair of vertices that share an element.

The energies add the blocks of all samples to block-sparse rows of one pattern. The blocks come in two kinds, chosen for
each sample: exact ones, or ones made positive semidefinite element by element, so that a step downhill always exists.

Dimensions: `B` samples, `n` garment vertices, `z` blocks. Metres, newtons.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_training.energies.energy import Blocks, view
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.quiet_warp import wp

__all__ = ["EnergyHessian"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def multiply_kernel(
    active: wp.array(dtype=wp.bool),
    row_start: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    blocks: wp.array2d(dtype=wp.mat33),
    x: wp.array2d(dtype=wp.vec3),
    product: wp.array2d(dtype=wp.vec3),
):
    """One block row of one sample times a vector."""
    s, v = wp.tid()
    if not active[s]:
        return
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(row_start[v], row_start[v + 1]):
        total += blocks[s, k] * x[s, columns[k]]
    product[s, v] = total


@wp.kernel
def damp_and_invert_kernel(
    active: wp.array(dtype=wp.bool),
    extra: wp.array2d(dtype=wp.mat33),
    damping: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    diagonal: wp.array(dtype=wp.int32),
    blocks: wp.array2d(dtype=wp.mat33),
    inverse: wp.array2d(dtype=wp.mat33),
):
    """Add to one diagonal block, and invert it for the preconditioner. Arrays that are left out have no rows."""
    s, v = wp.tid()
    if not active[s]:
        return
    identity = wp.identity(n=3, dtype=wp.float32)
    block = blocks[s, diagonal[v]]
    if extra.shape[0] > 0:
        block = block + extra[s, v]
    if damping.shape[0] > 0:
        block = block + damping[s] * scale[v] * identity
    blocks[s, diagonal[v]] = block
    size = wp.trace(block) / 3.0
    positive = block[0, 0] > 0.0 and block[0, 0] * block[1, 1] > block[0, 1] * block[1, 0]
    if positive and wp.determinant(block) > 1.0e-6 * size * size * size:
        inverse[s, v] = wp.inverse(block)
    else:
        inverse[s, v] = identity / wp.max(wp.abs(size), 1.0e-6)


class EnergyHessian:
    """Block-sparse second derivative of physics losses.

    `active` (B,) bool: samples that `assemble` and `multiply` work on; the others' results are left as they are.
    """

    def __init__(self, losses: PhysicsLosses) -> None:
        self.losses = losses
        cloth = losses.cloth
        n = len(cloth.garment.vertices)
        pattern, slots = _pattern([np.arange(n)[:, None], *(energy.elements for energy in losses.energies)], n)
        self.device = wp.device_from_torch(cloth.device)
        self._columns = cloth.array(pattern % n)
        self._row_start = cloth.array(np.searchsorted(pattern, np.arange(n + 1) * n))
        self._diagonal, *self._slots = (cloth.array(each) for each in (slots[0][:, 0], *slots[1:]))
        self._vertex_area = cloth.array(cloth.garment.vertex_areas, wp.float32)
        self._blocks, self._inverse = cloth.zeros(len(pattern), 3, 3), cloth.zeros(n, 3, 3)
        self._all = view(self._blocks, wp.mat33)
        self.active = cloth.zeros(dtype=torch.bool).logical_not()
        self._active = wp.from_torch(self.active)

    def assemble(self, exact: torch.Tensor) -> None:
        """Compute the blocks where the losses have been evaluated last.

        exact: (B,) bool, else every element's block is made positive semidefinite.
        """
        self._blocks[self.active] = 0.0
        blocks = Blocks()
        blocks.all, blocks.active, blocks.exact = self._all, self._active, wp.from_torch(exact)
        for energy, slots in zip(self.losses.energies, self._slots, strict=True):
            blocks.slots = slots
            energy.add_second_derivative(self.losses.drapes, blocks)

    def add_to_diagonal(self, blocks: torch.Tensor | None = None, damping: torch.Tensor | None = None) -> None:
        """Add a block for every vertex (B, n, 3, 3), and its area times the damping (B,) [N/m3].

        To be called before `precondition`, even if there is nothing to add.
        """
        wp.launch(
            damp_and_invert_kernel,
            dim=self._inverse.shape[:2],
            inputs=[
                self._active,
                None if blocks is None else view(blocks, wp.mat33),
                None if damping is None else wp.from_torch(damping),
                *(self._vertex_area, self._diagonal),
            ],
            outputs=[self._all, view(self._inverse, wp.mat33)],
            device=self.device,
        )

    def multiply(self, x: torch.Tensor, product: torch.Tensor) -> None:
        """Write H x into `product`, both (B, n, 3)."""
        given, written = view(x), view(product)
        wp.launch(
            multiply_kernel,
            dim=x.shape[:2],
            inputs=[self._active, self._row_start, self._columns, self._all, given],
            outputs=[written],
            device=self.device,
        )
        for energy in self.losses.energies:
            energy.add_coupling(self._active, given, written)

    def precondition(self, x: torch.Tensor) -> torch.Tensor:
        """Inverse of the diagonal blocks times x (B, n, 3)."""
        return (self._inverse * x[:, :, None, :]).sum(dim=-1)


def _pattern(elements: list[np.ndarray], n: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Sorted keys row * n + column (z,) of the blocks that elements (e, corners) need, and where each element's
    corners * corners blocks lie among them."""
    keys = [
        (element[:, :, None].astype(np.int64) * n + element[:, None, :]).reshape(len(element), element.shape[1] ** 2)
        for element in elements
    ]
    pattern = np.unique(np.concatenate([key.reshape(-1) for key in keys]))
    return pattern, [np.searchsorted(pattern, key) for key in keys]
