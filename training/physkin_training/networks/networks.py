"""Torch twins of the three networks: hyper modulator, pose modulator, node deformer (paper: Network Architecture).

Values agree with `physkin_core.model.hyper_modulator`, `.mlp` and `.node_deformer`; names of parameters are
those of the garment model file. Dimensions: `B` poses, `S` bodies, `N` points, `D` token width, `p` pose vector,
`m` nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn
from torch.nn import functional

from physkin_core.model.hyper_modulator import ENCODING_FREQUENCIES, HEADS, token_features
from physkin_training.config import NetworkConfig
from physkin_training.networks.garment_nodes import DetailNodeSet

__all__ = ["DetailNetwork", "HyperModulator", "ModulatedMLP", "Networks"]


LINEAR_UNIT, SHIFT_UNIT = 0.2, 0.03
"""About how large corrections are: of garment nodes' linear parts, and of their translations and detail offsets [m]."""


class ModulatedMLP(nn.Module):
    """Hidden layers silu((1 + scale) * (W x + bias) + shift) of some widths, then a linear layer that starts near zero.
    rank: of all layers but the first, each then a projection and a layer; 0: full."""

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, *, rank: int = 0) -> None:
        super().__init__()
        widths = [*hidden, outputs]
        self.layers = nn.ModuleList([nn.Linear(inputs, widths[0])])
        for before, after in zip(widths, widths[1:]):
            if rank:
                self.layers.append(nn.Linear(before, rank, bias=False))
            self.layers.append(nn.Linear(rank or before, after))
        nn.init.normal_(self.layers[-1].weight, std=1e-3)
        nn.init.zeros_(self.layers[-1].bias)

    @property
    def modulation_size(self) -> int:
        """Numbers of modulation this network takes."""
        return 2 * sum(layer.out_features for layer in self.layers[:-1] if layer.bias is not None)

    def forward(self, x: torch.Tensor, modulation: torch.Tensor) -> torch.Tensor:
        """x: (B, in). modulation: (B, modulation_size). Returns (B, out)."""
        return self.layers[-1](self.last_hidden(x, modulation))

    def last_hidden(self, x: torch.Tensor, modulation: torch.Tensor) -> torch.Tensor:
        """What the linear layer reads, (B, hidden)."""
        start = 0
        for layer in self.layers[:-1]:
            if layer.bias is None:
                x = layer(x)
                continue
            scale, shift = modulation[:, start : start + 2 * layer.out_features].chunk(2, dim=-1)
            x = functional.silu(torch.addcmul(shift, 1 + scale, layer(x)))
            start += 2 * layer.out_features
        return x


class DetailNetwork(nn.Module):
    """The node deformer's last hidden activations to offsets of detail nodes (see `physkin_core.model.detail`); those
    begin near zero."""

    def __init__(self, hidden: int, features: int, nodes: int) -> None:
        super().__init__()
        self.features = nn.Linear(hidden, features)
        self.offsets = nn.Linear(features, 3 * nodes, bias=False)
        nn.init.normal_(self.offsets.weight, std=1e-6)

    def forward(self, hidden: torch.Tensor) -> torch.Tensor:
        """(B, h) to offsets (B, D, 3) [m]."""
        return self.offsets(functional.silu(self.features(hidden))).unflatten(1, (-1, 3))


class HyperModulator(nn.Module):
    """Body points to modulation of the pose modulator, which the fit and how stiffly the cloth bends shift."""

    def __init__(self, config: NetworkConfig, outputs: int) -> None:
        super().__init__()
        width = config.token_width
        self.embed = nn.Linear(token_features(), width)
        self.attention = nn.ModuleDict({"input": nn.Linear(width, 3 * width), "output": nn.Linear(width, width)})
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.feed_forward = nn.ModuleList(
            [nn.Linear(width, config.feed_forward), nn.Linear(config.feed_forward, width)]
        )
        self.pool = nn.Linear(width, 1)
        self.residual = nn.ModuleList(
            nn.ModuleDict(
                {"norm": nn.LayerNorm(width), "0": nn.Linear(width, 2 * width), "1": nn.Linear(2 * width, width)}
            )
            for _ in range(config.residual_blocks)
        )
        self.output = nn.Linear(width, outputs)
        nn.init.normal_(self.output.weight, std=1e-2)
        nn.init.zeros_(self.output.bias)
        self.fit, self.bend = nn.Parameter(torch.zeros(width)), nn.Parameter(torch.zeros(width))

    def forward(
        self,
        points: torch.Tensor,
        normals: torch.Tensor,
        fit: torch.Tensor | None = None,
        bending: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """points, normals: (S, N, 3), canonical pose [m]. fit: (S,), 0 (the template) to 1 (made to measure), default
        0. bending: (S,), see `physkin_core.model.hyper_modulator.bending_code`, default 0. Returns (S, outputs)."""
        bodies, count, _ = points.shape
        tokens = self.embed(encode_points(points, normals))
        if fit is not None:
            tokens = tokens + fit[:, None, None] * self.fit
        if bending is not None:
            tokens = tokens + bending[:, None, None] * self.bend
        projected = self.attention["input"](tokens).view(bodies, count, 3, HEADS, -1)
        query, key, value = projected.permute(2, 0, 3, 1, 4)
        if tokens.is_cuda:  # the fused attention kernel takes half-width numbers
            attended = functional.scaled_dot_product_attention(
                query.bfloat16().contiguous(), key.bfloat16().contiguous(), value.bfloat16().contiguous()
            ).float()
        else:
            attended = functional.scaled_dot_product_attention(query, key, value)
        attended = attended.transpose(1, 2).reshape(bodies, count, -1)
        tokens = self.norm_1(tokens + self.attention["output"](attended))
        tokens = self.norm_2(tokens + self.feed_forward[1](functional.relu(self.feed_forward[0](tokens))))
        body = (torch.softmax(self.pool(tokens), dim=1) * tokens).sum(dim=1)
        for block in self.residual:
            body = body + block["1"](functional.relu(block["0"](block["norm"](body))))
        return self.output(body)


class Networks(nn.Module):
    """The three networks chained: (body points, pose vector, posed garment nodes) -> raw delta-chi.

    The node deformer sees node transforms shifted and scaled to about unit variance (`normalise_nodes`); the model file
    holds its first layer with both folded in. `detail`: None of a garment that has none.
    """

    def __init__(
        self, config: NetworkConfig, *, pose_size: int, node_count: int, detail: DetailNodeSet | None = None
    ) -> None:
        super().__init__()
        numbers = 12 * node_count
        self.node_deformer = ModulatedMLP(numbers, config.deformer_widths, numbers)
        self.pose_modulator = ModulatedMLP(
            pose_size,
            [config.pose_hidden] * config.pose_layers,
            self.node_deformer.modulation_size,
            rank=config.pose_rank,
        )
        self.hyper_modulator = HyperModulator(config, self.pose_modulator.modulation_size)
        drapes = config.deformer_widths[-1]
        self.detail = None if detail is None else DetailNetwork(drapes, detail.features, detail.count)
        nn.init.normal_(self.pose_modulator.layers[-1].weight, std=1e-2)
        self.register_buffer("node_mean", torch.zeros(12 * node_count))
        self.register_buffer("node_scale", torch.ones(12 * node_count))

    def normalise_nodes(self, posed_nodes: torch.Tensor) -> None:
        """Take mean and spread of the node deformer's inputs from posed garment nodes (B, m, 3, 4). Numbers that hardly
        vary are left out: scaled up, their rounding would be noise."""
        inputs = posed_nodes.flatten(1)
        spread = inputs.std(dim=0)
        self.node_mean.copy_(inputs.mean(dim=0))
        self.node_scale.copy_(torch.where(spread < 0.01, 0.0, 1 / spread.clamp_min(0.1)))

    def output_units(self) -> dict[nn.Parameter, torch.Tensor]:
        """Units in which to learn last layers, by parameter, for it to be multiplied by. A metre more moves cloth by a
        metre, one more in a linear part by some centimetres: steps of equal length would be far too long for the one or
        too short for the other."""
        last = self.node_deformer.layers[-1]
        of_node = torch.tensor([LINEAR_UNIT] * 9 + [SHIFT_UNIT] * 3, device=last.weight.device)
        rows = of_node.repeat(last.out_features // len(of_node))
        units = {last.weight: rows[:, None], last.bias: rows}
        if self.detail is not None:
            units[self.detail.offsets.weight] = torch.tensor(SHIFT_UNIT, device=rows.device)
        return units

    def folded_first_layer(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight and bias of the node deformer's first layer over node transforms as they are."""
        first = self.node_deformer.layers[0]
        weight = first.weight * self.node_scale
        return weight, first.bias - weight @ self.node_mean

    def forward(
        self, body_modulation: torch.Tensor, pose_vector: torch.Tensor, posed_nodes: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """body_modulation: (B, s). pose_vector: (B, p). posed_nodes: (B, m, 3, 4). Returns (B, m, 12), and offsets of
        detail nodes (B, D, 3) [m], None of a garment without any."""
        modulation = self.pose_modulator(pose_vector, body_modulation)
        inputs = (posed_nodes.flatten(1) - self.node_mean) * self.node_scale
        hidden = self.node_deformer.last_hidden(inputs, modulation)
        raw = self.node_deformer.layers[-1](hidden).unflatten(1, (posed_nodes.shape[1], -1))
        return raw, None if self.detail is None else self.detail(hidden)


def encode_points(points: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """Positional encoding (B, N, `token_features`) of points and normals (B, N, 3): x, sin(2^k pi x), cos(2^k pi x) for
    k < 6, and the normal."""
    frequencies = torch.pi * 2.0 ** torch.arange(ENCODING_FREQUENCIES, device=points.device, dtype=points.dtype)
    angles = (points[..., None] * frequencies).flatten(-2)
    return torch.cat([points, angles.sin(), angles.cos(), normals], dim=-1)
