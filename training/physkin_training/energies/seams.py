"""Pairs of vertices that must not be farther apart than a gap: seams while they are sewn, and a garment's threads."""

import numpy as np
import torch

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy
from physkin_training.quiet_warp import wp

__all__ = ["THREAD_GAP", "Seams", "Threads"]

wp.set_module_options({"enable_backward": False})

THREAD_GAP = 0.002
"""[m] between the two layers of cloth that a thread holds."""
THREAD_STIFFNESS = 3000.0
"""[N/m] A button that is pulled by 3 N lets cloth 1 mm farther apart."""


@wp.kernel
def seam_kernel(
    drapes: Drapes,
    pairs: wp.array2d(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    gap: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
):
    """One pair of one sample: k / 2 (distance - gap)^2 where it is farther apart."""
    s, k = wp.tid()
    a, b = pairs[k, 0], pairs[k, 1]
    away = drapes.x[s, b] - drapes.x[s, a]
    distance = wp.length(away)
    beyond = wp.max(distance - gap[s, k], 0.0)
    energy[s, k] = 0.5 * stiffness[0] * beyond * beyond
    if beyond > 0.0:
        force = away * (stiffness[0] * beyond / distance)
        wp.atomic_add(drapes.gradient, s, b, force)
        wp.atomic_add(drapes.gradient, s, a, -force)


@wp.kernel
def seam_hessian_kernel(
    drapes: Drapes,
    pairs: wp.array2d(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    gap: wp.array2d(dtype=wp.float32),
    blocks: Blocks,
):
    """k n n^T + k (1 - gap / distance) (I - n n^T), which is positive semidefinite."""
    s, k = wp.tid()
    if not blocks.active[s]:
        return
    away = drapes.x[s, pairs[k, 1]] - drapes.x[s, pairs[k, 0]]
    distance = wp.length(away)
    if distance > gap[s, k]:
        identity = wp.identity(n=3, dtype=wp.float32)
        along = wp.outer(away, away) / wp.max(distance * distance, 1.0e-20)
        block = stiffness[0] * (along + (1.0 - gap[s, k] / distance) * (identity - along))
        wp.atomic_add(blocks.all, s, blocks.slots[k, 0], block)
        wp.atomic_add(blocks.all, s, blocks.slots[k, 3], block)
        wp.atomic_add(blocks.all, s, blocks.slots[k, 1], -block)
        wp.atomic_add(blocks.all, s, blocks.slots[k, 2], -block)


class Seams(Energy):
    """pairs: (e, 2) vertices that are sewn together. stiffness (1,) [N/m] and gap (B, e) [m] may be changed in
    place."""

    name = "seams"

    def __init__(self, cloth: Cloth, pairs: np.ndarray, *, stiffness: float) -> None:
        super().__init__(cloth, pairs)
        self.stiffness = torch.full((1,), stiffness, device=cloth.device)
        self.gap = cloth.zeros(len(pairs))
        self._given = self._elements, wp.from_torch(self.stiffness), wp.from_torch(self.gap)

    def evaluate(self, drapes: Drapes) -> None:
        self._launch(seam_kernel, drapes, *self._given, self._energy)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(seam_hessian_kernel, drapes, *self._given, blocks)


class Threads(Seams):
    """The garment's threads; nothing without any."""

    name = "threads"

    def __init__(self, cloth: Cloth) -> None:
        threads = cloth.garment.threads
        pairs = np.empty((0, 2), dtype=np.int32) if threads is None else threads
        super().__init__(cloth, pairs, stiffness=THREAD_STIFFNESS)
        self.gap.fill_(THREAD_GAP)
