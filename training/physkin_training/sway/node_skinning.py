"""Skinning as a linear map from garment node transforms to vertices, and its transpose.

Dimensions: `B` samples, those of a body one after the other, `S` bodies, `m` garment nodes, `n` vertices. Metres.
"""

from __future__ import annotations

import torch

from physkin_training.dynamics.dressed_samples import DressedSamples

__all__ = ["NodeSkinning"]


class NodeSkinning:
    """Of samples whose bodies are in order, the same number of each. One matrix (n, 4 m) a body: all that its samples
    need is one product."""

    def __init__(self, samples: DressedSamples) -> None:
        self._bodies = len(samples.body_set)
        self._each = len(samples.body) // self._bodies
        rest = samples.worn.rest
        vertices, nodes = rest.vertices[:: self._each], rest.nodes[:: self._each]
        offset = vertices[:, :, None] - nodes[:, None]
        drape = samples.drape
        weights = drape.dense(drape.skinning_weights, vertices)
        handle = torch.cat([offset, torch.ones_like(offset[..., :1])], dim=-1)
        self._basis = (weights[..., None] * handle).flatten(2)  # (S, n, 4 m)

    def vertices(self, nodes: torch.Tensor) -> torch.Tensor:
        """Vertices (B, n, 3) of garment nodes (B, m, 3, 4), or what a change of them moves vertices by."""
        columns = nodes.unflatten(0, (self._bodies, self._each)).permute(0, 2, 4, 1, 3)  # (S, m, 4, each, 3)
        moved = self._basis @ columns.flatten(3).flatten(1, 2)
        return moved.unflatten(2, (self._each, 3)).transpose(1, 2).flatten(0, 1).contiguous()

    def transposed(self, forces: torch.Tensor) -> torch.Tensor:
        """What forces (B, n, 3) on vertices do to garment nodes (B, m, 3, 4)."""
        columns = forces.unflatten(0, (self._bodies, self._each)).transpose(1, 2).flatten(2)
        rows = (self._basis.mT @ columns).unflatten(1, (-1, 4)).unflatten(3, (self._each, 3))  # (S, m, 4, each, 3)
        return rows.permute(0, 3, 1, 4, 2).flatten(0, 1)
