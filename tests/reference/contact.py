"""Cloth kept out of the skin: samples of it looked up on the skin, and what they lack made up for by nodes.

The skin is points with normals that follow bones, in blocks of 8; samples of the cloth are in blocks of 16. What of the
skin counts for a sample depends on how its normal agrees with the mean normal of each block of skin, with the side that
the garment gives for these two blocks. Planes of the nearest points that count are blended. What samples of cloth that
hangs lack moves garment nodes; where samples still lack much vertices between them are looked up, too; samples that may
touch far places of the cloth are looked up on these; and what all of them then lack moves detail nodes. Fields are
those of `BoundGarment`.

Blocks of skin that are much farther off than the nearest one do not count, unless they do for another sample of the
block of cloth: that is part of the result, as it moves shipped drapes by up to a centimetre. What else the kernel
leaves out cannot count: blocks out of reach of a block of cloth, or turned away from all of it.

Dimensions: `q` points of skin, `s` samples, `t` vertices between them, `D` detail nodes.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from physkin_core.model.skinning import SkinningData
from physkin_core.native_module import native
from reference.skinning import skin, unit

BLOCK, SKIN_BLOCK = native.constants["block"], native.constants["skin_block"]
REACH, FADE_SHARE = 0.08, 0.3
"""[m] So deep cloth is still led out, fading over the last share of it."""
BLEND, BLEND_FAR = 0.014, 0.2
"""[m] over which distance planes blend, and how that grows with the distance itself."""
FACING, TURN = 0.1, 0.5
"""Cosine from which skin counts in full, and how far below that it does not count."""
BEYOND = 0.06
"""[m] Blocks of skin whose middles are this much farther off than the nearest one, as they count, are left out."""
ASIDE, ASIDE_FADE = 0.03, 0.02
"""[m] Cloth in the skin is asked for less where it is farther beside the points than this, over the second."""
SOFT = 0.002
"""[m] How much earlier cloth is moved than it must be."""
LOOKS, LEAST = 0.003, 1e-5
"""[m] Lack from which vertices between are looked at; lack, and moves, that stay."""
SLACK, PASSES = 0.0003, 2
"""[m] by which samples that lack nothing hold nodes back; times that nodes move."""
TOUCHES, OPPOSED, HALF = 0.045, 0.5, 0.5
"""[m] So far from a sample far places of its cloth count for it; cosine from which they do in full; and the part of
what is lacking that each of two places makes up for."""
FLATTENED = 0.3
"""Volume that detail is turned back by at least."""


class Planes(NamedTuple):
    """Where samples are from the skin. off: (s,) [m]. normals: (s, 3). holds: (s,) in how far that holds, 0 to 1."""

    off: np.ndarray
    normals: np.ndarray
    holds: np.ndarray


class Skin(NamedTuple):
    """Posed points (q, 3) and their unit normals (q, 3); of blocks, middles and unit normals (q / 8, 3)."""

    points: np.ndarray
    normals: np.ndarray
    middles: np.ndarray
    facing: np.ndarray

    @classmethod
    def posed(cls, bound, bones):
        """By bones (b, 3, 4). A block goes with the mean of its points' blended transforms."""
        followed = bound.skin_bones, bound.skin_weights.astype(np.float64)
        points, normals = _on_bones(bound.skin_positions, bound.skin_normals, *followed, bones)
        of_blocks = len(points) // SKIN_BLOCK, SKIN_BLOCK, -1
        middle, facing = (
            of.astype(np.float64).reshape(of_blocks).mean(axis=1) for of in (bound.skin_positions, bound.skin_normals)
        )
        followed = (of.reshape(of_blocks[0], -1) for of in (bound.skin_bones, bound.skin_weights / SKIN_BLOCK))
        return cls(points, normals, *_on_bones(middle, unit(facing), *followed, bones))


class Movers:
    """Nodes that move, `count` of them, and how samples go with them: nodes, weights (s, J). again: (k,) samples that
    stand behind the others once more, and do not hold back twice."""

    def __init__(self, nodes, weights, count, again=()):
        at = np.arange(nodes.size + 1, step=nodes.shape[1] or 1)
        weights = weights.astype(np.float64).reshape(-1)
        self.weights = csr_array((weights, nodes.reshape(-1), at), shape=(len(nodes), count))
        self.slack = SLACK * self.weights.sum(axis=0)
        self.weights = self.weights[np.r_[: len(nodes), np.asarray(again, dtype=int)]]

    def move(self, left, planes, shares=1.0):
        """Moves (count, 3) for shares (s,) of what samples lack, and how far these then are off (s,)."""
        moves = np.zeros((self.weights.shape[1], 3))
        for _ in range(PASSES):
            lack = shares * lack_of(left, planes.holds)
            lack = np.where(lack > LEAST, lack, 0)
            counted, towards = self.weights.T @ lack, self.weights.T @ (lack[:, None] ** 2 * planes.normals)
            by = towards / np.where(counted > 0, counted + self.slack, 1)[:, None]
            moves, left = moves + by, left + (planes.normals * (self.weights @ by)).sum(axis=1)
        return moves, left


def keep_out(bound, bones, nodes, offsets):
    """Garment nodes (m, 3, 4) and offsets of detail nodes (D, 3) out of the skin of bones (b, 3, 4)."""
    if not len(bound.contact_vertices) or not len(bound.skin_positions):
        return nodes, offsets
    body, (at, normals) = Skin.posed(bound, bones), _samples(bound, nodes, offsets)
    left, planes = _lacking(meet_skin(body, at, normals, bound.contact_sides), bound.contact_gaps)
    carried = Movers(bound.contact_influence_nodes, bound.contact_influence_weights, len(nodes))
    shares = bound.contact_hangs if len(offsets) else 1.0
    moves, left = carried.move(left, planes, shares)
    at, nodes = at + carried.weights @ moves, nodes.copy()
    nodes[:, :, 3] += moves
    if not len(offsets):
        return nodes, offsets
    sample_of = _sample_of(bound, len(offsets))
    if len(bound.between_heights):
        share = _looked_at(bound, sample_of, lack_of(left, planes.holds))
        found = meet_skin(body, *_between(bound, sample_of, at, normals), bound.contact_sides[bound.between_blocks])
        off, found = _lacking(found._replace(holds=share * found.holds), bound.between_gaps)
        left, planes = np.concatenate([left, off]), Planes(*map(np.concatenate, zip(planes, found)))
    if len(bound.touching_samples):
        off, found = _lacking(meet_itself(bound, at, normals), bound.touching_gaps)
        found = found._replace(holds=HALF * found.holds)
        left, planes = np.concatenate([left, off]), Planes(*map(np.concatenate, zip(planes, found)))
    moves, _ = Movers(*_detail_of_all(bound), len(offsets), bound.touching_samples).move(left, planes)
    moves[(moves**2).sum(axis=1) <= LEAST**2] = 0
    return nodes, offsets + _turned_back(bound, nodes, sample_of, moves)


def clearance(bound, bones, nodes, offsets):
    """How far samples and vertices between them are from the skin, and samples that may touch far places of the cloth
    from these, (s + t + k,) [m]; 1 where none is near. nodes, offsets: of `keep_out`."""
    body, (at, normals) = Skin.posed(bound, bones), _samples(bound, nodes, offsets)
    of_samples = meet_skin(body, at, normals, bound.contact_sides)
    off = [np.where(of_samples.holds > 0, of_samples.off, 1.0)]
    if len(bound.between_heights):
        places = _between(bound, _sample_of(bound, len(offsets)), at, normals)
        found = meet_skin(body, *places, bound.contact_sides[bound.between_blocks])
        off.append(np.where(found.holds > 0, found.off, 1.0))
    if len(bound.touching_samples):
        found = meet_itself(bound, at, normals)
        off.append(np.where(found.holds > 0, found.off, 1.0))
    return np.concatenate(off)


def meet_skin(body, at, normals, sides):
    """Planes of cloth (s, 3) with normals (s, 3). sides: (blocks of cloth, blocks of skin)."""
    blocks = [slice(first, first + BLOCK) for first in range(0, len(at), BLOCK)]
    found = [_meet(body, at[each], normals[each], side) for each, side in zip(blocks, sides)]
    return Planes(*map(np.concatenate, zip(*found)))


def meet_itself(bound, at, normals):
    """Planes of samples that may touch far places of their cloth (k,): the mean of those near them that face as the
    sides of their blocks say. at, normals: (s, 3)."""
    at, normals = at[bound.touching_samples], normals[bound.touching_samples]
    block = np.arange(len(at)) // BLOCK
    sides = bound.touching_sides[block[:, None], block]
    apart = at[:, None] - at
    facing = np.where(sides < 0, -1, 1) * (normals @ normals.T)
    share = np.maximum(1 - (apart**2).sum(axis=2) / TOUCHES**2, 0) ** 2 * np.clip(facing / OPPOSED, 0, 1)
    share = np.where(sides == 0, 0, share)
    signed = np.where(sides > 1, -1, 1) * share
    off = np.einsum("ab,abi,bi->a", signed, apart, normals) / np.maximum(share.sum(axis=1), 1e-9)
    return Planes(off, unit(signed @ normals), np.minimum(share.sum(axis=1), 1))


def _meet(body, at, normals, side):
    facing = side * (normals @ body.facing.T)
    away = np.clip((FACING - facing) / TURN, 0, 1)
    turned = np.where(side == 0, np.inf, REACH**2 * away**2 * (3 - 2 * away))
    farther = ((at[:, None] - body.middles) ** 2).sum(axis=2) + turned
    counts = (farther < (np.sqrt(farther.min(axis=1, keepdims=True)) + BEYOND) ** 2).any(axis=0)
    points, of_points = (
        of.reshape(len(counts), SKIN_BLOCK, 3)[counts].reshape(-1, 3) for of in (body.points, body.normals)
    )
    apart = at[:, None] - points
    distance = (apart**2).sum(axis=2)
    square = distance + np.repeat(turned[:, counts], SKIN_BLOCK, axis=1)
    least = square.min(axis=1, initial=REACH**2)
    share = np.maximum(1 - (square - least[:, None]) / (BLEND**2 + BLEND_FAR * least)[:, None], 0) ** 2
    share /= np.maximum(share.sum(axis=1), 1e-9)[:, None]
    off = (share * (apart * of_points).sum(axis=2)).sum(axis=1)
    beside = np.sqrt(np.maximum((share * distance).sum(axis=1) - off**2, 0))
    held = np.where(off < 0, np.clip((ASIDE + ASIDE_FADE - beside) / ASIDE_FADE, 0, 1), 1)
    return off, unit(share @ of_points), held * np.clip((REACH - np.sqrt(least)) / (FADE_SHARE * REACH), 0, 1)


def lack_of(left, holds):
    """(s,) [m] of samples that are so far off what they keep; it sets in without a kink."""
    wanted = np.maximum(-left, 0)
    return holds * np.where(wanted < 2 * SOFT, wanted**2 / (4 * SOFT), wanted - SOFT)


def _lacking(planes, gaps):
    """How far samples are off where lack begins (s,), and their planes, which hold nothing for those that lack nothing
    then."""
    left = planes.off - gaps - SOFT
    return left, planes._replace(holds=np.where(left < 0, planes.holds, 0))


def _on_bones(positions, normals, followed, weights, bones):
    """Where bones put positions (k, 3), and unit normals (k, 3)."""
    rest = np.zeros((len(bones), 3))
    sampled = SkinningData(
        node_rest=rest, vertices=positions, normals=normals, influence_nodes=followed, influence_weights=weights
    )
    at, normals = skin(sampled, bones)
    return at, unit(normals)


def _samples(bound, nodes, offsets):
    """(s, 3) where they are, and unit normals (s, 3)."""
    names = ("vertices", "normals", "influence_nodes", "influence_weights", "detail_nodes", "detail_weights")
    fields = {name: getattr(bound, f"contact_{name}") for name in names}
    sampled = SkinningData(node_rest=bound.node_rest, detail_node_count=bound.detail_node_count, **fields)
    at, normals = skin(sampled, nodes, offsets)
    return at, unit(normals)


def _sample_of(bound, count):
    """(D,) the sample that goes with each detail node most, the first of several."""
    nodes, weights = bound.contact_detail_nodes.reshape(-1), bound.contact_detail_weights.reshape(-1)
    order = np.lexsort([-np.arange(len(nodes)), weights, nodes])
    found = np.zeros(count, dtype=np.intp)
    positive = order[weights[order] > 0]
    found[nodes[positive]] = positive // bound.contact_detail_nodes.shape[1]  # of each node, the last one stays
    return found


def _looked_at(bound, sample_of, lack):
    """(t,) in how far vertices between samples count, block by block."""
    around = np.where(bound.between_weights > 0, lack[sample_of[bound.between_nodes]], 0).max(axis=1)
    most = np.maximum.reduceat(around, np.arange(0, len(around), BLOCK))
    return np.repeat(np.clip(most / LOOKS - 1, 0, 1), BLOCK)[: len(around)]


def _between(bound, sample_of, at, normals):
    """Vertices between samples: the mean of those of their detail nodes, off it along the mean normal."""
    samples, weights = sample_of[bound.between_nodes], bound.between_weights.astype(np.float64)
    mean, normal = (np.einsum("tj,tji->ti", weights, of[samples]) for of in (at, normals))
    return mean + bound.between_heights[:, None] * normal, normal


def _detail_of_all(bound):
    """Detail nodes (s + t, J) of samples and vertices between, and by which weights."""
    if not len(bound.between_heights):
        return bound.contact_detail_nodes, bound.contact_detail_weights
    return (
        np.concatenate([getattr(bound, f"{kind}_{name}") for kind in ("contact_detail", "between")])
        for name in ("nodes", "weights")
    )


def _turned_back(bound, nodes, sample_of, moves):
    """(D, 3) at rest, what moves detail nodes by moves (D, 3) in the root frame."""
    influences, weights = bound.contact_influence_nodes[sample_of], bound.contact_influence_weights[sample_of]
    linear = np.einsum("dk,dkij->dij", weights.astype(np.float64), nodes[influences][..., :3])
    x, y, z = np.moveaxis(linear, 2, 0)
    volume = np.maximum((x * np.cross(y, z)).sum(axis=1), FLATTENED)
    rows = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    return np.einsum("dij,dj->di", rows, moves) / volume[:, None]
