"""A new run from a garment model file: its networks and skinning weights, taken back into the drape in training.

A model that was pruned to few influences may go on with more of them.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.model.garment_model import GarmentModel
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import drape_from_model

__all__ = ["take_over_model"]

NEW_INFLUENCE = 1e-3
"""Skinning weight that an influence the model does not have begins with."""
OWN_BUFFERS = ("node_mean", "node_scale")
"""How a run shifts and scales its inputs; the model's are folded into its first layer."""
FIRST_LAYER = "node_deformer.layers.0"
SAME = 1e-4
"""Rest positions [m] that differ by less are the same: the file holds half precision."""


def take_over_model(model: GarmentModel, drape: Drape) -> dict:
    """Give `drape` the networks and skinning weights of `model`. Returns plain data on how the model was trained.

    Raises ValueError when the model is of another garment, other garment nodes or other network sizes.
    """
    learnt = drape_from_model(model)
    for name in ("vertices", "node_rest"):
        own, other = getattr(drape, name).cpu(), getattr(learnt, name)
        if own.shape != other.shape or not torch.allclose(own, other, rtol=0, atol=SAME):
            raise ValueError(f"cannot start from model {model.name!r}: its {name.replace('_', ' ')} differ")
    state = {name: tensor for name, tensor in learnt.networks.state_dict().items() if name not in OWN_BUFFERS}
    state |= _unfolded(drape, state[f"{FIRST_LAYER}.weight"], state[f"{FIRST_LAYER}.bias"])
    own = drape.networks.state_dict()
    for name, tensor in state.items():
        if name not in own or own[name].shape != tensor.shape:
            expected = tuple(own[name].shape) if name in own else "none"
            raise ValueError(
                f"cannot start from model {model.name!r}: {name} is {tuple(tensor.shape)}, expected {expected}"
            )
    drape.networks.load_state_dict(own | state)
    if learnt.has_detail:
        _take_over_detail(learnt, drape)
    influences = drape.influence_nodes.cpu().numpy()
    with torch.no_grad():
        drape.skinning_logits.copy_(torch.as_tensor(_logits(model, influences)))
        drape.engine_logits.copy_(torch.as_tensor(_logits(model.for_engines(), influences)))
    return {"model": model.name} | dict(model.training)


def _take_over_detail(learnt: Drape, drape: Drape) -> None:
    """Weights of detail nodes; the influences of the model's file come strongest first, in the run's own order here."""
    known = torch.zeros(len(drape.vertices), len(learnt.networks.detail.offsets.weight) // 3)
    known.scatter_(1, learnt.detail_nodes, learnt.detail_weights.detach())
    with torch.no_grad():
        drape.detail_logits.copy_(known.gather(1, drape.detail_nodes.cpu()).clamp_min(NEW_INFLUENCE).log())


def _unfolded(drape: Drape, weight: torch.Tensor, bias: torch.Tensor) -> dict[str, torch.Tensor]:
    """The node deformer's first layer over inputs shifted and scaled as the drape's are (`normalise_nodes`)."""
    mean, scale = drape.networks.node_mean.cpu(), drape.networks.node_scale.cpu()
    scaled = torch.where(scale > 0, weight / scale.clamp_min(1e-12), 0.0)
    return {f"{FIRST_LAYER}.weight": scaled, f"{FIRST_LAYER}.bias": bias + weight @ mean}


def _logits(model: GarmentModel, influence_nodes: np.ndarray) -> np.ndarray:
    """Logits (n, K) of the model's skinning weights at the drape's influences (n, K)."""
    dense = np.zeros((len(model.garment.vertices), len(model.node_rest)), dtype=np.float32)
    np.put_along_axis(dense, model.influence_nodes, model.influence_weights, axis=1)
    return np.log(np.maximum(np.take_along_axis(dense, influence_nodes, axis=1), NEW_INFLUENCE))
