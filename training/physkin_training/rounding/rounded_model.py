"""A garment model with its large networks rounded so that drapes of training bodies in everyday poses stay close.

Each layer makes up for what rounding the layers before it did to its inputs. The pose modulator's first layer and small
layers of the encoder are not rounded.

Dimensions: `k` inputs of a layer, `o` its outputs, `F` frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import ADULT_STATURE, BodyModel, load_body_model
from physkin_core.model.detail import Detail
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import BENDING_OCTAVES, bending_code
from physkin_core.model.mlp import Layer, silu, split_modulation
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.rig.rig import Rig, pose_vector
from physkin_core.runtime.garment_on_body import put_on_body
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.rounding.compensated_rounding import (
    InputSquares,
    Rounding,
    compensated_rounding,
    mean_square,
)
from physkin_training.rounding.rounded_sway import rounded_sway
from physkin_training.sampling.everyday_poses import EverydayPoses

__all__ = ["rounded_model"]

BODIES, EVERY, EVERYDAY, FARTHER = 12, 12, 300, 300
"""How many training bodies; one of how many frames of each clip; how many everyday poses are drawn, and how many poses
between all those and any within the joint limits."""
ENCODED_BODIES, ENCODED_POINTS, AT_ONCE = 256, 512, 16
"""How many training bodies the encoder reads, at both fits and some with other bending: many, because its last layers
read only one vector of each. How many points of each, an eighth of the usual number, which is enough for the other
layers. How many bodies at a time."""
POSE_HIDDEN, POSE_LAST = Rounding(12), Rounding(16, alike=True)
POSE_OF_LOW_RANK = Rounding(3), Rounding(4, alike=True)
"""What few numbers pass through has no others that could make up for it."""
DEFORMER_FIRST, DEFORMER_HIDDEN, DEFORMER_LAST = Rounding(32, four=True, damping=1e-4), Rounding(3), Rounding(3)
FEATURES, OFFSETS = Rounding(2), Rounding(2, alike=True)
ENCODER, ENCODER_OUTPUT = Rounding(24), Rounding(48)
LEAST_ROUNDED = 2**13
"""Layers of the encoder with fewer network weights are not rounded; neither is the one that reads points."""


def rounded_model(
    model: GarmentModel, *, device: torch.device | str = "cpu", seed: int = 0, finely: bool = False
) -> GarmentModel:
    """The model with its networks rounded. device: where bodies are encoded. finely: to each of the evaluator's steps,
    which moves cloth less and makes a larger file. Raises ValueError for another rig than the body model's."""
    body_model = load_body_model()
    if model.rig.to_json() != body_model.rig.to_json():
        raise ValueError("network weights are rounded over the body model's poses; this garment has another rig")
    random = np.random.default_rng(seed)
    every = 1 if finely else None
    encoder = dict(model.hyper_modulator)
    for name, square in _encoder_squares(model, body_model, device, random).items():
        rounding = ENCODER_OUTPUT if name == "output.weight" else ENCODER
        encoder[name] = compensated_rounding(encoder[name], square, rounding.at(every))
    rounded = replace(model, hyper_modulator=encoder)
    frames = _frames(model, rounded, body_model, device, random)
    pose = _Pass(frames.poses, frames.poses, every)
    full_rank = all(len(bias) for _, bias in model.pose_modulator)
    plan = (None, *((POSE_HIDDEN, POSE_LAST) if full_rank else POSE_OF_LOW_RANK))
    pose_layers = _rounded(model.pose_modulator, pose, (frames.exact_modulation, frames.modulation), plan)
    deformer = _Pass(frames.nodes, frames.nodes, every)
    plan = (DEFORMER_FIRST, DEFORMER_HIDDEN, DEFORMER_LAST)
    deformer_layers = _rounded(model.node_deformer, deformer, (pose.exact, pose.rounded), plan)
    detail = None if model.detail is None else _rounded_detail(model.detail, deformer.before_last())
    sway = None if model.sway is None else rounded_sway(model.sway, model.rig)
    return replace(rounded, pose_modulator=pose_layers, node_deformer=deformer_layers, detail=detail, sway=sway)


@dataclass
class _Pass:
    """The inputs (F, k) of the next layer, in the exact network and in the rounded one. every: see `Rounding.at`."""

    exact: np.ndarray
    rounded: np.ndarray
    every: int | None = None
    _before: tuple[np.ndarray, np.ndarray] | None = None

    def before_last(self) -> _Pass:
        """The inputs of the layer before."""
        return _Pass(*self._before, self.every)

    def round(self, weight: np.ndarray, rounding: Rounding | None) -> np.ndarray:
        """The weight (o, k) rounded, so that rounded inputs give what exact inputs gave before."""
        if rounding is None:
            return weight
        exact, given = self.exact.astype(np.float64), self.rounded.astype(np.float64)
        square = given.T @ given / len(given)
        damping = rounding.damping * mean_square(square) * np.eye(len(square))
        wanted = weight @ (exact.T @ given / len(given) + damping)
        return compensated_rounding(np.linalg.solve(square + damping, wanted.T).T, square, rounding.at(self.every))

    def go_on(self, exact: np.ndarray, rounded: np.ndarray) -> None:
        self._before = (self.exact, self.rounded)
        self.exact, self.rounded = exact, rounded


def _rounded(
    layers: Sequence[Layer],
    on: _Pass,
    modulations: tuple[np.ndarray, np.ndarray],
    plan: tuple[Rounding | None, Rounding, Rounding],
) -> tuple[Layer, ...]:
    """Layers rounded by the plan for the first, the hidden and the last of them. Afterwards `on` holds the outputs of
    the last. modulations: (F, s) of the exact and of the rounded networks."""
    first, hidden, last = plan
    plans = [first, *[hidden] * (len(layers) - 2), last]
    result = []
    parts = zip(*(split_modulation(layers, modulation) for modulation in modulations), strict=True)
    for (weight, bias), rounding in zip(layers, plans, strict=True):
        rounded = on.round(weight, rounding)
        result.append((rounded, bias))
        offset = bias if len(bias) else 0.0
        outputs = [on.exact @ weight.T + offset, on.rounded @ rounded.T + offset]
        part = next(parts, None)
        if part and len(bias):
            outputs = [silu((1 + scale) * x + shift) for x, (scale, shift) in zip(outputs, part)]
        on.go_on(*outputs)
    return tuple(result)


def _rounded_detail(detail: Detail, hidden: _Pass) -> Detail:
    """The detail with its layers rounded. hidden: the inputs of its features."""
    weight, bias = detail.features
    rounded = hidden.round(weight, FEATURES)
    hidden.go_on(silu(hidden.exact @ weight.T + bias), silu(hidden.rounded @ rounded.T + bias))
    return replace(detail, features=(rounded, bias), offsets=hidden.round(detail.offsets, OFFSETS))


@dataclass(frozen=True)
class _Frames:
    """poses (F, p), posed garment nodes (F, 12 m), and modulations of the pose modulator (F, s), from the exact encoder
    and from the rounded one."""

    poses: np.ndarray
    nodes: np.ndarray
    exact_modulation: np.ndarray
    modulation: np.ndarray


def _frames(
    model: GarmentModel,
    rounded: GarmentModel,
    body_model: BodyModel,
    device: torch.device | str,
    random: np.random.Generator,
) -> _Frames:
    """Frames of training bodies, every second adult's and every child's made to measure."""
    rig, drapes = model.rig, [drape_from_model(each).to(device) for each in (model, rounded)]
    small = body_model.statures(body_model.train_bodies) < ADULT_STATURE
    parts = []
    for index, body in enumerate(random.choice(len(small), BODIES, replace=False)):
        fit = float(index % 2 or small[body])
        avatar = avatar_from_body(body_model, body_model.train_bodies[body])
        worn = put_on_body(model, avatar, fit)
        positions, gravity = _poses(rig, random)
        nodes = rig.bone_transforms(positions, heads=avatar.bone_heads)[:, model.node_bone]
        nodes[..., 3] += np.einsum("fmij,mj->fmi", nodes[..., :3], worn.node_positions)
        poses = pose_vector(positions, rig.lower, rig.upper, gravity)
        encoded = [encode_bodies(drape, avatar.vertices[None], avatar.faces, fit=fit).cpu().numpy() for drape in drapes]
        modulations = (np.repeat(modulation, len(poses), axis=0) for modulation in encoded)
        parts.append((poses, nodes.reshape(len(nodes), -1), *modulations))
    return _Frames(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _encoder_squares(
    model: GarmentModel, body_model: BodyModel, device: torch.device | str, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Means of products (k, k) of the inputs, over training bodies, of the hyper modulator's layers that are rounded,
    by the names of their weights."""
    encoder = drape_from_model(model).to(device).networks.hyper_modulator
    layers = {
        name: layer for name, layer in encoder.named_modules() if isinstance(layer, nn.Linear) and name != "embed"
    }
    large = {f"{name}.weight": layer for name, layer in layers.items() if layer.weight.numel() >= LEAST_ROUNDED}
    squares = InputSquares(large)
    softest, stiffest = (bending_code(2.0**octave) for octave in BENDING_OCTAVES)
    bodies = random.permutation(len(body_model.train_bodies))[:ENCODED_BODIES]
    for some in np.array_split(bodies, -(-len(bodies) // AT_ONCE)):
        shapes = [body_model.vertices(body_model.train_bodies[body]) for body in some]
        surfaces = [sample_surface(shape, body_model.faces, ENCODED_POINTS) for shape in shapes]
        fits = random.integers(0, 2, size=len(some))
        bending = random.uniform(softest, stiffest, size=len(some)) * random.integers(0, 2, size=len(some))
        given = (*(np.stack(part) for part in zip(*surfaces, strict=True)), fits, bending)
        with torch.no_grad():
            encoder(*(torch.as_tensor(part, dtype=torch.float32, device=device) for part in given))
    return squares.means()


def _poses(rig: Rig, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (F, d) [rad] and gravity (F, 3): everyday poses, frames of clips, and poses farther from both."""
    clips = [load_motion(name) for name in bundled_motions()]
    drawn = EverydayPoses(rig, torch.device("cpu")).sample(
        EVERYDAY, generator=torch.Generator().manual_seed(int(random.integers(1 << 31)))
    )
    known = (everyday_poses(rig), *((clip.positions_for(rig)[::EVERY], clip.gravity[::EVERY]) for clip in clips), drawn)
    positions, gravity = (np.concatenate([np.asarray(each) for each in parts]) for parts in zip(*known, strict=True))
    near = random.integers(len(positions), size=FARTHER)
    anywhere = rig.lower + random.random((FARTHER, len(rig.lower))) * (rig.upper - rig.lower)
    farther = positions[near] + random.random((FARTHER, 1)) * (anywhere - positions[near])
    return np.concatenate([positions, farther]), np.concatenate([gravity, gravity[near]])
