"""Meshes without a skeleton or without skinning weights: both come from the compact body model.

`fit_body` lays the compact body model on a mesh (regularised closest points over shape coefficients, limb directions,
scale and place). `carry_influences` takes skinning weights over from a template body by closest point.

Dimensions: `V` mesh vertices, `T` template vertices, `b` bones, `c` shape coefficients, `l` limb segments, `u`
unknowns. Metres, root frame axes.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.body_model import BodyModel
from physkin_core.avatar.surface_matching import normal_equations, spread_vertices, with_normals
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.quality import closest_points
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS, limb_rotations, t_pose_rotations, turned_down_the_chain
from physkin_core.rig.linear_blend_skinning import dense_weights, linear_blend_skinning, strongest_influences
from physkin_core.rig.rig import Rig

__all__ = ["FittedBody", "carry_influences", "fit_body", "template_on_skeleton"]

log = logging.getLogger(__name__)

SAMPLES = 2500
TRIAL_ITERATIONS, ITERATIONS = 6, 18
RESIDUAL_SAMPLES = 1000
NEIGHBOURS = 4
EXPECTED_RESIDUAL = 0.005
"""[m] residual that weighs as much as one standard deviation of the priors."""
LIMB_DEVIATION, TWIST_DEVIATION, SCALE_DEVIATION = 0.5, 0.02, 0.05
SHAPE_WEIGHT = 0.02


@dataclass(frozen=True)
class FittedBody:
    """The compact body model laid on a mesh, in the mesh's pose and place.

    vertices: (T, 3). heads, tails: (b, 3). residual: mean distance [m] from the mesh to the fitted body.
    pose: "A" or "T", the arms it was started from.
    """

    vertices: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    residual: float
    pose: str


def carry_influences(
    vertices: np.ndarray, faces: np.ndarray, template_vertices: np.ndarray, body: BodyModel
) -> tuple[np.ndarray, np.ndarray]:
    """Skinning weights of a mesh from the nearest points of a template body that lies on it in the same pose.

    vertices: (V, 3), faces: (f, 3). template_vertices: (T, 3) of `body`'s mesh. Returns influence_bones (V, K) and
    influence_weights (V, K) with rows summing to 1.
    """
    from scipy.spatial import cKDTree

    template = with_normals(template_vertices, vertex_normals(template_vertices, body.faces))
    distance, nearest = cKDTree(template).query(with_normals(vertices, vertex_normals(vertices, faces)), k=NEIGHBOURS)
    closeness = 1 / np.maximum(distance, 1e-4) ** 2
    weights = (closeness / closeness.sum(axis=1, keepdims=True))[..., None] * body.influence_weights[nearest]
    bones = body.influence_bones[nearest].reshape(len(vertices), -1)
    dense = dense_weights(bones, weights.reshape(len(vertices), -1), body.rig.bone_count)
    return strongest_influences(dense, body.influence_bones.shape[1])


def template_on_skeleton(body: BodyModel, heads: np.ndarray) -> np.ndarray:
    """The mean body posed and stretched so that its bones lie on other bones. heads: (b, 3). Returns (T, 3)."""
    mean_heads, rig = body.mean_bones[:, 0].astype(np.float64), body.rig
    turns = limb_rotations(dict(zip(rig.bone_names, mean_heads)), dict(zip(rig.bone_names, heads)))
    parents = rig.parents[1:]
    length = np.linalg.norm(heads[1:] - heads[parents], axis=1).sum()
    scale = length / np.linalg.norm(mean_heads[1:] - mean_heads[parents], axis=1).sum()
    turned = scale * _bone_rotations(rig, np.stack([turns[name] for name in LIMB_SEGMENTS]))
    transforms = np.concatenate([turned, (heads[..., None] - turned @ mean_heads[..., None])], axis=2)
    return linear_blend_skinning(body.mean_vertices, transforms, body.influence_bones, body.influence_weights)


def fit_body(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> FittedBody:
    """Fit the compact body model to a mesh, from an A-pose and a T-pose, facing either way across its wider side.

    vertices: (V, 3) [m], upright, any origin; faces: (f, 3). The best start is refined. Deterministic, seconds.
    """
    log.info("fitting the body model to a mesh of %d vertices without a skeleton: takes seconds", len(vertices))
    points = with_normals(*sample_surface(vertices, faces, 8 * SAMPLES))
    width = np.ptp(vertices, axis=0)
    trials = []
    for yaw in (0.0, np.pi) if width[1] >= width[0] else (np.pi / 2, -np.pi / 2):
        for pose in ("A", "T"):
            state = _improve(_start(vertices, body, pose, yaw), body, points, TRIAL_ITERATIONS)
            trials.append((_residual(state, body, points), pose, state))
    _, pose, state = min(trials, key=lambda trial: trial[0])
    state = _improve(state, body, points, ITERATIONS)
    surface, _ = _posed_surface(state, body)
    transforms, heads = _bone_transforms(state, body)
    tails = np.einsum("bij,bj->bi", transforms[..., :3], body.bones(state.coefficients)[1]) + transforms[..., 3]
    residual = _residual(state, body, points)
    return FittedBody(surface, _place(state, heads), _place(state, tails), residual, pose)


def _improve(state: _State, body: BodyModel, points: np.ndarray, iterations: int) -> _State:
    """Gauss-Newton on closest points both ways. points: (n, 6) of the mesh, with normals (see `with_normals`)."""
    from scipy.spatial import cKDTree

    tree, some, chosen = cKDTree(points), points[:: len(points) // SAMPLES], spread_vertices(body, SAMPLES)
    for _ in range(iterations):
        surface = with_normals(*_posed_surface(state, body))
        to_mesh, matched = tree.query(surface[chosen])
        to_body, own = cKDTree(surface).query(some)
        template = np.concatenate([chosen, own])
        target = np.concatenate([points[matched], some])
        distance = np.concatenate([to_mesh, to_body])
        trust = 1 / (1 + (distance / np.maximum(3 * np.median(distance), 1e-4)) ** 2) ** 2
        state = _step(state, body, template, target, trust)
    return state


def _residual(state: _State, body: BodyModel, points: np.ndarray) -> float:
    """Mean distance [m] from the mesh to the body's surface."""
    some = points[:: len(points) // RESIDUAL_SAMPLES, :3]
    return float(closest_points(some, _posed_surface(state, body)[0], body.faces)[0].mean())


@dataclass
class _State:
    """Unknowns of the fit: coefficients (c,), rotations of the limbs (l, 3, 3), scale, turn (3, 3), place (3,)."""

    coefficients: np.ndarray
    limbs: np.ndarray
    scale: float
    turn: np.ndarray
    place: np.ndarray


def _start(vertices: np.ndarray, body: BodyModel, pose: str, yaw: float) -> _State:
    heads = dict(zip(body.rig.bone_names, body.mean_bones[:, 0].astype(np.float64)))
    limbs = np.tile(np.eye(3), (len(LIMB_SEGMENTS), 1, 1))
    if pose == "T":
        limbs = np.stack([*t_pose_rotations(heads).values()])
    state = _State(np.zeros(len(body.vertex_components)), limbs, 1.0, _rotation([0, 0, yaw]), np.zeros(3))
    posed, _ = _posed_surface(state, body)
    state.scale = float(np.ptp(vertices[:, 2]) / np.ptp(posed[:, 2]))
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    state.place = centre - state.scale * (posed.min(axis=0) + posed.max(axis=0)) / 2
    return state


def _step(state: _State, body: BodyModel, template: np.ndarray, target: np.ndarray, trust: np.ndarray) -> _State:
    """One damped Gauss-Newton step on the pairs template vertex -> target point with normal (6,)."""
    weights = dense_weights(body.influence_bones[template], body.influence_weights[template], body.rig.bone_count)
    transforms, heads = _bone_transforms(state, body)
    rotation = transforms[..., :3]
    coefficients, shapes = state.coefficients, body.vertex_components[:, template]
    local = linear_blend_skinning(
        body.mean_vertices[template] + np.tensordot(coefficients, shapes, axes=1),
        *(transforms, body.influence_bones[template], body.influence_weights[template]),
    )
    shape_heads = body.bone_components[:, :, 0].astype(np.float64)
    moved = _chain(body.rig, rotation, shape_heads) - np.einsum("bij,cbj->cbi", rotation, shape_heads)
    by_shape = np.tensordot(weights, rotation, axes=1) @ shapes.transpose(1, 2, 0)
    by_shape += np.tensordot(weights, moved, axes=(1, 1)).transpose(0, 2, 1)
    owner = _limb_owners(body.rig)
    by_limb = []
    for limb, name in enumerate(LIMB_SEGMENTS):
        carried = [limb] if limb % 2 else [limb, limb + 1]  # an upper segment carries its lower one
        share = weights[:, np.isin(owner, carried)].sum(axis=1)
        by_limb.append(-share[:, None, None] * _cross(local - heads[body.rig.bone_index(name)]))
    inner = np.concatenate([by_shape, *by_limb], axis=2)
    scaled = state.scale * local @ state.turn.T
    outer = np.concatenate([-_cross(scaled), np.tile(np.eye(3), (len(template), 1, 1)), scaled[:, :, None]], axis=2)
    jacobian = np.concatenate([(state.scale * state.turn) @ inner, outer], axis=2)
    importance = trust / (trust.sum() * EXPECTED_RESIDUAL**2)
    system, right = normal_equations(jacobian.transpose(2, 0, 1), scaled + state.place, target, importance)
    precision, mean = _prior(state, body, heads)
    system += precision
    right += precision @ mean
    return _moved(state, np.linalg.solve(system, right))


def _prior(state: _State, body: BodyModel, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Precision (u, u) of the step and the step (u,) that leads to the mean: shapes are likely, limbs hardly twist."""
    c, limbs = len(state.coefficients), len(LIMB_SEGMENTS)
    count = c + 3 * limbs + 7
    precision, mean = np.zeros((count, count)), np.zeros(count)
    precision[:c, :c] = SHAPE_WEIGHT * np.eye(c)
    mean[:c] = -state.coefficients
    for limb, (start, end) in enumerate(LIMB_SEGMENTS.values()):
        axis = heads[body.rig.bone_index(end)] - heads[body.rig.bone_index(start)]
        along = np.outer(axis, axis) / (axis @ axis)
        block = slice(c + 3 * limb, c + 3 * limb + 3)
        precision[block, block] = (np.eye(3) - along) / LIMB_DEVIATION**2 + along / TWIST_DEVIATION**2
    precision[-7:, -7:] = np.diag([1.0] * 6 + [1 / SCALE_DEVIATION**2])
    return precision, mean


def _moved(state: _State, step: np.ndarray) -> _State:
    c, limbs = len(state.coefficients), state.limbs.copy()
    for limb, turn in enumerate(step[c : c + 3 * len(limbs)].reshape(-1, 3)):
        for carried in [limb] if limb % 2 else [limb, limb + 1]:
            limbs[carried] = _rotation(turn) @ limbs[carried]
    turn, shift, growth = step[-7:-4], step[-4:-1], step[-1]
    return _State(
        coefficients=state.coefficients + step[:c],
        limbs=limbs,
        scale=float(state.scale * np.exp(np.clip(growth, -0.1, 0.1))),
        turn=_rotation(turn) @ state.turn,
        place=state.place + shift,
    )


def _posed_surface(state: _State, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (T, 3) and unit normals (T, 3) of the body in its present state."""
    vertices = body.vertices(state.coefficients)
    transforms, _ = _bone_transforms(state, body)
    posed = _place(state, linear_blend_skinning(vertices, transforms, body.influence_bones, body.influence_weights))
    return posed, vertex_normals(posed, body.faces)


def _bone_transforms(state: _State, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Transforms (b, 3, 4) and heads (b, 3) of the bones with the limbs turned, before scale, turn and place."""
    turns = dict(enumerate(_bone_rotations(body.rig, state.limbs)))
    return turned_down_the_chain(body.bones(state.coefficients)[0], body.rig.parents, turns)


def _chain(rig: Rig, rotation: np.ndarray, heads: np.ndarray) -> np.ndarray:
    """Joint centres (..., b, 3) that follow their parents' rotations (b, 3, 3); linear in `heads`."""
    posed = heads.copy()
    for bone in range(1, rig.bone_count):
        parent = rig.parents[bone]
        posed[..., bone, :] = posed[..., parent, :] + (heads[..., bone, :] - heads[..., parent, :]) @ rotation[parent].T
    return posed


def _place(state: _State, points: np.ndarray) -> np.ndarray:
    return state.scale * points @ state.turn.T + state.place


def _limb_owners(rig: Rig) -> np.ndarray:
    """(b,) index of the limb segment each bone turns with, -1 for the trunk."""
    return rig.inherited({rig.bone_index(name): limb for limb, name in enumerate(LIMB_SEGMENTS)}, -1)


def _bone_rotations(rig: Rig, limbs: np.ndarray) -> np.ndarray:
    """Rotations (b, 3, 3) of all bones from those of the limb segments (l, 3, 3); the trunk has none."""
    return np.concatenate([limbs, np.eye(3)[None]])[_limb_owners(rig)]


def _cross(vectors: np.ndarray) -> np.ndarray:
    """(n, 3, 3) matrices of the cross product with each vector (n, 3)."""
    return np.cross(np.eye(3), vectors[:, None])


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) by a rotation vector (3,) [rad]."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()
