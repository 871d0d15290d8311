"""What the benchmark evaluates: a garment model on the bundled avatar, and random network weights of the paper's sizes.

Dimensions: `d` degrees of freedom, `m` garment nodes, `n` vertices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.model.garment import Garment
from physkin_core.model.mlp import Layer
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.motion import load_motion
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["BenchmarkCase", "model_case", "paper_case"]

SEED = 2603
MOTIONS = ("walk", "dance", "crawl")
POSES_A_MOTION = 20
BATCH = 8
"""Bodies that wear the garment at once."""
PAPER_BONES, PAPER_DOFS, PAPER_NODES, PAPER_INFLUENCES = 128, 117, 128, 4
PAPER_USED_BONES = 20  # that garment nodes follow, as those of a garment on the trunk and arms
PAPER_RINGS = PAPER_SEGMENTS = 100
POSE_WIDTHS, DEFORMER_WIDTHS = (512,) * 4, (128,) * 4


@dataclass(frozen=True)
class BenchmarkCase:
    """A bound garment and poses for it.

    joint_positions: (P, d) float32 [rad]; gravity: (P, 3) float32. bodies: the garment on others, for a batch.
    garment: for edge strain; None for a random model.
    """

    name: str
    bound: BoundGarment
    joint_positions: np.ndarray
    gravity: np.ndarray
    bodies: tuple[BoundGarment, ...]
    garment: Garment | None = None


def model_case(model: str | Path) -> BenchmarkCase:
    """A garment model, by its file or shipped name, on the bundled avatar, in poses of the bundled motions.

    Raises what `load_garment_model` and `load_avatar` raise.
    """
    loaded = load_garment_model(model)
    bound = bind_garment(loaded, load_avatar(BUNDLED_AVATAR, loaded.rig))
    body = load_body_model()
    held_out = [avatar_from_body(body, coefficients) for coefficients in body.held_out_bodies[:BATCH]]
    if loaded.rig.bone_names != body.rig.bone_names:
        held_out = [load_avatar(BUNDLED_AVATAR, loaded.rig)] * BATCH
    positions, gravity = [], []
    for name in MOTIONS:
        motion = load_motion(name)
        frames = np.linspace(0, motion.frame_count - 1, POSES_A_MOTION).astype(int)
        positions.append(motion.positions_for(loaded.rig)[frames])
        gravity.append(motion.gravity[frames])
    return BenchmarkCase(
        name=loaded.name,
        bound=bound,
        joint_positions=np.concatenate(positions).astype(np.float32),
        gravity=np.concatenate(gravity).astype(np.float32),
        bodies=tuple(bind_garment(loaded, avatar, backend="native", fold=False) for avatar in held_out),
        garment=loaded.garment,
    )


def paper_case(activation: str) -> BenchmarkCase:
    """The paper's sizes with random network weights: 120 pose scalars, 128 bones, 128 garment nodes, 10,000 vertices.

    Network weights are He-initialised; skinning weights fall off with the distance from the garment nodes, as trained
    ones do. activation: "silu" or "relu".
    """
    rng = np.random.default_rng(SEED)
    vertices, normals = _tube()
    node_rest = vertices[_farthest_points(vertices, PAPER_NODES)]
    nodes, weights = _influences(vertices, node_rest)
    heads = np.c_[np.zeros((PAPER_BONES, 2)), np.linspace(-1, 1, PAPER_BONES)].astype(np.float32)
    axes = rng.normal(size=(PAPER_DOFS, 3))
    used = np.sort(rng.choice(PAPER_BONES, size=PAPER_USED_BONES, replace=False)).astype(np.int32)
    bound = BoundGarment(
        bone_parents=(np.arange(PAPER_BONES, dtype=np.int32) + 1) // 2 - 1,
        bone_heads=heads,
        dof_bone=np.arange(PAPER_DOFS, dtype=np.int32),
        dof_axis=(axes / np.linalg.norm(axes, axis=1, keepdims=True)).astype(np.float32),
        dof_rest=np.zeros(PAPER_DOFS, dtype=np.float32),
        dof_lower=np.full(PAPER_DOFS, -0.5, dtype=np.float32),
        dof_upper=np.full(PAPER_DOFS, 0.5, dtype=np.float32),
        pose_layers=_layers(rng, (PAPER_DOFS + 3, *POSE_WIDTHS, 2 * sum(DEFORMER_WIDTHS)), 0.3),
        deformer_bones=used,
        deformer_layers=_layers(rng, (12 * len(used), *DEFORMER_WIDTHS, 9 * PAPER_NODES), 0.02),
        node_bone=used[np.arange(PAPER_NODES) * len(used) // PAPER_NODES],
        node_positions=node_rest,
        node_rest=node_rest,
        vertices=vertices,
        normals=normals,
        influence_nodes=nodes,
        influence_weights=weights,
        activation=activation,
    )
    poses = rng.uniform(-0.5, 0.5, size=(POSES_A_MOTION, PAPER_DOFS)).astype(np.float32)
    gravity = np.tile(np.array([0, 0, -1], dtype=np.float32), (POSES_A_MOTION, 1))
    modulations = 0.1 * rng.standard_normal((BATCH, 2 * sum(POSE_WIDTHS)), dtype=np.float32)
    bodies = tuple(replace(bound, pose_modulation=modulation) for modulation in modulations)
    return BenchmarkCase(f"paper_{activation}", bound, poses, gravity, bodies)


def _layers(rng: np.random.Generator, widths: tuple[int, ...], output_scale: float) -> tuple[Layer, ...]:
    layers = []
    for index, (inputs, outputs) in enumerate(zip(widths[:-1], widths[1:])):
        gain = np.sqrt(2 / inputs) if index + 2 < len(widths) else output_scale / np.sqrt(inputs)
        weight = gain * rng.standard_normal((outputs, inputs), dtype=np.float32)
        layers.append((weight.astype(np.float32), 0.05 * rng.standard_normal(outputs, dtype=np.float32)))
    return tuple(layers)


def _tube() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and normals (n, 3) of a tube of 0.2 m radius and 0.8 m height, in rings."""
    height, angle = np.meshgrid(
        np.linspace(-0.4, 0.4, PAPER_RINGS), np.linspace(0, 2 * np.pi, PAPER_SEGMENTS, endpoint=False), indexing="ij"
    )
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1).reshape(-1, 3)
    vertices = 0.2 * normals
    vertices[:, 2] = height.ravel()
    return vertices.astype(np.float32), normals.astype(np.float32)


def _farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _influences(vertices: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance = np.linalg.norm(vertices[:, None] - nodes, axis=-1)
    nearest = np.argsort(distance, axis=1)[:, :PAPER_INFLUENCES]
    spacing = np.sqrt(2 * np.pi * 0.2 * 0.8 / len(nodes))
    weights = np.exp(-np.take_along_axis(distance, nearest, axis=1) / spacing)
    return nearest.astype(np.int32), (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
