"""Network weights rounded to eight bits, what each loses made up for by those after it (GPTQ, Frantar et al. 2023).

The native evaluator computes in eight bits with a scale a row; rounded one by one, network weights would move vertices
three times as far as in bf16. Inputs of a layer hang together, so that other network weights of a row can take over
what rounding one of them adds, over the poses of everyday life. What is stored is on the evaluator's own steps, so that
it rounds nothing again. The first layers, which read pose vector and bones, stay as they are; it keeps them in bf16.

Dimensions: `k` inputs of a layer, `o` its outputs, `F` frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.detail import Detail
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.mlp import Layer, layer_inputs, silu
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.rig.rig import Rig, forward_kinematics, pose_vector
from physkin_core.runtime.binding import bind_garment

__all__ = ["STEPS", "compensated_rounding", "rounded_model"]

STEPS = 127
"""Of the largest network weight of a row, as native/src/kernels/packed_layer.cpp rounds."""
DAMPING = 0.02
"""Of the inputs' mean square, added to each, so that what frames do not tell stays as it was."""
BODIES, EVERY, FARTHER = 6, 6, 250
"""Training bodies; of each clip's frames one in so many; and poses between those and any in the joint limits."""


def compensated_rounding(weight: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """A network weight (o, k) in whole steps of its row, close to it over inputs (F, k): (o, k) float32.

    Column by column, the strongest inputs first; a row's largest stays, for it tells the size of its steps.
    """
    square = inputs.T @ inputs / len(inputs)
    order = np.argsort(-np.diag(square), kind="stable")
    square = square[np.ix_(order, order)] + DAMPING * np.trace(square) / len(square) * np.eye(len(square))
    takes_over = np.linalg.cholesky(np.linalg.inv(square)).T
    left = weight[:, order].astype(np.float64)
    largest = np.abs(left).argmax(axis=1)
    most = np.take_along_axis(left, largest[:, None], axis=1)[:, 0]
    step = np.maximum(np.abs(most), 1e-30) / STEPS
    rounded = np.empty_like(left)
    for column in range(len(order)):
        whole = step * np.clip(np.rint(left[:, column] / step), -STEPS, STEPS)
        rounded[:, column] = np.where(largest == column, most, whole)
        lost = (left[:, column] - rounded[:, column]) / takes_over[column, column]
        left[:, column:] -= lost[:, None] * takes_over[column, column:]
    return np.ascontiguousarray(rounded[:, np.argsort(order)], dtype=np.float32)


def rounded_model(model: GarmentModel, *, seed: int = 0) -> GarmentModel:
    """The model with all but the first layers of both run-time networks rounded, over drapes on training bodies.

    Raises ValueError for another rig than the body model's."""
    body_model = load_body_model()
    if model.rig.to_json() != body_model.rig.to_json():
        raise ValueError("network weights are rounded over the body model's poses; this garment has another rig")
    random = np.random.default_rng(seed)
    pose_inputs, deformer_inputs = [], []
    for body in random.choice(len(body_model.train_bodies), BODIES, replace=False):
        avatar = avatar_from_body(body_model, body_model.train_bodies[body])
        bound = bind_garment(model, avatar)
        positions, gravity = _poses(model.rig, random)
        poses = pose_vector(positions, model.rig.lower, model.rig.upper, gravity)
        bones = np.stack(
            [
                forward_kinematics(
                    bound.bone_parents, bound.bone_heads, bound.dof_bone, bound.dof_axis, q - bound.dof_rest
                )
                for q in positions
            ]
        )
        *of_poses, modulation = layer_inputs(bound.pose_layers, poses, None)
        chi = bones[:, bound.deformer_bones].reshape(len(bones), -1)
        *of_bones, _ = layer_inputs(bound.deformer_layers, chi, modulation)
        pose_inputs.append(of_poses)
        deformer_inputs.append(of_bones)
    hidden = np.concatenate([of_layers[-1] for of_layers in deformer_inputs])
    return replace(
        model,
        pose_modulator=_rounded(model.pose_modulator, pose_inputs),
        node_deformer=_rounded(model.node_deformer, deformer_inputs),
        detail=None if model.detail is None else _rounded_detail(model.detail, hidden),
    )


def _rounded_detail(detail: Detail, hidden: np.ndarray) -> Detail:
    """hidden: (F, h) what features are made of."""
    weight, bias = detail.features
    weight = compensated_rounding(weight, hidden)
    offsets = compensated_rounding(detail.offsets, silu(hidden @ weight.T + bias))
    return replace(detail, features=(weight, bias), offsets=offsets)


def _rounded(layers: Sequence[Layer], inputs: Sequence[Sequence[np.ndarray]]) -> tuple[Layer, ...]:
    """Layers with all but the first rounded. inputs: of each body, of each layer (F, k)."""
    first, *others = layers
    return first, *(
        (compensated_rounding(weight, np.concatenate([body[k] for body in inputs])), bias)
        for k, (weight, bias) in enumerate(others, start=1)
    )


def _poses(rig: Rig, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (F, d) [rad] and gravity (F, 3): everyday ones, of clips, and others less and less like them."""
    positions, gravity = (np.asarray(each) for each in everyday_poses(rig))
    clips = [load_motion(name) for name in bundled_motions()]
    positions = np.concatenate([positions, *(clip.positions_for(rig)[::EVERY] for clip in clips)])
    gravity = np.concatenate([gravity, *(clip.gravity[::EVERY] for clip in clips)])
    near = random.integers(len(positions), size=FARTHER)
    anywhere = rig.lower + random.random((FARTHER, len(rig.lower))) * (rig.upper - rig.lower)
    farther = positions[near] + random.random((FARTHER, 1)) * (anywhere - positions[near])
    return np.concatenate([positions, farther]), np.concatenate([gravity, gravity[near]])
