"""Export to the garment model file and back into torch, with a check of what that costs.

Dimensions: `n` garment vertices, `K` influences, `m` garment nodes.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.detail import Detail
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.garment_model import GarmentModel, Material
from physkin_core.model.hyper_modulator import POINT_COUNT
from physkin_core.model.mlp import Layer, float32_layers, fold_modulation
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.rig.rig import Rig
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.body_encoder import encode_body
from physkin_core.runtime.evaluator import drape_poses
from physkin_core.runtime.garment_on_body import put_on_body
from physkin_training.config import NetworkConfig
from physkin_training.networks.draping import Drape, RestShape
from physkin_training.networks.garment_nodes import DetailNodeSet, GarmentNodeSet
from physkin_training.networks.networks import ModulatedMLP
from physkin_training.sampling.posed_bodies import BodySet

__all__ = [
    "Agreement",
    "ExportError",
    "agreement",
    "drape_from_model",
    "encode_bodies",
    "model_from_drape",
    "network_config",
    "store_checked",
]

log = logging.getLogger(__name__)
EXPORT_TOLERANCE = 2e-2
"""Largest distance [m] that rounding in the file and pruning may move a vertex of the trained drape, in poses anywhere
in the joint limits: there cloth in folds moves by up to 14 mm for files of 2 MB, in everyday motion by 1 mm."""
TWIN_TOLERANCE = 1e-3
"""Largest distance [m] allowed between the stored model's drape at run time and in torch."""


class ExportError(ValueError):
    """A model file drapes otherwise than what it was made of."""


def model_from_drape(
    drape: Drape,
    garment: Garment,
    rig: Rig,
    *,
    name: str,
    influences: int,
    engine_influences: int,
    material: Material,
    training: Mapping | None = None,
) -> GarmentModel:
    """The garment model of a trained drape, pruned to the `influences` strongest garment nodes a vertex.
    engine_influences: those of its skinning weights for engines. Rest normals are those of the mesh."""
    own = drape.influence_nodes
    nodes, weights = _strongest(own, drape.skinning_weights, influences)
    engine_nodes, engine_weights = _strongest(own, drape.engine_weights, engine_influences)
    networks = {key: tensor.detach().cpu().numpy() for key, tensor in drape.networks.state_dict().items()}
    hyper = {
        key.removeprefix("hyper_modulator."): array
        for key, array in networks.items()
        if key.startswith("hyper_modulator.")
    }
    return GarmentModel(
        name=name,
        rig=rig,
        garment=garment,
        rest_normals=vertex_normals(garment.vertices, garment.faces).astype(np.float32),
        node_rest=drape.node_rest.cpu().numpy(),
        node_bone=drape.node_bone.cpu().numpy().astype(np.int32),
        influence_nodes=nodes,
        influence_weights=weights,
        engine_nodes=engine_nodes,
        engine_weights=engine_weights,
        hyper_modulator=hyper,
        pose_modulator=_layers(drape.networks.pose_modulator),
        node_deformer=(_numpy(*drape.networks.folded_first_layer()), *_layers(drape.networks.node_deformer)[1:]),
        detail=_detail(drape),
        material=material,
        training=training or {},
    )


def _detail(drape: Drape) -> Detail | None:
    if not drape.has_detail:
        return None
    nodes, weights = _strongest(drape.detail_nodes, drape.detail_weights, drape.detail_nodes.shape[1])
    network = drape.networks.detail
    return Detail(
        features=_numpy(network.features.weight, network.features.bias),
        offsets=network.offsets.weight.detach().cpu().numpy(),
        nodes=nodes,
        weights=weights,
    )


def drape_from_model(model: GarmentModel) -> Drape:
    """The torch drape of a garment model (for evaluation, or to train on); its skinning weights for engines are the
    model's others."""
    detail = model.detail
    state = {f"hyper_modulator.{key}": array for key, array in model.hyper_modulator.items()}
    if detail is not None:
        state |= {"detail.features.weight": detail.features[0], "detail.features.bias": detail.features[1]}
        state["detail.offsets.weight"] = detail.offsets
    nodes, detail_nodes = GarmentNodeSet.of_model(model), DetailNodeSet.of_model(model)
    drape = Drape(model.garment, nodes, model.rig, network_config(model), detail_nodes)
    for network in ("pose_modulator", "node_deformer"):
        for index, (weight, bias) in enumerate(getattr(model, network)):
            state |= {f"{network}.layers.{index}.weight": weight}
            state |= {f"{network}.layers.{index}.bias": bias} if len(bias) else {}
    as_tensors = {key: torch.as_tensor(np.array(array)) for key, array in state.items()}
    drape.networks.load_state_dict(drape.networks.state_dict() | as_tensors)
    drape.influence_bias.masked_fill_(torch.as_tensor(model.influence_weights == 0), float("-inf"))
    return drape


def network_config(model: GarmentModel) -> NetworkConfig:
    """Sizes of a garment model's networks."""
    blocks = sum(key.endswith(".norm.weight") and key.startswith("residual") for key in model.hyper_modulator)
    hidden, *_, drapes, _ = [len(bias) for _, bias in (model.node_deformer[0], *model.node_deformer)]
    projections = [weight for weight, bias in model.pose_modulator if not len(bias)]
    return NetworkConfig(
        pose_hidden=len(model.pose_modulator[0][1]),
        pose_layers=len(model.pose_modulator) - len(projections) - 1,
        pose_rank=len(projections[0]) if projections else 0,
        deformer_hidden=hidden,
        deformer_layers=len(model.node_deformer) - 1,
        drapes=0 if drapes == hidden else drapes,
        token_width=len(model.hyper_modulator["embed.bias"]),
        feed_forward=len(model.hyper_modulator["feed_forward.0.bias"]),
        residual_blocks=blocks,
    )


def encode_bodies(
    drape: Drape, vertices: np.ndarray, faces: np.ndarray, *, fit: float = 0.0, points: int = POINT_COUNT
) -> torch.Tensor:
    """Body modulations (S, s) of bodies (S, V, 3), by default from the same surface points as the run time takes. fit:
    of the garment."""
    device = drape.node_rest.device
    fits = torch.full((1,), fit, device=device) if fit else None
    modulations = []
    with torch.no_grad():
        for body in vertices:
            surface = sample_surface(body, faces, points)
            pair = [torch.as_tensor(part, dtype=torch.float32, device=device)[None] for part in surface]
            modulations.append(drape.networks.hyper_modulator(*pair, fits))
    return torch.cat(modulations)


@dataclass(frozen=True)
class Agreement:
    """Distance [m] between two drapes of the same vertices and poses: the largest, and the mean."""

    largest: float
    mean: float


def agreement(model: GarmentModel, drape: Drape, *, poses: int = 8) -> Agreement:
    """How far the run time's drape of `model`, with network weights in fp32, is from the torch `drape`, on random poses
    of a held-out body, every second one made to measure, with the rest shape that the run time finds; without contact
    and with pose modulators of full rank, which the run time narrows for each body.

    With the trained drape this is what pruning and rounding in the file cost; with `drape_from_model(model)` it tells
    whether run time and torch compute the same.
    """
    body_model = load_body_model()
    avatar = avatar_from_body(body_model, body_model.held_out_bodies[0])
    rig, device = model.rig, drape.node_rest.device
    generator = np.random.default_rng(0)
    distances = []
    fits = (0.0, 1.0)
    worn = [bind_garment(model, avatar, fit=fit).without_contact for fit in fits]
    for index, fit in enumerate(fits):
        encoded = encode_body(model, put_on_body(model, avatar, fit).seen, fit=fit)
        full = float32_layers(fold_modulation(model.pose_modulator, encoded))
        worn[index] = replace(worn[index], pose_layers=full)

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32, device=device)[None]

    with torch.no_grad():
        modulations = [encode_bodies(drape, avatar.vertices[None], avatar.faces, fit=fit) for fit in fits]
        carried = drape.node_positions(BodySet(body_model, body_model.held_out_bodies[:1], device))
        for pose in range(poses):
            index = pose % len(fits)
            bound, modulation = worn[index], modulations[index]
            node_positions, rest = carried, None
            if index:
                node_positions = tensor(bound.node_positions)
                rest = RestShape(tensor(bound.vertices), tensor(bound.node_rest))
            positions = generator.uniform(rig.lower, rig.upper).astype(np.float32)
            gravity = generator.normal(size=3)
            gravity = (gravity / np.linalg.norm(gravity)).astype(np.float32)
            arrays = (rig.bone_transforms(positions, heads=avatar.bone_heads), positions, gravity)
            bones, q, g = (tensor(array) for array in arrays)
            there = drape(modulation, q, g, drape.posed_nodes(bones, node_positions), rest)[0].cpu().numpy()
            (here,) = drape_poses(bound, [(positions, gravity)], precision="fp32")
            distances.append(np.linalg.norm(here[:, :3] - there, axis=1))
    return Agreement(float(np.max(distances)), float(np.mean(distances)))


def store_checked(model: GarmentModel, drape: Drape, path: Path) -> GarmentModel:
    """Write the model of a trained drape as `path`, and read it again: what is returned.

    Raises ExportError when it drapes otherwise; the file is then left as PATH.unchecked.
    """
    unchecked = path.with_suffix(".unchecked")
    save_garment_model(model, unchecked)
    stored = load_garment_model(unchecked)
    cost, twin = agreement(stored, drape), agreement(stored, drape_from_model(stored))
    moved = "%s %.3f mm at most, %.4f mm on average"
    log.info(moved, "rounding in the file and pruning move vertices by", 1e3 * cost.largest, 1e3 * cost.mean)
    log.info(moved, "run time and torch agree to", 1e3 * twin.largest, 1e3 * twin.mean)
    for difference, allowed, other in (
        (cost, EXPORT_TOLERANCE, "the trained drape"),
        (twin, TWIN_TOLERANCE, "the same model in torch"),
    ):
        if not difference.largest <= allowed:
            raise ExportError(
                f"the exported model drapes {1000 * difference.largest:.2f} mm away from {other}, allowed "
                f"{1000 * allowed:g} mm; it is left as {unchecked}"
            )
    unchecked.replace(path)
    return stored


def _strongest(nodes: torch.Tensor, weights: torch.Tensor, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` strongest influences (n, count), of nodes (n, K) with weights (n, K), by the index of their node: the
    same in the same order for neighbours, which takes little room in a file."""
    weights = weights.detach().cpu().numpy()
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    order = np.take_along_axis(order, np.take_along_axis(nodes.cpu().numpy(), order, axis=1).argsort(axis=1), axis=1)
    kept = np.take_along_axis(weights, order, axis=1)
    strongest = np.take_along_axis(nodes.cpu().numpy(), order, axis=1).astype(np.int32)
    return strongest, kept / kept.sum(axis=1, keepdims=True)


def _layers(network: ModulatedMLP) -> tuple:
    return tuple(_numpy(layer.weight, layer.bias) for layer in network.layers)


def _numpy(weight: torch.Tensor, bias: torch.Tensor | None) -> Layer:
    """A layer; of a projection, whose bias is None, with an empty one."""
    bias = weight.new_empty(0) if bias is None else bias
    return weight.detach().cpu().numpy(), bias.detach().cpu().numpy()
