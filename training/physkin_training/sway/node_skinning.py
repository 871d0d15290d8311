"""Skinning as a linear map from garment node transforms to vertices, and its transpose.

Dimensions: `B` samples, `m` garment nodes, `n` vertices. Metres.
"""

from __future__ import annotations

import torch

from physkin_training.dynamics.dressed_samples import DressedSamples

__all__ = ["NodeSkinning"]


class NodeSkinning:
    """Of the samples' rest shapes. Skinning weights are the same in all of them, so that transforms are blended by one
    product."""

    def __init__(self, samples: DressedSamples) -> None:
        drape = samples.drape
        self._worn = self._rest = samples.worn.rest
        self._weights = drape.dense(drape.skinning_weights, self._rest.vertices)

    def fold(self, offsets: torch.Tensor | None) -> None:
        """From here on rest vertices are moved by offsets (B, n, 3) of detail; None: as they are worn."""
        self._rest = self._worn.moved(offsets)

    def vertices(self, nodes: torch.Tensor) -> torch.Tensor:
        """Vertices (B, n, 3) of garment nodes (B, m, 3, 4), or what a change of them moves vertices by."""
        return self._rest.carried(self._weights, nodes)

    def transposed(self, forces: torch.Tensor) -> torch.Tensor:
        """What forces (B, n, 3) on vertices do to garment nodes (B, m, 3, 4)."""
        places = torch.nn.functional.pad(self._rest.vertices, (0, 1), value=1.0)
        moments = (forces[..., None] * places[..., None, :]).transpose(0, 1)  # (n, B, 3, 4)
        pulled = (self._weights.T @ moments.flatten(1)).unflatten(1, (-1, 3, 4)).transpose(0, 1)
        about_nodes = pulled[..., :3] - pulled[..., 3:] * self._rest.nodes[:, :, None]
        return torch.cat([about_nodes, pulled[..., 3:]], dim=-1)
