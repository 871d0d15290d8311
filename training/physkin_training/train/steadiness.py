"""A penalty on garment nodes that jump: where cloth can lie in two places, networks must not switch from one to the
other between two poses beside each other.

Dimensions: `B` samples, `m` garment nodes, `D` detail nodes, `d` degrees of freedom.
"""

from __future__ import annotations

import torch

from physkin_training.networks.draping import Drape
from physkin_training.sampling.posed_bodies import PosedBodies

__all__ = ["Steadiness"]

BESIDE = 0.03
"""Standard deviation [rad] of every joint between a pose and the one beside it, about a frame of fast motion."""
SLACK = 0.015
"""How much more [m] than its bone a garment node, or cloth beside it, may move between the two at no cost."""
DETAIL_SLACK = 0.003
"""How far [m] a detail node may move between the two at no cost: folds follow the pose, but do not pop."""
REACH = 0.1
"""How far [m] beside a garment node cloth that it carries lies: that jumps where the node's linear part does."""


class Steadiness:
    """Compares drapes of poses with drapes of poses drawn beside them. stiffness [J/m2]: of the mean excess motion of a
    garment node and of three points beside it, one along each of its axes; and as much of that of detail nodes, as if
    there were as many of these."""

    def __init__(self, drape: Drape, posed_bodies: PosedBodies, stiffness: float) -> None:
        self._drape, self._posed_bodies, self._stiffness = drape, posed_bodies, stiffness

    def __call__(
        self,
        nodes: torch.Tensor,
        posed_nodes: torch.Tensor,
        detail: torch.Tensor | None = None,
        *,
        modulation: torch.Tensor,
        positions: torch.Tensor,
        gravity: torch.Tensor,
        node_positions: torch.Tensor,
        body: torch.Tensor,
    ) -> torch.Tensor:
        """Mean energy [J] a sample. nodes, posed_nodes (B, m, 3, 4): draped and plainly posed garment nodes of joint
        positions (B, d) under gravity (B, 3), and detail (B, D, 3) their detail nodes' offsets; modulation (B, s),
        node_positions (B, m, 3) and body (B,): the samples' own, see `Drape`. The posed bodies' mesh stays."""
        with torch.no_grad():
            beside = positions + BESIDE * torch.randn_like(positions)
            beside = torch.clamp(beside, self._drape.lower, self._drape.upper)
            bones = self._posed_bodies.bone_transforms(beside, body)
            posed_beside = self._drape.posed_nodes(bones, node_positions)
            carried = _moved(posed_nodes, posed_beside)
        nodes_beside, detail_beside = self._drape.draped(modulation, beside, gravity, posed_beside)
        excess = (_moved(nodes, nodes_beside) - carried - SLACK).clamp_min(0.0)
        square = excess.square().mean()
        if detail is not None:
            apart = torch.linalg.vector_norm(detail - detail_beside, dim=-1)
            square = square + (apart - DETAIL_SLACK).clamp_min(0.0).square().mean()
        return self._stiffness * nodes.shape[1] * square


def _moved(nodes: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Distances (B, m, 4) [m] between garment nodes (B, m, 3, 4), and between the points beside them."""
    return torch.linalg.vector_norm(_points(nodes) - _points(others), dim=-1)


def _points(nodes: torch.Tensor) -> torch.Tensor:
    """Garment nodes (B, m, 3, 4) as points (B, m, 4, 3): where they are, and `REACH` from there along each axis."""
    origin, axes = nodes[..., 3][..., None, :], nodes[..., :3].mT
    return torch.cat([origin, origin + REACH * axes], dim=-2)
