"""Skinning as a linear map from garment node transforms to vertices, and its transpose.

Dimensions: `B` samples, `m` garment nodes, `n` vertices. Metres.
"""

from __future__ import annotations

import torch

from physkin_training.dynamics.dressed_samples import DressedSamples

__all__ = ["NodeSkinning"]


class NodeSkinning:
    """Of the samples' rest shapes. Skinning weights are the same in all of them, so that transforms are blended by one
    product. `offsets` (B, n, 3) of rest vertices, by detail, may be set; None stands for none."""

    def __init__(self, samples: DressedSamples) -> None:
        drape, rest = samples.drape, samples.worn.rest
        self.offsets: torch.Tensor | None = None
        self._vertices, self._nodes = rest.vertices, rest.nodes
        self._weights = drape.dense(drape.skinning_weights, rest.vertices)

    def vertices(self, nodes: torch.Tensor) -> torch.Tensor:
        """Vertices (B, n, 3) of garment nodes (B, m, 3, 4), or what a change of them moves vertices by."""
        shift = nodes[..., 3] - (nodes[..., :3] * self._nodes[:, :, None]).sum(dim=-1)
        handles = torch.cat([nodes[..., :3], shift[..., None]], dim=-1).transpose(0, 1).flatten(1)
        blended = (self._weights @ handles).unflatten(1, (-1, 3, 4))  # (n, B, 3, 4)
        return (blended * self._places()[..., None, :]).sum(dim=-1).transpose(0, 1).contiguous()

    def transposed(self, forces: torch.Tensor) -> torch.Tensor:
        """What forces (B, n, 3) on vertices do to garment nodes (B, m, 3, 4)."""
        moments = forces.transpose(0, 1)[..., None] * self._places()[..., None, :]  # (n, B, 3, 4)
        pulled = (self._weights.T @ moments.flatten(1)).unflatten(1, (-1, 3, 4)).transpose(0, 1)
        about_nodes = pulled[..., :3] - pulled[..., 3:] * self._nodes[:, :, None]
        return torch.cat([about_nodes, pulled[..., 3:]], dim=-1)

    def _places(self) -> torch.Tensor:
        """Rest vertices, moved by the offsets, and 1 (n, B, 4)."""
        places = self._vertices if self.offsets is None else self._vertices + self.offsets
        return torch.nn.functional.pad(places, (0, 1), value=1.0).transpose(0, 1)
