"""A drape at a pose far from the canonical one: the body is moved there in stages, the garment minimised after each.

From stage to stage cloth is carried along as plain skinning moves and turns it.
Dimensions: `B` samples, `n` garment vertices. Metres.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from physkin_training.physics.newton_solver import Solution

__all__ = ["ON_THE_WAY", "drape_in_stages"]

ON_THE_WAY = {"tolerance": 0.1, "iterations": 15}
"""How well poses on the way from the canonical one are minimised."""
FARTHEST_CARRIED = 2.0
"""Offsets from plain skinning may grow by this factor at most as they are carried along."""

Skinned = tuple[torch.Tensor, torch.Tensor]
"""Plain skinning: vertices (B, n, 3) and how it turns the cloth about each, (B, n, 3, 3)."""


def drape_in_stages(
    skinned_at: Callable[[float], Skinned], minimise: Callable[..., Solution], *, stages: int, **options
) -> Solution:
    """The minimum at the pose after `stages` stages, each but the last one minimised `ON_THE_WAY`.

    skinned_at: plain skinning at a share (0 to 1) of the way to the pose. minimise: takes vertices to start from
    (B, n, 3), the share, and options of `FullSpaceSolver.minimise`; `options` are those at the pose itself. stages: 0
    starts there, from plain skinning.
    """
    if stages < 0:
        raise ValueError(f"stages must be 0 or more, got {stages}")
    place, turned = skinned, _ = skinned_at(0.0 if stages else 1.0)
    for stage in range(stages):
        offset = minimise(place, stage / stages, **ON_THE_WAY).vertices.to(skinned) - skinned
        before = turned
        skinned, turned = skinned_at((stage + 1) / stages)
        place = skinned + _carried(offset, before, turned)
    return minimise(place, 1.0, **options)


def _carried(offset: torch.Tensor, turned: torch.Tensor, now: torch.Tensor) -> torch.Tensor:
    """Offsets (B, n, 3) from plain skinning, turned with the cloth from how it was to how it is, (B, n, 3, 3) each."""
    local, _ = torch.linalg.solve_ex(turned, offset[..., None])
    carried = (now @ local)[..., 0]
    longest = FARTHEST_CARRIED * torch.linalg.vector_norm(offset, dim=-1)
    short = torch.linalg.vector_norm(carried, dim=-1) <= longest
    return torch.where(short[..., None], carried, offset)  # where blending has all but flattened the cloth
