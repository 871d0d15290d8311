"""The pose modulator with narrower layers: of what a body's hidden units do in all poses, few directions matter.

A network weight W (o, k) becomes A (o, r) B (r, k), a projection B without bias or activation before the layer A. Of
all products of this rank it is the closest to W for the inputs that poses give. A frame then reads two fifths of what
it would of the pose modulator. It is found for one body: other bodies have other directions. Models that were
trained with projections are left as they are.

Dimensions: `F` inputs, `k` inputs of a layer, `o` its outputs, `d` degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.formats.packed_weights import MOST_STEPS_IN_8_BITS
from physkin_core.model.mlp import Layer, silu
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.native_module import as_float32
from physkin_core.rig.rig import Rig, pose_vector
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY

__all__ = ["low_rank_layers"]

DIRECTIONS = 96
"""Of a layer's outputs. Vertices move by up to a millimetre, strain in everyday poses rises by 0.02 points at most."""
POSES = 400
"""Of each kind: with every bone from another everyday pose, and between these and any pose within the joint limits."""


def low_rank_layers(networks: Sequence[Sequence[Layer]], rig: Rig) -> tuple[Layer, ...]:
    """The first of some pose modulators with its wide layers as two, float32.

    networks: float32, the one to be made narrower folded for a body and a fabric; and the same folded for other
    fabrics that it is to serve as well, by a modulation over it.
    """
    if not all(len(bias) for _, bias in networks[0]):
        return tuple(networks[0])
    inputs = [_pose_vectors(rig)] * len(networks)
    layers: list[Layer] = []
    for k, (weight, bias) in enumerate(networks[0]):
        outputs, width = weight.shape
        if DIRECTIONS * (outputs + width) < 0.6 * weight.size:
            directions = _directions(weight, np.concatenate(inputs))
            layers += [(_in_steps(directions.T @ weight), np.empty(0, dtype=np.float32))]
            weight = _in_steps(directions)
        layers.append((weight, bias))
        if k + 1 < len(networks[0]):
            inputs = [silu(x @ network[k][0].T + network[k][1]) for x, network in zip(inputs, networks)]
    return tuple(layers)


def _in_steps(weight: np.ndarray) -> np.ndarray:
    """Rounded as the native evaluator rounds to 8 bits, so that a file needs no more for it."""
    step = np.maximum(np.abs(weight).max(axis=1, keepdims=True) / MOST_STEPS_IN_8_BITS, 1e-30).astype(np.float32)
    step = (step.view(np.int32) & ~0x7F).view(np.float32)  # so that all products with whole numbers up to 127 are exact
    return as_float32(np.rint(weight / step) * step)


def _directions(weight: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Orthonormal directions (o, r) of the outputs, the strongest for inputs (F, k); zeros where outputs have fewer."""
    inputs = inputs.astype(np.float64)
    square = inputs.T @ inputs / len(inputs)
    square += 1e-6 * np.trace(square) / len(square) * np.eye(len(square))
    root = np.linalg.cholesky(square)
    weight = weight.astype(np.float64)
    strength, vectors = np.linalg.eigh(root.T @ (weight.T @ weight) @ root)
    strongest = strength[-DIRECTIONS:]
    scale = np.where(strongest > 1e-12 * strongest[-1], 1 / np.sqrt(np.maximum(strongest, 1e-300)), 0)
    return weight @ (root @ vectors[:, -DIRECTIONS:] * scale)


def _pose_vectors(rig: Rig) -> np.ndarray:
    """What the pose modulator reads (F, p) in poses of many kinds."""
    random = np.random.default_rng(0)
    try:
        known, gravity = everyday_poses(rig)
    except ValueError:  # of another rig
        known, gravity = rig.rest[None], UPRIGHT_GRAVITY[None]
    of_bone = random.integers(len(known), size=(POSES, rig.bone_count))
    mixed, down = known[of_bone[:, rig.dof_bones], np.arange(len(rig.rest))], gravity[of_bone[:, 0]]
    anywhere = random.uniform(rig.lower, rig.upper, (POSES, len(rig.rest)))
    tilted = down + random.random((POSES, 1)) ** 2 * random.normal(size=(POSES, 3))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    between = mixed + random.random((POSES, 1)) ** 2 * (anywhere - mixed)
    positions = np.concatenate([known, mixed, between])
    return as_float32(pose_vector(positions, rig.lower, rig.upper, np.concatenate([gravity, down, tilted])))
