"""Which cloth is kept out of the skin on every frame: what sways, and what hangs free around both legs.

Where cloth hugs the body the networks keep it out, having learnt every pose's contact. Cloth that swings is where they
have not seen it; on every frame native/src/evaluator/skin_guard.cpp moves garment nodes out of legs, hips and trunk as
far as samples of that cloth lack. A sample need not be farther from a part of the skin than it is at rest.

Dimensions: `n` garment vertices, `s` samples, `K` influences, `k` parts of the skin. Metres, canonical pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import Limbs, find_limbs
from physkin_core.body_shape.skin_parts import SkinPart, fit_skin_parts
from physkin_core.native_module import as_float32, native
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.skin_clearance import draped_at_rest

__all__ = ["guarded"]

SAMPLES = 240
"""Closer together than garment nodes are, so that no leg passes between them."""
SPARSE = 0.3
"""Where cloth hugs the skin samples are farther apart, by up to one divided by this: fewer lack anything there."""
NEAR_FEET, BLEND = 0.3, 0.15
"""Share by which samples are closer together in the lower half of shins, where heels and toes would go between them;
and over how much height [m] it grows to that."""
BLOCK = 16
"""Samples that lie together are skinned together."""
GAP = 0.003
"""[m] Samples are kept this far from the skin."""
FREE = 0.07
"""[m] A garment without sway of which nothing below the hips is this far from legs at rest does not hang."""
HUGS, HANGS = 0.004, 0.02
"""[m] Cloth nearer to the skin at rest than the first hugs it and is left alone; farther than the second it hangs."""


def guarded(bound: BoundGarment, avatar: Avatar, rig: Rig) -> dict[str, Any]:
    """The fields of `BoundGarment` to replace in one that sways or goes round both legs, for it to be kept out of the
    skin; none where nothing hangs."""
    try:
        found = find_limbs(rig)
    except ValueError:
        return {}
    parts = fit_skin_parts(avatar, rig, found)
    if not parts:
        return {}
    draped = draped_at_rest(bound)
    clearance = -np.stack([part.depth(draped) for part in parts])
    nearest = clearance[[not part.presses for part in parts]].min(axis=0)
    of_arms = (_of_arms(rig, found)[bound.node_bone][bound.influence_nodes] * bound.influence_weights).sum(axis=1)
    below_hips = nearest[(of_arms < 0.5) & (draped[:, 2] < _hips(avatar, found))]
    if not bound.sway_layers and below_hips.max(initial=0.0) < FREE:
        return {}
    free = np.clip((nearest - HUGS) / (HANGS - HUGS), 0, 1)
    shares = free * free * (3 - 2 * free) * (1 - of_arms)
    hanging = np.flatnonzero(shares > 0)
    vertices = bound.vertices.astype(np.float64)
    low = np.clip((_middle_of_shins(avatar, found) - draped[hanging, 2]) / BLEND + 0.5, 0, 1)
    closeness = (SPARSE + (1 - SPARSE) * shares[hanging]) * (1 + NEAR_FEET * low)
    samples = _in_blocks(vertices, hanging[_spread(vertices[hanging], closeness, min(SAMPLES, len(hanging)))])
    return {
        **_sampled(bound, samples, "guard"),
        "guard_shares": as_float32(shares[samples]),
        "guard_gaps": as_float32(np.minimum(clearance[:, samples], GAP)),
        "guard_ways": as_float32([part.ways_back(draped[samples]) for part in parts]),
        **_dents(bound, shares),
        **_described(parts),
    }


def _sampled(bound: BoundGarment, samples: np.ndarray, kind: str) -> dict[str, np.ndarray]:
    """Fields of samples (s,) among vertices: `kind`_vertices and what they are skinned with; (s, 0) without detail."""
    fields = {name: getattr(bound, name)[samples] for name in ("vertices", "influence_nodes", "influence_weights")}
    for name in ("detail_nodes", "detail_weights"):
        of_vertices = getattr(bound, name)
        none = np.empty((len(samples), 0), dtype=of_vertices.dtype)
        fields[name] = of_vertices[samples] if len(of_vertices) else none
    return {f"{kind}_{name}": values for name, values in fields.items()}


def _dents(bound: BoundGarment, shares: np.ndarray) -> dict[str, np.ndarray]:
    """Fields dent_... of `BoundGarment`: for each detail node the vertex that goes with it most, where that hangs."""
    if not len(bound.detail_nodes):
        return {}
    nodes = len(bound.detail_offsets) // 3
    order = np.lexsort([bound.detail_weights.reshape(-1), bound.detail_nodes.reshape(-1)])
    sorted_nodes = bound.detail_nodes.reshape(-1)[order]
    last = np.flatnonzero(np.diff(sorted_nodes, append=nodes))
    vertices, detail_nodes = order[last] // bound.detail_nodes.shape[1], sorted_nodes[last]
    hangs = shares[vertices] > 0
    return {
        **_sampled(bound, vertices[hangs], "dent"),
        "dent_nodes": np.ascontiguousarray(detail_nodes[hangs], dtype=np.int32),
        "dent_shares": as_float32(shares[vertices[hangs]]),
    }


def _of_arms(rig: Rig, found: Limbs) -> np.ndarray:
    """(b,) bool, bones of arms: sleeves may hang, but not around legs."""
    return rig.inherited({limb.ends[0]: 1 for limb in found.limbs if limb.is_arm}, 0) == 1


def _hips(avatar: Avatar, found: Limbs) -> float:
    """[m] Their height; below all cloth where there are none."""
    legs = [limb.ends[0] for limb in found.limbs if not limb.is_arm]
    return float(avatar.bone_heads[legs, 2].max(initial=-np.inf))


def _middle_of_shins(avatar: Avatar, found: Limbs) -> float:
    """[m] Their mean height; below all cloth where there are none."""
    legs = [limb.ends[1:] for limb in found.limbs if not limb.is_arm]
    return float(avatar.bone_heads[legs, 2].mean()) if legs else -np.inf


def _spread(points: np.ndarray, closeness: np.ndarray, count: int) -> list[int]:
    """`count` of the points, each the farthest from those chosen before, the first the lowest. closeness: by how much
    each counts as farther."""
    chosen = [int(points[:, 2].argmin())]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, closeness**2 * ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return chosen


def _in_blocks(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The same, so that whole blocks lie together: halved along their longest side, and halved again."""
    if len(chosen) <= BLOCK:
        return chosen
    at = points[chosen]
    ordered = chosen[at[:, np.ptp(at, axis=0).argmax()].argsort(kind="stable")]
    half = (len(ordered) // 2 + BLOCK - 1) // BLOCK * BLOCK
    return np.concatenate([_in_blocks(points, ordered[:half]), _in_blocks(points, ordered[half:])])


def _described(parts: tuple[SkinPart, ...]) -> dict[str, np.ndarray]:
    """Fields skin_... of `BoundGarment`."""
    most: int = native.constants["skin_bones"]
    bones = np.zeros((len(parts), most), dtype=np.int32)
    heights = np.full((len(parts), most), native.constants["no_height"], dtype=np.float32)
    for k, part in enumerate(parts):
        bones[k, : len(part.bones)], heights[k, : len(part.bones)] = part.bones, part.heights
    shapes = [[*part.shape.centre, part.shape.low, part.shape.high, part.blend] for part in parts]
    return {
        "skin_frames": as_float32([part.frame for part in parts]),
        "skin_shapes": as_float32(shapes),
        "skin_bones": bones,
        "skin_presses": np.array([part.presses for part in parts], dtype=np.int32),
        "skin_heights": heights,
        "skin_coefficients": as_float32([part.shape.coefficients for part in parts]),
    }
