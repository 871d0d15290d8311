"""The trainable drape: networks, garment nodes and skinning weights from pose to garment vertices, in torch.

Dimensions: `B` samples, `m` garment nodes, `n` vertices, `K` influences, `p` pose vector, `s` body modulation, `D`
detail nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from physkin_core.model.garment import Garment
from physkin_core.rig.rig import Rig
from physkin_training.config import NetworkConfig
from physkin_training.networks.garment_nodes import DetailNodeSet, GarmentNodeSet
from physkin_training.networks.networks import Networks
from physkin_training.sampling.posed_bodies import BodySet

__all__ = ["Drape", "RestShape", "compose_nodes", "delta_transforms"]


@dataclass(frozen=True)
class RestShape:
    """Rest shapes of samples: vertices (B, n, 3) and garment nodes (B, m, 3) [m], canonical pose."""

    vertices: torch.Tensor
    nodes: torch.Tensor

    def moved(self, offsets: torch.Tensor | None) -> RestShape:
        """With its vertices moved by offsets (B, n, 3) [m], None for none."""
        return self if offsets is None else replace(self, vertices=self.vertices + offsets)

    def carried(self, weights: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Vertices (B, n, 3) by skinning weights (n, m) and garment node transforms (B, m, 3, 4)."""
        shift = nodes[..., 3:] - nodes[..., :3] @ self.nodes[..., None]
        handles = torch.cat([nodes[..., :3], shift], dim=-1).permute(1, 0, 2, 3).reshape(nodes.shape[1], -1)
        blended = (weights @ handles).view(len(weights), -1, 3, 4).transpose(0, 1)
        return ((blended[..., :3] * self.vertices[:, :, None]).sum(dim=-1) + blended[..., 3]).contiguous()


class Drape(nn.Module):
    """Pose, body modulation and bone transforms to deformed vertices; skinning weights are a softmax of logits.

    The same garment nodes carry the garment by a second set of skinning weights, of fewer influences a vertex, as
    engines want them. detail: of a garment that has folds between its garment nodes, offsets of rest vertices.
    """

    def __init__(
        self,
        garment: Garment,
        nodes: GarmentNodeSet,
        rig: Rig,
        config: NetworkConfig,
        detail: DetailNodeSet | None = None,
    ) -> None:
        super().__init__()
        self.networks = Networks(config, pose_size=rig.pose_size, node_count=len(nodes.rest), detail=detail)
        if detail is not None:
            self.detail_logits = nn.Parameter(_tensor(np.log(np.maximum(detail.influence_weights, 1e-12))))
            self.register_buffer("detail_nodes", _tensor(detail.influence_nodes, torch.int64))
        self.skinning_logits = nn.Parameter(_tensor(np.log(np.maximum(nodes.influence_weights, 1e-12))))
        self.register_buffer("influence_nodes", _tensor(nodes.influence_nodes, torch.int64))
        self.register_buffer("influence_bias", torch.zeros_like(self.skinning_logits))
        self.engine_logits = nn.Parameter(self.skinning_logits.detach().clone())
        self.register_buffer("engine_bias", torch.zeros_like(self.engine_logits))
        self.register_buffer("node_rest", _tensor(nodes.rest))
        self.register_buffer("node_bone", _tensor(nodes.bone, torch.int64))
        self.register_buffer("vertices", _tensor(garment.vertices))
        self.register_buffer("garment_heads", _tensor(rig.heads))
        self.register_buffer("garment_lengths", _tensor(np.linalg.norm(rig.tails - rig.heads, axis=1)))
        self.register_buffer("lower", _tensor(rig.lower))
        self.register_buffer("upper", _tensor(rig.upper))

    @property
    def skinning_weights(self) -> torch.Tensor:
        """(n, K), rows sum to 1; pruned influences are exactly zero."""
        return torch.softmax(self.skinning_logits + self.influence_bias, dim=1)

    @property
    def engine_weights(self) -> torch.Tensor:
        """The second set of skinning weights, like the first."""
        return torch.softmax(self.engine_logits + self.engine_bias, dim=1)

    @property
    def has_detail(self) -> bool:
        """Whether there are folds between garment nodes."""
        return self.networks.detail is not None

    @property
    def detail_weights(self) -> torch.Tensor:
        """(n, J), rows sum to 1."""
        return torch.softmax(self.detail_logits, dim=1)

    def prune_influences(self, keep: int) -> None:
        """Leave only the `keep` strongest influences of every vertex; the others stay zero from here on."""
        _prune(self.skinning_weights.detach(), keep, self.influence_bias)

    def prune_engine_influences(self, keep: int) -> None:
        """The same of the second set."""
        _prune(self.engine_weights.detach(), keep, self.engine_bias)

    def node_positions(self, bodies: BodySet) -> torch.Tensor:
        """Twin of `physkin_core.model.garment_nodes.node_positions_on_body` for all bodies, (S, m, 3) [m]."""
        lengths = torch.linalg.norm(bodies.tails - bodies.heads, dim=-1)
        ratio = (lengths / self.garment_lengths.clamp_min(1e-6))[:, self.node_bone, None]
        return bodies.heads[:, self.node_bone] + ratio * (self.node_rest - self.garment_heads[self.node_bone])

    def pose_vector(self, joint_positions: torch.Tensor, gravity: torch.Tensor) -> torch.Tensor:
        """Twin of `Rig.pose_vector`: (B, d) [rad] and (B, 3) to (B, p)."""
        theta = (joint_positions - (self.lower + self.upper) / 2) / ((self.upper - self.lower) / 2)
        return torch.cat([theta.clamp(-1, 1), gravity], dim=1)

    def posed_nodes(self, bone_transforms: torch.Tensor, node_positions: torch.Tensor) -> torch.Tensor:
        """chi_skin (B, m, 3, 4). bone_transforms: (B, b, 3, 4). node_positions: (B, m, 3)."""
        transforms = bone_transforms[:, self.node_bone]
        rotation, translation = transforms[..., :3], transforms[..., 3]
        position = (rotation * node_positions[..., None, :]).sum(dim=-1) + translation
        return torch.cat([rotation, position[..., None]], dim=-1)

    def forward(
        self,
        body_modulation: torch.Tensor,
        joint_positions: torch.Tensor,
        gravity: torch.Tensor,
        posed_nodes: torch.Tensor,
        rest: RestShape | None = None,
    ) -> torch.Tensor:
        """Deformed vertices (B, n, 3) [m]. body_modulation: (B, s), otherwise as above and below."""
        nodes, detail = self.draped(body_modulation, joint_positions, gravity, posed_nodes)
        return self.skin(nodes, rest, detail)

    def draped(
        self,
        body_modulation: torch.Tensor,
        joint_positions: torch.Tensor,
        gravity: torch.Tensor,
        posed_nodes: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """chi (B, m, 3, 4): the posed garment nodes as the networks correct them; and offsets of detail nodes (B, D, 3)
        [m], None of a garment without any."""
        pose = self.pose_vector(joint_positions, gravity)
        raw, detail = self.networks(body_modulation, pose, posed_nodes)
        return compose_nodes(posed_nodes, delta_transforms(raw)), detail

    def skin(
        self,
        nodes: torch.Tensor,
        rest: RestShape | None = None,
        detail: torch.Tensor | None = None,
        *,
        for_engines: bool = False,
    ) -> torch.Tensor:
        """Linear blend skinning of the garment to garment node transforms (B, m, 3, 4). Returns (B, n, 3).

        rest: the samples' rest shapes, default the template for all. detail: offsets of detail nodes (B, D, 3) [m],
        default none. for_engines: by the second set of weights.
        """
        weights = self.dense(self.engine_weights if for_engines else self.skinning_weights, nodes)
        rest = rest or RestShape(*(each.expand(len(nodes), -1, -1) for each in (self.vertices, self.node_rest)))
        return rest.moved(None if detail is None else self.vertex_offsets(detail)).carried(weights, nodes)

    def vertex_offsets(self, detail: torch.Tensor) -> torch.Tensor:
        """Offsets of rest vertices (B, n, 3) [m] of those of detail nodes (B, D, 3)."""
        weights = _dense(self.detail_nodes, self.detail_weights.to(detail.dtype), detail.shape[1])
        moved = weights @ detail.transpose(0, 1).flatten(1)
        return moved.unflatten(1, (-1, 3)).transpose(0, 1)

    def linear_parts(self, nodes: torch.Tensor) -> torch.Tensor:
        """The linear parts of garment node transforms (B, m, 3, 4), blended at each vertex: (B, n, 3, 3)."""
        return torch.einsum("vm,bmij->bvij", self.dense(self.skinning_weights, nodes), nodes[..., :3])

    def dense(self, weights: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Skinning weights (n, K) over all garment nodes (n, m), in the type of `nodes`."""
        return _dense(self.influence_nodes, weights.to(nodes.dtype), len(self.node_rest))


def _dense(influences: torch.Tensor, weights: torch.Tensor, count: int) -> torch.Tensor:
    """Weights (n, K) of influences (n, K) over all of `count` (n, count)."""
    dense = torch.zeros(len(weights), count, device=weights.device, dtype=weights.dtype)
    return dense.scatter_add(1, influences, weights)


def _prune(weights: torch.Tensor, keep: int, bias: torch.Tensor) -> None:
    """Make `bias` (n, K) minus infinity but at the `keep` largest of weights (n, K)."""
    strongest = weights.topk(min(keep, weights.shape[1]), dim=1).indices
    others = torch.ones_like(weights, dtype=torch.bool).scatter_(1, strongest, False)
    bias.masked_fill_(others, float("-inf"))


def delta_transforms(raw: torch.Tensor) -> torch.Tensor:
    """Delta-chi (B, m, 3, 4) of the node deformer's numbers (B, m, 12): a linear part relative to the identity, row by
    row, and a translation [m]."""
    eye = torch.eye(3, device=raw.device, dtype=raw.dtype)
    return torch.cat([eye + raw[..., :9].unflatten(-1, (3, 3)), raw[..., 9:, None]], dim=-1)


def compose_nodes(posed: torch.Tensor, delta: torch.Tensor) -> torch.Tensor:
    """chi = chi_skin * delta, all (B, m, 3, 4)."""
    turned = posed[..., :3] @ delta
    return torch.cat([turned[..., :3], turned[..., 3:] + posed[..., 3:]], dim=-1)


def _tensor(array: np.ndarray, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.as_tensor(np.array(array), dtype=dtype)
