"""Bind a garment model to a body, and another mesh or point set of the same garment to a trained model.

A finer, coarser or cropped mesh, or points without faces (a point cloud, splat centres), takes the trained skinning
weights over in canonical space: each point from the closest point of the trained garment's surface (paper: Garment
Remeshing). Bodies are encoded once here; what comes out changes no more from frame to frame.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import vertex_normals
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.model.mlp import float32_layers, fold_modulation
from physkin_core.model.node_deformer import fold_first_layer
from physkin_core.model.skinning import unit
from physkin_core.model.sway_network import fold_body
from physkin_core.native_module import as_float32
from physkin_core.quality import closest_points
from physkin_core.rig.linear_blend_skinning import dense_weights, strongest_influences
from physkin_core.runtime.around_legs import reaches_knees, thighs
from physkin_core.runtime.body_encoder import encode_body
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.contact import meeting_skin
from physkin_core.runtime.garment_on_body import GarmentOnBody, checked_fit, put_on_body
from physkin_core.runtime.layer import Layer
from physkin_core.runtime.low_rank import low_rank_layers
from physkin_core.runtime.skin_clearance import SkinClearance, draped_at_rest, move_clear, room_to_move

__all__ = ["FARTHEST_POINT", "bind_garment", "bind_points", "draping", "rest_normals"]

log = logging.getLogger(__name__)

FARTHEST_POINT = 0.05
"""A point farther [m] than this from the trained garment's surface is refused by `bind_points` by default."""
UNLIKE = 0.005
"""[m] Cloth gets room to move on an avatar whose skin or pivots are farther than this from those of the body that
networks see."""
WEIGHTS_AT_ONCE = 1 << 20
"""Skinning weights, of some points over all garment nodes, that `bind_points` holds at a time."""


def bind_garment(
    model: GarmentModel, avatar: Avatar, *, fit: float | None = None, beneath: Sequence[Layer] = ()
) -> BoundGarment:
    """Everything of (model, body) that does not change with the pose. Encodes the body; logs how long that took.

    fit: 0 for the template's rest shape, 1 for the one made to measure, between for one between; default as
    `checked_fit`. beneath: what the body wears already, under this garment. Raises ValueError when the avatar's bones
    are not those of the model's rig, where the networks give no cloth on such a body, and as `checked_fit`.
    """
    fit = checked_fit(model, fit)
    rig = model.rig
    if avatar.bone_heads.shape != rig.heads.shape:
        raise ValueError(
            f"avatar {avatar.source} has {len(avatar.bone_heads)} bones, the rig of {model.name!r} has {rig.bone_count}"
        )
    for own, expected in zip(avatar.bone_names, rig.bone_names):
        if own != expected:
            raise ValueError(
                f"avatar {avatar.source} is bound to another rig than that of {model.name!r}: its bone {own!r} is "
                f"{expected!r} there; load it with `load_avatar(path, model.rig)`"
            )
    started = perf_counter()
    worn = put_on_body(model, avatar, fit, beneath)
    log.info("put %s on %s in %.1f s", model.name, avatar.source, perf_counter() - started)
    trained = model.as_trained or model
    (first_weight, first_bias), *rest = model.node_deformer
    elsewhere = worn.seen.bone_heads.astype(np.float64) - avatar.bone_heads
    deformer_bones, folded_weight = fold_first_layer(
        first_weight, model.node_bone, worn.seen_positions, rig=rig, elsewhere=elsewhere
    )
    bound = BoundGarment(
        bone_parents=rig.parents,
        bone_heads=as_float32(avatar.bone_heads),
        dof_bone=rig.dof_bones,
        dof_axis=as_float32(rig.dof_axes),
        dof_rest=as_float32(rig.rest),
        dof_lower=as_float32(rig.lower),
        dof_upper=as_float32(rig.upper),
        deformer_bones=deformer_bones,
        deformer_layers=float32_layers([(folded_weight, first_bias), *rest]),
        node_bone=np.ascontiguousarray(model.node_bone, dtype=np.int32),
        node_positions=as_float32(worn.node_positions),
        node_rest=as_float32(worn.node_rest),
        vertices=as_float32(worn.garment.vertices),
        normals=rest_normals(model, worn.garment.vertices),
        influence_nodes=np.ascontiguousarray(model.influence_nodes, dtype=np.int32),
        influence_weights=as_float32(model.influence_weights),
        faces=np.ascontiguousarray(worn.garment.faces, dtype=np.int32),
        **_detail(model),
        **_of_body(trained, worn.seen, fit),
        sway_thighs=np.array(_holding_sway_back(model), dtype=np.int32),
    )
    with draping(model, avatar):  # whatever it is made of, room and contact are those of the cloth as trained
        bound = _clear_of_skin(bound, model, avatar, worn, elsewhere)
        bound = replace(bound, **meeting_skin(bound, avatar, rig))
    return bound if model is trained else replace(bound, **_of_body(model, worn.seen, fit))


def _holding_sway_back(model: GarmentModel) -> list[int]:
    """The thighs on which cloth that reaches the knees lies where they are raised; a shirt sways on."""
    return thighs(model.rig) if model.sway is not None and reaches_knees(model.rig, model.node_bone) else []


def _of_body(model: GarmentModel, seen: Avatar, fit: float) -> dict[str, Any]:
    """The fields of `BoundGarment` that the encoded body is folded into."""
    started = perf_counter()
    modulation = encode_body(model, seen, fit=fit)
    log.info("encoded body %s for %s in %.0f ms", seen.source, model.name, 1e3 * (perf_counter() - started))
    return {
        "pose_layers": low_rank_layers([float32_layers(fold_modulation(model.pose_modulator, modulation))], model.rig),
        **({} if model.sway is None else fold_body(model.sway, modulation)),
    }


@contextmanager
def draping(model: GarmentModel, avatar: Avatar) -> Iterator[None]:
    """Says what drapes on what where an evaluator gives up: what networks make of a crumpled body may be kilometres
    away, or no number. Raises ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(
            f"garment {model.name!r} does not drape on {avatar.source}: {error}; is the body damaged?"
        ) from error


def _detail(model: GarmentModel) -> dict[str, Any]:
    """The fields of `BoundGarment` that a model's detail fills."""
    if model.detail is None:
        return {}
    return {
        "detail_layers": float32_layers([model.detail.features]),
        "detail_offsets": as_float32(model.detail.offsets),
        "detail_nodes": np.ascontiguousarray(model.detail.nodes, dtype=np.int32),
        "detail_weights": as_float32(model.detail.weights),
    }


def _clear_of_skin(
    bound: BoundGarment, model: GarmentModel, avatar: Avatar, worn: GarmentOnBody, elsewhere: np.ndarray
) -> BoundGarment:
    """A garment with room on an avatar that differs from the body that networks see.

    elsewhere: (b, 3) [m] by which bone heads of that body lie elsewhere.
    """
    unlike = max(np.linalg.norm(each, axis=1).max() for each in (worn.differs, elsewhere)) > UNLIKE
    if not worn.differs.any() and not unlike:
        return bound
    draped = draped_at_rest(bound)
    on_seen = draped - worn.differs
    wanted, _ = SkinClearance(worn.seen.vertices, worn.seen.faces)(on_seen, vertex_normals(on_seen, bound.faces))
    vertices = worn.garment.vertices + move_clear(
        draped, bound.faces, wanted, SkinClearance(avatar.vertices, avatar.faces)
    )
    if unlike:
        vertices = vertices + room_to_move(replace(bound, vertices=as_float32(vertices)), avatar, model.rig)
    return replace(bound, vertices=as_float32(vertices), normals=rest_normals(model, vertices))


def bind_points(
    model: SkinnedGarment,
    points: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    rest: np.ndarray | None = None,
    farthest: float = FARTHEST_POINT,
) -> dict[str, Any]:
    """Skin other points of the same garment to the trained garment nodes.

    points: (n, 3) [m] in the model's canonical space. normals: (n, 3) of any length but zero, turned as those of the
    trained surface are by being fitted to drapes; default these. rest: rest shape of the model's mesh, its vertices
    [m], that points and normals are carried to; default its own. farthest: [m] from the garment that a point may be.
    Returns the fields of `BoundGarment` to replace: vertices, normals, influence_nodes, influence_weights, the same of
    detail nodes, and faces, of which there are none.
    Raises ValueError when points or normals are not finite, normals are not one a point or have no length, or points
    lie farther than that from the trained garment.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"points to bind must be a finite, non-empty (n, 3) array, got shape {points.shape}")
    if normals is not None:
        normals = _checked_normals(normals, points.shape)
    garment = model.garment
    low, high = garment.vertices.min(axis=0), garment.vertices.max(axis=0)
    beyond = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
    # at once, where closest points of centimetres take minutes
    _reject_far_points(beyond, farthest, "at least ", model.name)
    distance, face, barycentric = closest_points(points, garment.vertices, garment.faces)
    _reject_far_points(distance, farthest, "", model.name)
    corners = garment.faces[face]

    def there(of_vertices: np.ndarray) -> np.ndarray:
        return np.einsum("nc,nci->ni", barycentric, of_vertices[corners])

    fitted = unit(there(rest_normals(model, garment.vertices if rest is None else rest)))
    if normals is None:
        normals = fitted
    else:
        normals = _turned(normals, unit(there(vertex_normals(garment.vertices, garment.faces))), fitted)
    if rest is not None:
        points = points + there(rest - garment.vertices)
    nodes, weights = _influences_in_faces(model.influence_nodes, model.influence_weights, corners, barycentric)
    placed = {
        "vertices": as_float32(points),
        "normals": as_float32(unit(normals)),
        "influence_nodes": nodes,
        "influence_weights": weights,
        "faces": np.empty((0, 3), dtype=np.int32),
    }
    if (detail := model.detail) is not None:
        nodes, weights = _influences_in_faces(detail.nodes, detail.weights, corners, barycentric)
        placed |= {"detail_nodes": nodes, "detail_weights": weights}
    return placed


def rest_normals(model: SkinnedGarment, vertices: np.ndarray) -> np.ndarray:
    """Unit rest normals (n, 3) float32 of the garment reshaped to vertices (n, 3): the model's, turned as it is."""
    faces = model.garment.faces
    start, end = vertex_normals(model.garment.vertices, faces), vertex_normals(vertices, faces)
    return as_float32(unit(_turned(model.rest_normals.astype(np.float64), start, end)))


def _turned(vectors: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Vectors (n, 3), each turned by the smallest rotation from a unit vector of `start` to that of `end` (n, 3)."""
    axis, cosine = np.cross(start, end), (start * end).sum(axis=1, keepdims=True)
    along = (axis * vectors).sum(axis=1, keepdims=True) / np.maximum(1 + cosine, 1e-6)
    return cosine * vectors + np.cross(axis, vectors) + along * axis


def _checked_normals(normals: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    normals = np.asarray(normals, dtype=np.float64)
    if normals.shape != shape or not np.isfinite(normals).all():
        raise ValueError(f"normals must be finite, one a point: shape {shape}, got {normals.shape}")
    length = np.linalg.norm(normals, axis=1)
    if length.min() < 1e-9:
        raise ValueError(f"normals must have a length; that of point {int(length.argmin())} is {length.min():.1e}")
    return normals


def _reject_far_points(distance: np.ndarray, farthest: float, bound: str, garment: str) -> None:
    if (count := int((distance > farthest).sum())) > 0:
        raise ValueError(
            f"point {int(distance.argmax())} is {bound}{distance.max() * 100:.1f} cm from garment {garment!r}, at most "
            f"{farthest * 100:.0f} cm allowed; {bound}{count} of {len(distance)} points are too far: are they in the "
            "model's canonical space, in metres?"
        )


def _influences_in_faces(
    nodes: np.ndarray, weights: np.ndarray, corners: np.ndarray, barycentric: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Influences inside faces, of nodes (v, K) by weights (v, K) of vertices: the corners' mixed, the K largest kept.
    corners, barycentric: (n, 3)."""
    count = int(nodes.max()) + 1
    at_once = max(WEIGHTS_AT_ONCE // count, 1)
    chunks = [slice(start, start + at_once) for start in range(0, len(corners), at_once)]
    found = []
    for chunk in chunks:
        shares = weights[corners[chunk]] * np.clip(barycentric[chunk][..., None], 0, 1)
        flat = len(shares), -1
        dense = dense_weights(nodes[corners[chunk]].reshape(flat), shares.reshape(flat), count)
        found.append(strongest_influences(dense, nodes.shape[1]))
    return (
        np.concatenate([each for each, _ in found]).astype(np.int32),
        as_float32(np.concatenate([each for _, each in found])),
    )
