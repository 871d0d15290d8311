"""A garment model without training: plain skinning to the garment nodes, the networks' last layers at zero.

What every trained model is compared with, and a stand-in while a garment is being prepared.
"""

from __future__ import annotations

import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel, Material
from physkin_training.config import NetworkConfig
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import model_from_drape
from physkin_training.networks.garment_nodes import GarmentNodeSet

__all__ = ["plain_model"]


def plain_model(garment: Garment, *, name: str = "plain", nodes: int = 128, influences: int = 8) -> GarmentModel:
    """Garment nodes, heat-method skinning weights and networks that correct nothing."""
    rig = load_body_model().rig
    config = NetworkConfig(pose_hidden=8, pose_layers=1, deformer_hidden=8, deformer_layers=1, token_width=8)
    drape = Drape(garment, GarmentNodeSet.sample(garment, rig, nodes, influences), rig, config)
    torch.nn.init.zeros_(drape.networks.node_deformer.layers[-1].weight)
    sizes = {"influences": influences, "engine_influences": 4}
    return model_from_drape(drape, garment, rig, name=name, material=Material(), **sizes)
