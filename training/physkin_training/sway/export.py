"""A learnt sway network as part of a garment model."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from physkin_core.model.mlp import Layer
from physkin_core.model.sway_network import SwayNetwork
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.modules import SwayModule

__all__ = ["exported"]


def exported(
    network: SwayModule, out: tuple[torch.Tensor, torch.Tensor], joints: np.ndarray, codes: BodyCodes
) -> SwayNetwork:
    """out: weight (12 m, h) and bias (12 m,) of the last layer, to offsets of garment nodes (m, 3, 4).

    joints: (j,) int32, what the network looks at.
    """
    entry = torch.arange(len(out[1]), device=out[1].device).view(-1, 3, 4)
    as_corrections = torch.cat([entry[..., :3].flatten(1), entry[..., 3]], dim=1).flatten()  # (m, 9 + 3)
    weight, bias = (part[as_corrections] for part in out)

    def numpy(tensor: torch.Tensor) -> np.ndarray:
        return np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float32)

    def layer(linear: nn.Linear) -> Layer:
        return numpy(linear.weight), numpy(linear.bias)

    return SwayNetwork(
        joints=joints,
        first=layer(network.first),
        first_code=numpy(network.first_code.weight),
        drive=layer(network.drive),
        gate=layer(network.gate),
        rates=numpy(network.rates),
        turns=numpy(network.turns),
        read=layer(network.read),
        read_code=numpy(network.read_code.weight),
        last=layer(network.last),
        out=(numpy(weight), numpy(bias)),
        code_mean=codes.mean,
        code_directions=codes.directions,
    )
