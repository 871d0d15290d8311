"""What the benchmark evaluates: a garment model on the bundled avatar, and random network weights of the paper's sizes.

Dimensions: `d` degrees of freedom, `m` garment nodes, `n` vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.model.mlp import Layer
from physkin_core.model.model_file import load_garment_model
from physkin_core.model.skinning import skinning_matrices
from physkin_core.motion.loading import load_motion
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Skinner
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY, FrameInput
from physkin_core.separation.collision_shape import CollisionShape, fit_collision_shape
from physkin_core.separation.limb_separator import SeparationSettings

__all__ = ["BenchmarkCase", "SkinningCase", "model_case", "paper_case", "skinning_case"]

SEED = 2603
MOTIONS, POSES_A_MOTION = ("walk", "dance", "crawl"), 20
ARMS_DOWN = {"upperarm01.L_x": -0.7, "upperarm01.R_x": 0.7, "lowerarm01.L_z": -0.2, "lowerarm01.R_z": 0.2}
"""[rad] As a lean performer's hang."""
BONES, DOFS, INFLUENCES = 128, 117, 4
USED_BONES = 20  # that garment nodes follow, as those of a garment on the trunk and arms
RINGS = SEGMENTS = 100
NODE_RINGS, NODE_SEGMENTS = 8, 16
POSE_WIDTHS, DEFORMER_WIDTHS = (512,) * 4, (128,) * 4


@dataclass(frozen=True)
class BenchmarkCase:
    """A bound garment and poses for it.

    joint_positions: (P, d) float32 [rad]; inputs: (P, 1, 13) float32 as of `FrameInput.rows`. limbs: the collision
    shape of a stout body, and a pose (d,) float32 in which its forearms are inside it; None for another rig than the
    default one.
    """

    name: str
    bound: BoundGarment
    joint_positions: np.ndarray
    inputs: np.ndarray
    limbs: tuple[CollisionShape, np.ndarray] | None = None


@dataclass(frozen=True)
class SkinningCase:
    """Skinning and normals of faces alone. matrices: (m, 3, 4) float32, from rest to posed garment.
    detail_offsets: (D, 3) float32. expected: (n, 6) float32."""

    bound: BoundGarment
    matrices: np.ndarray
    detail_offsets: np.ndarray
    expected: np.ndarray


def skinning_case(bound: BoundGarment, node_transforms: np.ndarray, detail_offsets: np.ndarray) -> SkinningCase:
    """Positions and unit normals of a bound garment by garment nodes (m, 3, 4) and offsets of detail nodes (D, 3)."""
    expected = np.empty((len(bound.vertices), 6), dtype=np.float32)
    Skinner(bound).skin(node_transforms, expected, detail_offsets)
    matrices = skinning_matrices(node_transforms.astype(np.float64), bound.node_rest).astype(np.float32)
    return SkinningCase(bound, matrices, detail_offsets, expected)


def model_case(model: str | Path, *, fit: float | None = None) -> BenchmarkCase:
    """A garment model, by its file or shipped name, on the bundled avatar, in poses of the bundled motions.

    fit: as in `Draper`. Raises what `load_garment_model`, `load_avatar` and `bind_garment` raise.
    """
    loaded = load_garment_model(model)
    avatar = load_avatar(BUNDLED_AVATAR, loaded.rig)
    body = load_body_model()
    limbs = None
    if loaded.rig.bone_names == body.rig.bone_names:
        stout = max((avatar_from_body(body, each) for each in body.held_out_bodies), key=_girth)
        shape, _ = fit_collision_shape(stout, body.rig, onset=SeparationSettings().onset)
        limbs = shape, body.rig.joint_positions(ARMS_DOWN).astype(np.float32)
    positions, gravity = [], []
    for motion in map(load_motion, MOTIONS):
        frames = np.linspace(0, motion.frame_count - 1, POSES_A_MOTION).astype(int)
        positions.append(motion.positions_for(loaded.rig)[frames])
        gravity.append(motion.gravity[frames])
    return BenchmarkCase(
        name=loaded.name,
        bound=bind_garment(loaded, avatar, fit=fit),
        joint_positions=np.concatenate(positions).astype(np.float32),
        inputs=_inputs(np.concatenate(gravity)),
        limbs=limbs,
    )


def _inputs(gravity: Sequence[np.ndarray]) -> np.ndarray:
    """(T, 1, 13) inputs of frames that stand by themselves, under directions of gravity (3,)."""
    frame_input, rows = FrameInput(1), []
    for each in gravity:
        frame_input.fill(each)
        rows.append(frame_input.rows.copy())
    return np.array(rows)


def _girth(avatar: Avatar) -> float:
    """Of the trunk: mean distance of the skin from the vertical axis, over height."""
    return float(np.hypot(*avatar.vertices[:, :2].T).mean() / np.ptp(avatar.vertices[:, 2]))


def paper_case() -> BenchmarkCase:
    """The paper's sizes with random network weights: 120 pose scalars, 128 bones, 128 garment nodes, 10,000 vertices.

    The garment is a tube; skinning weights fall off with the distance from the garment nodes, as trained ones do.
    """
    rng = np.random.default_rng(SEED)
    vertices, normals = _tube(RINGS, SEGMENTS)
    node_rest, _ = _tube(NODE_RINGS, NODE_SEGMENTS)
    distance, nodes = cKDTree(node_rest).query(vertices, k=INFLUENCES)
    weights = np.exp(-distance / distance.mean())
    axes = rng.normal(size=(DOFS, 3))
    used = np.sort(rng.choice(BONES, size=USED_BONES, replace=False)).astype(np.int32)
    bound = BoundGarment(
        bone_parents=(np.arange(BONES, dtype=np.int32) + 1) // 2 - 1,
        bone_heads=np.c_[np.zeros((BONES, 2)), np.linspace(-1, 1, BONES)].astype(np.float32),
        dof_bone=np.arange(DOFS, dtype=np.int32),
        dof_axis=(axes / np.linalg.norm(axes, axis=1, keepdims=True)).astype(np.float32),
        dof_rest=np.zeros(DOFS, dtype=np.float32),
        dof_lower=np.full(DOFS, -0.5, dtype=np.float32),
        dof_upper=np.full(DOFS, 0.5, dtype=np.float32),
        pose_layers=_layers(rng, (DOFS + 3, *POSE_WIDTHS, 2 * sum(DEFORMER_WIDTHS)), 0.3),
        deformer_bones=used,
        deformer_layers=_layers(rng, (12 * len(used), *DEFORMER_WIDTHS, 12 * len(node_rest)), 0.02),
        node_bone=used[np.arange(len(node_rest)) * len(used) // len(node_rest)],
        node_positions=node_rest,
        node_rest=node_rest,
        vertices=vertices,
        normals=normals,
        influence_nodes=nodes.astype(np.int32),
        influence_weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        faces=_tube_faces(RINGS, SEGMENTS),
    )
    poses = rng.uniform(-0.5, 0.5, size=(POSES_A_MOTION, DOFS)).astype(np.float32)
    return BenchmarkCase("paper's sizes", bound, poses, _inputs([UPRIGHT_GRAVITY] * POSES_A_MOTION))


def _layers(rng: np.random.Generator, widths: tuple[int, ...], output_scale: float) -> tuple[Layer, ...]:
    """He-initialised, the last one scaled down."""
    layers = []
    for inputs, outputs in zip(widths[:-1], widths[1:]):
        gain = np.float32((output_scale if len(layers) + 2 == len(widths) else 2**0.5) / inputs**0.5)
        weight = gain * rng.standard_normal((outputs, inputs), dtype=np.float32)
        layers.append((weight, np.float32(0.05) * rng.standard_normal(outputs, dtype=np.float32)))
    return tuple(layers)


def _tube(rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and normals (n, 3) float32 of a tube of 0.2 m radius and 0.8 m height, ring by ring."""
    angle = np.tile(2 * np.pi * np.arange(segments) / segments, rings)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    height = np.repeat(np.linspace(-0.4, 0.4, rings), segments)
    return (0.2 * normals + height[:, None] * [0, 0, 1]).astype(np.float32), normals.astype(np.float32)


def _tube_faces(rings: int, segments: int) -> np.ndarray:
    """Faces (f, 3) int32 of it, two of every four vertices."""
    ring = np.arange(segments)
    ring = np.stack([ring, (ring + 1) % segments], axis=1)
    quads = np.concatenate([ring, ring[:, ::-1] + segments], axis=1)
    quads = (quads + segments * np.arange(rings - 1)[:, None, None]).reshape(-1, 4)
    return np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32)
