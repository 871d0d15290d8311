"""What keeps cloth out of the skin: the skin as points that follow the bones, and samples of the cloth.

On every frame native/src/evaluator/contact.cpp looks samples up on the skin and moves garment nodes and detail nodes as
far as samples lack. Here skin and samples are chosen and put into blocks, which are looked up together, and it is told
for each two blocks which side the skin is on: beneath the cloth, or, as an arm, pressing on it.

Dimensions: `V` body vertices, `q` points of skin, `n` garment vertices, `s` samples, `k` parts of the body. Metres,
canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import fields as dataclass_fields
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.model.garment import face_areas, vertex_normals
from physkin_core.model.skinning import unit
from physkin_core.native_module import as_float32, native
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Evaluator, drape_poses
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY, FrameInput
from physkin_core.runtime.turned_cloth import turned_cloth

__all__ = ["meeting_skin"]

POINTS = 2000
"""Of the skin: 3 cm apart."""
CANDIDATES = 20000
"""Body vertices, at most, that they are chosen from."""
SAMPLES = 1024
"""Of a garment without detail; with detail there is one for each detail node."""
CELL = 64
"""Neighbours that lie side by side while points are chosen, which is faster then."""
THICKNESS = 0.02
"""[m] By which points that face opposite ways count as farther apart: both sides of hands are met."""
FACING = 0.15
"""[m] By which they do in blocks, each of one part of the body."""
CLOTH_FACING = 0.04
"""[m] The same of samples."""
GAP = 0.003
"""[m] Cloth is kept this far from the skin, or as far as it is at rest."""
HUGS, HANGS = 0.05, 0.09
"""[m] Cloth nearer to the skin at rest than the first hugs it; farther from it than the second it hangs."""
JOINED = 0.1
"""[m] Within this at rest sleeve and trunk go over into each other, and so do trunk and upper arm."""
SLIDES = 0.1
"""[m] Cloth slides so far along the skin beneath, and three times as far as it hangs off it: it never meets skin
farther off."""
SEES = 0.25
"""Cosine with both normals at rest, of places on different limbs that may touch."""
OVERLAP = 0.025
"""[m] Cloth overlaps where places that are far from each other along it are so near at rest and face alike."""
OWN_GAP = 0.008
"""[m] Samples are kept so far from far places of their cloth, or as far as at rest; they bend less than the cloth."""
BENEATH, OVER, PRESSES = 1, 2, -1


@dataclass(frozen=True)
class Skin:
    """Points of the skin in blocks.

    points, normals: (q, 3). bones, weights: (q, K) that they follow. part: (q,) of the body, 0 the trunk; limb `l` has
    1 + 2 l, and 2 + 2 l from the elbow or knee on.
    """

    points: np.ndarray
    normals: np.ndarray
    bones: np.ndarray
    weights: np.ndarray
    part: np.ndarray


@dataclass(frozen=True)
class Parts:
    """of_bone: (b,) part of the body. limb: (k,) of each part, -1 for the trunk. arm, upper: (k,) whether it is of an
    arm, and whether it begins at the trunk."""

    of_bone: np.ndarray
    limb: np.ndarray
    arm: np.ndarray
    upper: np.ndarray


def meeting_skin(bound: BoundGarment, avatar: Avatar, rig: Rig) -> dict[str, Any]:
    """The fields of `BoundGarment` to replace for it to be kept out of an avatar's skin; none where no part of it has
    the points of a block."""
    parts = _parts(rig)
    skin = _skin(avatar, parts.of_bone)
    if not len(skin.points):
        return {}
    (drape,) = drape_poses(bound, [(bound.dof_rest, UPRIGHT_GRAVITY)], precision="fp32")
    drape = drape.astype(np.float64)
    turned = turned_cloth(drape, bound.faces, avatar)
    drape[turned, 3:] *= -1
    samples, detail_samples = _samples(bound, drape)
    between = _between(bound, drape, samples)
    sides = _sides(*np.split(drape[samples], 2, axis=1), skin, parts)
    sampled = _sampled(bound, samples)
    sampled["contact_normals"][turned[samples]] *= -1
    touching = _touching(drape[samples], sampled["contact_detail_nodes"], skin, parts)
    skin, sides = _met(skin, sides)
    fields = {
        **sampled,
        **touching,
        **_lying_between(bound, drape, between, samples, detail_samples),
        "skin_positions": as_float32(skin.points),
        "skin_normals": as_float32(skin.normals),
        "skin_bones": np.ascontiguousarray(skin.bones, dtype=np.int32),
        "skin_weights": as_float32(skin.weights),
        "contact_sides": sides,
        "contact_gaps": np.full(len(samples), -1.0, dtype=np.float32),
        "contact_hangs": np.zeros(len(samples), dtype=np.float32),
        "between_gaps": np.full(len(between), -1.0, dtype=np.float32),
        "touching_gaps": np.full(len(touching["touching_samples"]), -1.0, dtype=np.float32),
    }
    clearance = _clearance_at_rest(replace(bound, **fields)) - native.constants["soft"]
    of_samples, of_between, of_touching = np.split(clearance, [len(samples), len(samples) + len(between)])
    free = np.clip((of_samples + native.constants["soft"] - HUGS) / (HANGS - HUGS), 0, 1)
    return {
        **fields,
        "contact_gaps": np.clip(of_samples, 0, GAP),
        "between_gaps": np.clip(of_between, 0, GAP),
        "contact_hangs": free * free * (3 - 2 * free),
        "touching_gaps": np.minimum(of_touching, OWN_GAP),
    }


def _touching(drape: np.ndarray, nodes: np.ndarray, skin: Skin, parts: Parts) -> dict[str, np.ndarray]:
    """Fields touching_... of `BoundGarment` but gaps: samples whose outsides see those of another limb at rest, or an
    arm and the trunk each other's, and those that lie over each other as they were made. Cloth that hangs waves: of its
    folds nobody knows which side they touch with.

    drape, nodes: (s, 6) and detail nodes (s, J) of samples; none without detail.
    """
    from scipy.spatial import cKDTree

    none = {"touching_samples": np.empty(0, dtype=np.int32), "touching_sides": np.empty((0, 0), dtype=np.int32)}
    if not nodes.shape[1]:
        return none
    size: int = native.constants["block"]
    at, facing = np.split(drape, 2, axis=1)
    off, nearest = cKDTree(skin.points).query(at)
    limbs, arm = parts.limb[skin.part[nearest]], parts.arm[skin.part[nearest]]

    def press(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (limbs[a] != limbs[b]) & (arm[a] | arm[b] | (np.minimum(limbs[a], limbs[b]) >= 0))

    groups, of_limbs = [], [np.flatnonzero(limbs == limb) for limb in np.unique(limbs)]
    for of_limb in of_limbs:
        own, others = of_limb[off[of_limb] < HANGS], [other for other in of_limbs if press(of_limb[0], other[0])]
        sight = np.max([_sight(drape, own, other) for other in others] or np.zeros((1, len(own))), axis=0)
        groups.append(own[(-sight).argsort(kind="stable")[: (sight > SEES).sum() // size * size]])
    first, second = cKDTree(at).query_pairs(OVERLAP, output_type="ndarray").T
    far = ~(nodes[first][:, :, None] == nodes[second][:, None]).any(axis=(1, 2))
    first, second = (of[far & ((facing[first] * facing[second]).sum(axis=1) > 0.5)] for of in (first, second))
    higher = np.sign(((at[first] - at[second]) * (facing[first] + facing[second])).sum(axis=1))
    votes = np.bincount(np.r_[first, second], np.r_[higher, -higher], minlength=len(at))
    groups += [np.flatnonzero(votes > 0), np.flatnonzero(votes < 0)]
    groups = [group[_blocks_of_cloth(drape[group])][: len(group) // size * size] for group in groups]
    samples = np.concatenate(groups).astype(np.int32)
    kind = np.repeat(np.arange(len(groups)), [len(group) // size for group in groups])
    a, b = np.meshgrid(kind, kind, indexing="ij")
    over, blocks = len(groups) - 2, samples[::size]
    sides = np.where(press(blocks[:, None], blocks) & (a < over) & (b < over), PRESSES, 0)
    sides = np.where((a == over) & (b == over + 1), BENEATH, np.where((a == over + 1) & (b == over), OVER, sides))
    return {"touching_samples": samples, "touching_sides": sides.astype(np.int32)} if sides.any() else none


def _sight(drape: np.ndarray, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """How well samples `own` see a block of the others before their outside and are seen: the lower cosine (k,)."""
    size: int = native.constants["block"]
    others = others[_blocks_of_cloth(drape[others])]
    first = np.arange(0, len(others), size)
    blocks = np.add.reduceat(drape[others], first) / np.diff(first, append=len(others))[:, None]
    apart = unit(blocks[:, :3] - drape[own, None, :3])
    cosines = (apart * drape[own, None, 3:]).sum(axis=2), -(apart * unit(blocks[:, 3:])).sum(axis=2)
    return np.minimum(*cosines).max(axis=1)


def _met(skin: Skin, sides: np.ndarray) -> tuple[Skin, np.ndarray]:
    """Without blocks that no cloth ever meets."""
    met = sides.any(axis=0)
    points = np.repeat(met, native.constants["skin_block"])
    kept = Skin(*(getattr(skin, each.name)[points] for each in dataclass_fields(skin)))
    return kept, np.ascontiguousarray(sides[:, met])


def _parts(rig: Rig) -> Parts:
    """All one where no limbs are found."""
    try:
        limbs = find_limbs(rig).limbs
    except ValueError:
        limbs = ()
    starts = {bone: 1 + 2 * k + end for k, limb in enumerate(limbs) for end, bone in enumerate(limb.ends[:2])}
    return Parts(
        of_bone=np.asarray(rig.inherited(starts, 0)),
        limb=np.array([-1, *np.repeat(np.arange(len(limbs)), 2)]),
        arm=np.array([False, *np.repeat([limb.is_arm for limb in limbs], 2)], dtype=bool),
        upper=np.array([False, *[True, False] * len(limbs)]),
    )


def _skin(avatar: Avatar, part_of_bone: np.ndarray) -> Skin:
    """Points far from each other, with the normal of the skin around each."""
    from scipy.spatial import cKDTree

    vertices, normals = avatar.vertices.astype(np.float64), vertex_normals(avatar.vertices, avatar.faces)
    areas = np.bincount(avatar.faces.reshape(-1), np.repeat(face_areas(vertices, avatar.faces) / 3, 3), len(vertices))
    used = np.flatnonzero(areas > 0)
    if len(used) > CANDIDATES:
        share = areas[used] / areas[used].sum()
        used = np.sort(np.random.default_rng(0).choice(used, CANDIDATES, replace=False, p=share))
    strongest = avatar.influence_weights.argmax(axis=1)
    part = part_of_bone[avatar.influence_bones[np.arange(len(vertices)), strongest]]
    tagged = np.concatenate([vertices, THICKNESS * normals], axis=1)
    block: int = native.constants["skin_block"]
    count = min(POINTS, len(used))
    chosen = used[_spread(tagged[used], count)]
    cell = cKDTree(tagged[chosen]).query(tagged[used])[1]
    around = np.stack([np.bincount(cell, areas[used] * normals[used, axis], count) for axis in range(3)], axis=1)
    around = unit(around)
    own = (around * normals[chosen]).sum(axis=1) < 0.2  # of a fold: that of its own
    around[own] = normals[chosen][own]
    near = np.concatenate([vertices[chosen], FACING * around], axis=1)
    each_part = (np.flatnonzero(part[chosen] == k) for k in np.unique(part_of_bone))
    whole = [of_part[: len(of_part) // block * block] for of_part in each_part if len(of_part) >= block]
    blocks = [of_part[_in_blocks(near[of_part], block)] for of_part in whole]
    order = np.concatenate([np.empty(0, dtype=np.intp), *blocks])
    chosen = chosen[order]
    bones, weights = avatar.influence_bones[chosen], avatar.influence_weights[chosen]
    return Skin(vertices[chosen], around[order], bones, weights, part[chosen])


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """`count` of the points (V, D), each the farthest from those chosen before."""
    order = np.concatenate([[0], 1 + _in_blocks(points[1:], CELL)])
    chosen = np.empty(count, dtype=np.int32)
    native.spread_points(np.ascontiguousarray(points[order], dtype=np.float64), chosen)
    return order[chosen]


def _in_blocks(points: np.ndarray, size: int) -> np.ndarray:
    """An order of points (V, D) in which whole blocks lie together: halved along their longest side, and again."""

    def halved(chosen: np.ndarray) -> list[np.ndarray]:
        if len(chosen) <= size:
            return [chosen]
        at = points[chosen]
        ordered = chosen[at[:, (at.max(axis=0) - at.min(axis=0)).argmax()].argsort(kind="stable")]
        half = (len(ordered) // 2 + size - 1) // size * size
        return [*halved(ordered[:half]), *halved(ordered[half:])]

    return np.concatenate(halved(np.arange(len(points))))


def _clearance_at_rest(bound: BoundGarment) -> np.ndarray:
    """How far samples, and vertices between them, are from the skin (s + t,) [m]."""
    evaluator, frame_input = Evaluator([bound], precision="fp32"), FrameInput(1)
    frame_input.fill(UPRIGHT_GRAVITY)
    out = np.empty((len(bound.vertices), 3), dtype=np.float32)
    evaluator.evaluate(bound.dof_rest, frame_input.rows, [out])
    return evaluator.clearance()


def _samples(bound: BoundGarment, drape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (s,) in blocks, for each detail node the one that goes with it most; and which of them (D,) that is."""
    if bound.detail_node_count:
        nodes, weights = bound.detail_nodes.reshape(-1), bound.detail_weights.reshape(-1)
        order = np.lexsort([weights, nodes])
        last = np.searchsorted(nodes[order], np.arange(bound.detail_node_count), side="right") - 1
        of_nodes = order[last] // bound.detail_nodes.shape[1]
        chosen, back = np.unique(of_nodes, return_inverse=True)
    else:
        chosen, back = _spread(drape[:, :3], min(SAMPLES, len(drape))), np.empty(0, dtype=np.intp)
    order = _blocks_of_cloth(drape[chosen])
    return chosen[order], order.argsort()[back]


def _tagged(drape: np.ndarray) -> np.ndarray:
    """Cloth (k, 6) whose distances tell how near it is and how alike it faces."""
    return drape * [1, 1, 1, *[CLOTH_FACING] * 3]


def _blocks_of_cloth(drape: np.ndarray) -> np.ndarray:
    return _in_blocks(_tagged(drape), native.constants["block"])


def _between(bound: BoundGarment, drape: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Vertices (t,) in blocks: all others of a garment with detail."""
    if not len(bound.detail_nodes):
        return np.empty(0, dtype=np.intp)
    left = np.setdiff1d(np.arange(len(drape)), samples)
    return left[_blocks_of_cloth(drape[left])]


def _lying_between(
    bound: BoundGarment, drape: np.ndarray, between: np.ndarray, samples: np.ndarray, detail_samples: np.ndarray
) -> dict[str, np.ndarray]:
    """Fields between_... of `BoundGarment`: vertices (t,), by the samples that their detail nodes have."""
    from scipy.spatial import cKDTree

    if not len(between):
        return {}
    nodes, weights = bound.detail_nodes[between], bound.detail_weights[between]
    mean = np.einsum("tj,tji->ti", weights, drape[samples][detail_samples[nodes]])
    normals = mean[:, 3:]
    heights = ((drape[between, :3] - mean[:, :3]) * normals).sum(axis=1) / np.maximum((normals**2).sum(axis=1), 0.1)
    size: int = native.constants["block"]
    near = cKDTree(_tagged(drape[samples])).query(_tagged(drape[between]))[1] // size
    return {
        "between_nodes": np.ascontiguousarray(nodes),
        "between_weights": as_float32(weights),
        "between_heights": as_float32(heights),
        "between_blocks": np.array(
            [np.bincount(near[k : k + size]).argmax() for k in range(0, len(between), size)], dtype=np.int32
        ),
    }


def _sampled(bound: BoundGarment, samples: np.ndarray) -> dict[str, np.ndarray]:
    """What samples (s,) among vertices are skinned with."""
    fields = {
        name: getattr(bound, name)[samples] for name in ("vertices", "normals", "influence_nodes", "influence_weights")
    }
    for name in ("detail_nodes", "detail_weights"):
        of_vertices = getattr(bound, name)
        none = np.empty((len(samples), 0), dtype=of_vertices.dtype)
        fields[name] = of_vertices[samples] if len(of_vertices) else none
    return {f"contact_{name}": np.ascontiguousarray(values) for name, values in fields.items()}


def _sides(draped: np.ndarray, normals: np.ndarray, skin: Skin, parts: Parts) -> np.ndarray:
    """(blocks of samples, blocks of skin) int32: which side of the cloth the skin is on.

    Sleeves are pressed on by all that is not their arm, other cloth by arms, and a trouser leg by the other leg that it
    faces. draped, normals: (s, 3).
    """
    from scipy.spatial import cKDTree

    size, skin_size = native.constants["block"], native.constants["skin_block"]
    first = np.arange(0, len(draped), size)
    free, nearest = cKDTree(skin.points).query(draped)
    home = skin.part[nearest]
    of_block = np.array([np.bincount(home[k : k + size]).argmax() for k in first])
    middle, facing = (np.add.reduceat(of, first) / np.diff(first, append=len(of))[:, None] for of in (draped, normals))
    of_skin = skin.part[::skin_size]
    skin_middle, skin_facing = (of.reshape(-1, skin_size, 3).mean(axis=1) for of in (skin.points, skin.normals))
    a, b = np.meshgrid(of_block, of_skin, indexing="ij")
    same = parts.limb[a] == parts.limb[b]
    sides = np.where(same | ~(parts.arm[a] | parts.arm[b]), BENEATH, PRESSES)
    near = np.linalg.norm(middle[:, None] - skin_middle, axis=2) < JOINED
    facing_alike, outside = facing @ skin_facing.T, np.einsum("bsi,bi->bs", skin_middle - middle[:, None], facing) > 0
    other_leg = (parts.limb[a] >= 0) & (parts.limb[b] >= 0) & ~same & outside & (facing_alike < 0)
    sides = np.where(other_leg, PRESSES, sides)
    at_shoulder = (parts.arm[a] & (b == 0)) | ((a == 0) & parts.arm[b] & parts.upper[b])
    sides = np.where(near & (facing_alike > 0) & at_shoulder, BENEATH, sides)
    apart = np.linalg.norm(draped[:, None] - skin_middle, axis=2) - 3 * free[:, None]
    meets = np.minimum.reduceat(apart, first) < SLIDES
    return np.where(meets | (sides == PRESSES), sides, 0).astype(np.int32)
