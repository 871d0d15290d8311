"""Which joint of a skeleton is which bone of the rig, for avatars and motion alike.

A limb is three joints that descend from each other: where its upper and lower segment and its hand or foot begin. Every
such triple gets a cost for each limb, of what the joints' names say (`joint_names`) and of how long its segments are;
every pair of a left and a right triple one of how alike they are and where they meet. The cheapest arms and legs that
fit together are taken, and no limb where every triple costs `LACKING` or more: a refusal is better than an error.
Lengths are along the skeleton, so they do not depend on the pose; limbs that no name tells must mirror each other.

Dimensions: `j` joints, `t` triples. Any unit of length; costs that weigh lengths are shares of the skeleton's extent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.joint_names import plain_name, read_name, without_common_words
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["LIMB_BONES", "HumanSkeleton", "find_human_skeleton", "required_bones", "spine_bones"]

LIMB_BONES = {"arm": ("upperarm01", "lowerarm01", "wrist"), "leg": ("upperleg01", "lowerleg01", "foot")}
"""Bones without their side at which upper and lower segment and the end begin."""
LACKING = 12.0
"""Cost of a limb that no joints are taken for."""
UNNAMED, VAGUE, CONTRADICTED, NO_END = 3.0, 2.0, 14.0, 5.0
"""Cost of a joint whose name says nothing, its limb and side only, or another bone, and of a hand or foot that has no
joint. A name of the bone costs 0 to 1.3, a likely shape less than 1."""
LEVELS = 10
"""How many joints above a hand or foot its limb may begin."""
CANDIDATES = 64
"""Triples of a limb, and pairs of these, that are looked at further: the cheapest."""
SEGMENT_RATIO = {"arm": 1.12, "leg": 0.9}
"""Length of the upper over the lower segment; rigs differ in where hips are."""
RATIO_WEIGHT = 4.0
"""Cost of the logarithm of the lengths' ratio over `SEGMENT_RATIO`."""
MOST_SHAPE = 3.0
"""Most that the shape of a limb costs."""
UNLIKELY_RATIO = 0.6
"""From this logarithm on, no joint is taken without its name."""
ANKLE_WEIGHT = 2.0
"""Cost of the turn from shin to foot, 1 less its cosine."""
MOST_TURN = 0.6
"""Most of such a turn that counts."""
DIFFERENCE_WEIGHT = 2.0
"""Cost of the logarithm of left over right lengths."""
UNLIKE = 0.25
"""From this logarithm on, no limb is taken without its names."""
REACH_WEIGHT = 2.0
"""Cost of the distance between where two limbs meet and where they begin."""
ASYMMETRY = 0.03
"""Largest mean distance of joints from their mirror images in a skeleton with nameless limbs."""
MIDDLE = 0.02
"""Joints nearer to the middle than this have no mirror image."""
MIRROR_GAP = 0.06
"""Largest distance of a limb's joint from its mirror image."""
LIMB_OFFSET = {"arm": 0.085, "leg": 0.03}
"""Least distance of nameless shoulders and hips from the middle: collar bones and halves of a pelvis begin nearer."""
BRANCH = 0.4
"""Share of the longest branch's length from which on another one counts as a branch, as thumb and fingers do."""
PART_WAY = 0.9
"""Such a share for a branch without joints below it, which may just divide a bone as twist joints do."""
LONG_NECK = 1.6
"""Times its usual length over the trunk's: the last joint within is where the head begins."""
CLAVICLE = 0.02
"""Least length of a collar bone that its place alone tells."""
FACING = 0.005
"""Least sum of what feet, or knees and elbows, point forwards."""
FILE_START = 20
"""[characters] of a bones file, in an error."""
LISTED_NAMES = 3
"""Of each kind, in an error."""


@dataclass(frozen=True)
class HumanSkeleton:
    """What was recognised.

    Attributes:
        joints: joint by rig bone.
        costs: by bone of the limbs, how little the joint's name says so: 0 for names that mean nothing else, `VAGUE`
            for those that say the limb only, `UNNAMED` for joints that their place alone tells.
        missing: required bones that no joint was recognised as.
        own_names: whether all required bones have joints of the rig's own names.
        doubt: what else could not be told, a sentence; "" for nothing.
        sides_told: whether names tell left from right.
    """

    joints: dict[str, int]
    costs: dict[str, float]
    missing: tuple[str, ...]
    own_names: bool = False
    doubt: str = ""
    sides_told: bool = True

    def mirrored(self) -> HumanSkeleton:
        """The same with left and right exchanged, which is then in no doubt."""
        other = {"L": "R", "R": "L"}
        joints, costs = (
            {bone[:-1] + other.get(bone[-1], bone[-1]): value for bone, value in table.items()}
            for table in (self.joints, self.costs)
        )
        return replace(self, joints=joints, costs=costs, doubt="")

    def remarks(self, names: Sequence[str]) -> tuple[str, ...]:
        """What was assumed, for the user to read: joints that were taken for their place, and the doubt."""
        taken = [f"{shown(names[self.joints[bone]])} for {bone}" for bone, cost in self.costs.items() if cost >= VAGUE]
        remark = f"by their place in the skeleton, not by name, these joints were taken: {', '.join(taken)}"
        return (*((remark,) if taken else ()), *((self.doubt,) if self.doubt else ()))

    def refusal(self, names: Sequence[str], rig: Rig) -> str:
        """Which required bones are missing, which joints were taken for the others, and which for none; first come
        those that are named for what is missing. Last the start of a bones file."""
        taken = [f"{shown(names[joint])} as {bone}" for bone, joint in self.joints.items() if joint < len(names)]
        others = [name for joint, name in enumerate(names) if joint not in self.joints.values()]
        parts = {bone.split(".")[0] for bone in self.missing}
        others = [shown(name) for name in sorted(others, key=lambda name: parts.isdisjoint(read_name(name).bones))]
        return (
            f"no joint for {len(self.missing)} of the {len(required_bones(rig))} rig bones it must have: "
            f"{_some(self.missing)}; taken: {_some(taken, 1)}; not recognised: {_some(others)}. Put joints of a limb "
            f"below each other, or use --bones: {self.bones_file(names, rig)[:FILE_START]}…"
        )

    def bones_file(self, names: Sequence[str], rig: Rig) -> str:
        """Text of a bones file of the required bones, in which those that no joint was recognised as are empty."""
        known = {bone: names[joint] for bone, joint in self.joints.items() if joint < len(names)}
        return json.dumps({bone: known.get(bone, "") for bone in required_bones(rig)}, ensure_ascii=False)


def _some(texts: Sequence[str], most: int = LISTED_NAMES) -> str:
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return (", ".join(texts[:most]) or "none") + more


def required_bones(rig: Rig) -> tuple[str, ...]:
    """Bones every skeleton must have a joint for: the ends of the limb segments; all of them on a rig without these."""
    limbs = dict.fromkeys(name for segment in LIMB_SEGMENTS.values() for name in segment)
    return tuple(name for name in limbs if name in rig.bone_names) or rig.bone_names


def spine_bones(rig: Rig) -> list[str]:
    """The rig's bones between its root and its collar bones."""
    if "clavicle.L" not in rig.bone_names:
        return []
    return [rig.bone_names[bone] for bone in rig.ancestors(rig.bone_index("clavicle.L"))[-2:0:-1]]


def find_human_skeleton(
    names: Sequence[str],
    parents: np.ndarray,
    heads: np.ndarray,
    rig: Rig,
    *,
    humanoid: Mapping[str, int] | None = None,
    by_hand: Mapping[str, int] | None = None,
) -> HumanSkeleton:
    """Joint by bone of `rig`, as far as names, lengths, symmetry and hierarchy tell.

    Args:
        names: of the joints; they may say nothing.
        parents: (j,) -1 for none, a parent before its children.
        heads: (j, 3) places of the joints in any pose. Limbs that no name tells must be held symmetrically;
            where no name tells left from right, feet, knees or elbows tell where the skeleton faces.
        rig: the default rig. For one without its limbs, joints of its own names are found only.
        humanoid: joint by VRM humanoid bone; replaces the names where a file has it.
        by_hand: joint by rig bone, of a bones file; wins over all else.
    """
    by_hand = by_hand or {}
    if humanoid is not None:
        roles = {joint: role for role, joint in humanoid.items()}
        names = [roles.get(joint, "") for joint in range(len(names))]
    required, names = required_bones(rig), without_common_words(names)
    for bone, joint in by_hand.items():
        names = ["" if _means(name, bone) else name for name in names]
        names[joint] = bone
    plain = {plain_name(name): joint for joint, name in reversed(list(enumerate(names)))}
    joints = {bone: plain[plain_name(bone)] for bone in rig.bone_names if plain_name(bone) in plain}
    costs, doubt, told = dict.fromkeys(joints, 0.0), "", True
    own_names = all(bone in joints for bone in required)
    if not own_names and all(f"{bone}.{side}" in required for _, bone, side in _limb_bones()):
        tree = _Tree(names, np.asarray(parents), np.asarray(heads, dtype=np.float64))
        joints, doubt, told = _recognised(tree, rig)
        joints = {bone: joint for bone, joint in joints.items() if joint not in by_hand.values()} | dict(by_hand)
        costs = {bone: float(tree.name_cost(*bone.split("."))[joints[bone]]) for bone in required if bone in joints}
    missing = tuple(bone for bone in required if bone not in joints)
    return HumanSkeleton(joints, costs, missing, own_names, doubt, told)


def _means(name: str, bone: str) -> bool:
    """Whether a joint of this name would be taken for a bone first of all."""
    (part, _, side), said = bone.partition("."), read_name(name)
    return said.side == side and said.bones.get(part, CONTRADICTED) == min(said.bones.values(), default=0)


def _limb_bones() -> list[tuple[str, str, str]]:
    """Kind, bone and side of each joint of a limb."""
    return [(kind, bone, side) for kind, side in product(LIMB_BONES, "LR") for bone in LIMB_BONES[kind]]


class _Tree:
    """A skeleton's joints, of unit extent. said: what their names say. along: (j,) way from the root. reach: (j,) that
    of the farthest below. branchings: (j,) how many joints above branch. below: (j, j) bool, whether a joint (row) is
    another (column) or follows on it."""

    def __init__(self, names: Sequence[str], parents: np.ndarray, heads: np.ndarray) -> None:
        count = len(names)
        self.said = [read_name(name) for name in names]
        self.parents = parents
        self.heads = (heads - (heads.min(axis=0) + heads.max(axis=0)) / 2) / (np.ptp(heads, axis=0).max() or 1.0)
        self.along, self.below = np.zeros(count), np.eye(count, dtype=bool)
        self.children: list[list[int]] = [[] for _ in range(count)]
        for joint, parent in enumerate(parents):
            if parent >= 0:
                self.along[joint] = self.along[parent] + np.linalg.norm(self.heads[joint] - self.heads[parent])
                self.below[joint] |= self.below[parent]
                self.children[parent].append(joint)
        self.reach = np.array([self.along[below].max() for below in self.below.T])
        branches = np.array([self._branches(joint) for joint in range(count)])
        self.branchings = (self.below & branches).sum(axis=1) - branches
        self.turns = np.array([self._turn(joint) for joint in range(count)])

    def _branches(self, joint: int) -> bool:
        """Whether two long ways lead on from a joint."""
        lengths = {child: self.reach[child] - self.along[joint] for child in self.children[joint]}
        longest = max(lengths.values(), default=0.0)
        least = {child: BRANCH if self.children[child] else PART_WAY for child in lengths}
        return sum(length > least[child] * longest for child, length in lengths.items()) > 1

    def _turn(self, joint: int) -> float:
        """1 less the cosine of the turn from the way to a joint to that from there to its toes, 0 without these."""
        toe, parent = self.toes(joint), self.parents[joint]
        if toe is None or parent < 0:
            return 0.0
        come, go = self.heads[joint] - self.heads[parent], self.heads[toe] - self.heads[joint]
        length = np.linalg.norm(come) * np.linalg.norm(go)
        return 1 - float(come @ go / length) if length > 1e-9 else 0.0

    def toes(self, joint: int) -> int | None:
        """The farthest joint that follows on a foot."""
        return max(self.children[joint], key=lambda child: self.along[child], default=None)

    def name_cost(self, bone: str, side: str = "") -> np.ndarray:
        """(j,) cost of taking each joint for a bone, of its name."""
        kind = next((kind for kind, bones in LIMB_BONES.items() if bone in bones), "")
        cost = np.full(len(self.said), CONTRADICTED)
        for joint, said in enumerate(self.said):
            if said.side in ("", side) and said.limb in ("", kind):
                unknown = VAGUE if said.limb else UNNAMED
                cost[joint] = said.bones.get(bone, CONTRADICTED) if said.bones else unknown
        return cost

    def meeting(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(t,) the last joint that both joints (t,) follow on, -1 for none."""
        both = self.below[one] & self.below[other]
        return np.where(both.any(axis=1), (both * self.below.sum(axis=1)).argmax(axis=1), -1)

    def mirror_images(self) -> tuple[np.ndarray, np.ndarray]:
        """(j,) the joint at the mirror image of each, -1 for those that have none and for all of a skeleton that is not
        symmetric; and (j,) how far each is from the mirror, which stands across an axis, or else a principal axis."""
        best, images, off = ASYMMETRY, np.full(len(self.said), -1), np.zeros(len(self.said))
        middle = self.heads.mean(axis=0)
        principal = np.linalg.eigh(np.cov((self.heads - middle).T, bias=True))[1].T
        for normals, at in ((np.eye(3), np.zeros(3)), (principal, middle)):
            for normal in normals:
                away = (self.heads - at) @ normal
                gaps = np.linalg.norm((self.heads - 2 * away[:, None] * normal)[:, None] - self.heads, axis=2)
                beside = np.abs(away) > MIDDLE
                asymmetry = gaps.min(axis=1)[beside].mean() if beside.any() else np.inf
                if asymmetry <= best:
                    best, off = asymmetry, away
                    images = np.where(gaps.min(axis=1) < MIRROR_GAP, gaps.argmin(axis=1), -1)
            if (images >= 0).any():
                break
        return images, np.abs(off)


@dataclass(frozen=True)
class _Pair:
    """Both arms or both legs: joints (2, 3), left first, -1 for none; cost; where they meet, -1 for nowhere; whether
    names tell them."""

    joints: np.ndarray
    cost: float
    meeting: int
    named: bool


def _triples(tree: _Tree) -> np.ndarray:
    """(t, 3) joints that descend from each other, `LEVELS` joints apart at most; the last may be -1, the first triple
    is none at all."""
    above = [np.arange(len(tree.parents))]
    for _ in range(LEVELS):
        above.append(np.where(above[-1] >= 0, tree.parents[above[-1]], -1))
    found = [
        np.stack([above[k] for k in ways[::-1]], axis=1) for ways in combinations(range(LEVELS + 1), 3) if not ways[0]
    ]
    found += [np.stack([above[first], above[0], 0 * above[0] - 1], axis=1) for first in range(1, LEVELS)]
    every = np.concatenate(found)
    return np.concatenate([np.full((1, 3), -1), every[(every[:, :2] >= 0).all(axis=1)]])


def _triple_costs(tree: _Tree, triples: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs (2, t) of triples as a left and as a right limb, how many of their joints names tell (2, t), and lengths
    (2, t) of upper and lower segment."""
    first, middle, end = triples.T
    upper = np.maximum(tree.along[middle] - tree.along[first], 1e-6)
    lower = np.maximum(tree.along[end] - tree.along[middle], 1e-6)
    lower[end < 0] = upper[end < 0] / SEGMENT_RATIO[kind]
    ratio = np.abs(np.log(upper / lower / SEGMENT_RATIO[kind]))
    shape = np.clip(RATIO_WEIGHT * ratio**2 - np.log(upper + lower), 0, MOST_SHAPE)
    if kind == "leg":
        shape -= ANKLE_WEIGHT * np.where(end >= 0, np.minimum(tree.turns[end], MOST_TURN), 0)
    branched = tree.branchings[np.where(end < 0, middle, end)] > tree.branchings[first]
    bones = LIMB_BONES[kind]
    named = np.array([[tree.name_cost(bone, side)[of] for bone, of in zip(bones, triples.T)] for side in "LR"])
    named[:, 2, end < 0] = NO_END
    told = (named < UNNAMED).sum(axis=1)
    doubtful = (told < 3) & (ratio > UNLIKELY_RATIO) | (told < 2) & branched
    costs = named.sum(axis=1) + shape + np.where(doubtful, CONTRADICTED, 0)
    costs[:, 0], told[:, 0] = LACKING, 3
    return costs, told, np.stack([upper, lower])


def _pairs(tree: _Tree, triples: np.ndarray, kind: str) -> list[_Pair]:
    """The cheapest pairs of a left and a right limb, and that of none."""
    costs, told, lengths = _triple_costs(tree, triples, kind)
    cheapest = np.argsort(costs, axis=1, kind="stable")[:, :CANDIDATES]
    candidates = ([0, *(k for k in some if each[k] < LACKING)] for each, some in zip(costs, cheapest))
    left, right = (grid.ravel() for grid in np.meshgrid(*candidates, indexing="ij"))
    joints, both = np.stack([triples[left], triples[right]], axis=1), (left > 0) & (right > 0)
    firsts = joints[:, 0, 0], joints[:, 1, 0]
    meeting = np.where(both, tree.meeting(*firsts), -1)
    differences = np.abs(np.log(lengths[:, left] / lengths[:, right]))
    reach = sum(np.minimum(np.abs(tree.along[each] - tree.along[meeting]), 0.5) for each in firsts)
    cost = costs[0, left] + costs[1, right] + (meeting >= 0) * REACH_WEIGHT * reach
    cost += both * DIFFERENCE_WEIGHT * np.minimum(differences, 1).sum(axis=0)
    images, off = tree.mirror_images()
    mirrored = (images[joints[:, 0]] == joints[:, 1]).all(axis=1) & (joints >= 0).all(axis=(1, 2))
    mirrored &= (off[firsts[0]] > LIMB_OFFSET[kind]) & (meeting >= 0)
    told_of_both = np.minimum(told[0, left], told[1, right])
    alike = (differences < UNLIKE).all(axis=0) | (joints[:, :, 2] < 0).any(axis=1)
    named = (told_of_both >= 2) & (alike | (told_of_both == 3))
    apart = ~(tree.below[firsts] | tree.below[firsts[::-1]])
    cost[~np.where(both, apart & (named | mirrored), named)] = np.inf
    best = [*np.argsort(cost, kind="stable")[:CANDIDATES], 0]
    return [_Pair(joints[k], cost[k], int(meeting[k]), bool(named[k])) for k in best if np.isfinite(cost[k])]


def _recognised(tree: _Tree, rig: Rig) -> tuple[dict[str, int], str, bool]:
    """Joint by rig bone, what could not be told, and whether names tell left from right."""
    triples = _triples(tree)
    pairs = product(*(_pairs(tree, triples, kind) for kind in LIMB_BONES))
    cheapest_first = sorted(pairs, key=lambda both: both[0].cost + both[1].cost)
    arms, legs = next(both for both in cheapest_first if _fit_together(tree, *both))
    limbs, doubt = np.stack([arms.joints, legs.joints]), ""
    told = _side_is_told(tree, limbs)
    if limbs.min() >= 0 and not told:
        limbs, doubt = _by_facing(tree, limbs)
    bones = [f"{bone}.{side}" for _, bone, side in _limb_bones()]
    found = {bone: int(joint) for bone, joint in zip(bones, limbs.ravel()) if joint >= 0}
    return _with_trunk(tree, found, arms, legs, rig), doubt, told


def _fit_together(tree: _Tree, arms: _Pair, legs: _Pair) -> bool:
    """Whether arms and legs can be those of one skeleton."""
    named = arms.named and legs.named
    if min(arms.meeting, legs.meeting) < 0:
        return named
    across = [tree.heads[each.joints[0, 0]] - tree.heads[each.joints[1, 0]] for each in (arms, legs)]
    if across[0] @ across[1] < 0 and not all(_side_is_told(tree, each.joints) for each in (arms, legs)):
        return False
    arms_above = tree.below[arms.meeting, legs.meeting] and arms.meeting != legs.meeting
    return named or bool(arms_above and not tree.below[arms.joints[:, 0]][:, legs.joints[:, 0]].any())


def _side_is_told(tree: _Tree, joints: np.ndarray) -> bool:
    return any(tree.said[joint].side for joint in joints.ravel() if joint >= 0)


def _by_facing(tree: _Tree, limbs: np.ndarray) -> tuple[np.ndarray, str]:
    """The limbs (arms and legs, left and right, 3) with the sides that feet, or knees and elbows, say; and a sentence
    where they do not."""
    heads = tree.heads[limbs]
    up = heads[0, :, 0].mean(axis=0) - heads[1, :, 0].mean(axis=0)
    across = (heads[:, 0, 0] - heads[:, 1, 0]).sum(axis=0)
    feet = [(tree.toes(foot), foot) for foot in limbs[1, :, 2].tolist()]
    forward = sum((tree.heads[toe] - tree.heads[foot] for toe, foot in feet if toe is not None), np.zeros(3))
    if not forward.any():  # knees lie before the line from hip to ankle, elbows behind theirs
        line = heads[:, :, 2] - heads[:, :, 0]
        bend = heads[:, :, 1] - heads[:, :, 0]
        length = np.maximum((line**2).sum(axis=-1, keepdims=True), 1e-12)
        bend -= line * (bend * line).sum(axis=-1, keepdims=True) / length
        forward = (bend[1] - bend[0]).sum(axis=0)
    left = np.cross(up, forward) @ across / max(float(np.linalg.norm(up) * np.linalg.norm(across)), 1e-12)
    if abs(left) > FACING:
        return (limbs[:, ::-1] if left < 0 else limbs), ""
    doubt = "left and right are a guess: neither names nor feet, knees or elbows tell where the skeleton faces"
    return (limbs[:, ::-1] if across[np.abs(across).argmax()] < 0 else limbs), doubt


def _with_trunk(tree: _Tree, joints: dict[str, int], arms: _Pair, legs: _Pair, rig: Rig) -> dict[str, int]:
    """The joints with those of collar bones, root, spine, neck and head."""
    from scipy.optimize import linear_sum_assignment

    hub, chest, found = legs.meeting, arms.meeting, dict(joints)
    if hub >= 0:
        found[rig.bone_names[0]] = hub
    for bone in ("neck01", "head"):
        cost = tree.name_cost(bone) + np.where(tree.below[:, max(hub, 0)], 0, CONTRADICTED)
        if cost.min() < VAGUE:
            found[bone] = int(np.argmin(cost))
    if chest >= 0:
        firsts = [joints[f"upperarm01.{side}"] for side in "LR"]
        for side, arm in zip("LR", firsts):
            found |= _clavicle(tree, side, arm, chest)
        if not (arms.named and legs.named):
            onward = [child for child in tree.children[chest] if not tree.below[firsts, child].any()]
            upwards = []
            while onward:
                upwards.append(max(onward, key=lambda joint: tree.reach[joint]))
                onward = tree.children[upwards[-1]]
            if upwards and "neck01" not in found:
                found["neck01"] = upwards[0]
            if len(upwards) > 1 and "head" not in found and {"neck01", "head"} <= set(rig.bone_names):
                root, neck, head = (rig.heads[rig.bone_index(bone)] for bone in (rig.bone_names[0], "neck01", "head"))
                usual = np.linalg.norm(head - neck) / np.linalg.norm(neck - root)
                length = usual * (tree.along[upwards[0]] - tree.along[max(hub, 0)])
                near = [joint for joint in upwards if tree.along[joint] - tree.along[upwards[0]] < LONG_NECK * length]
                found["head"] = max(near[-1], upwards[1], key=upwards.index)
        if found.get("neck01") == chest:  # 3ds Max's bipeds hang their collar bones on the neck
            chest = int(tree.parents[chest])
    spine = spine_bones(rig)
    if spine and min(hub, chest) >= 0 and tree.below[chest, hub]:
        between = [joint for joint in ancestors(tree.parents, chest) if joint != hub and tree.below[joint, hub]]
        own, usual = {bone: tree.heads[joint] for bone, joint in found.items()}, dict(zip(rig.bone_names, rig.heads))
        top = ("neck01",) if "neck01" in found else ("upperarm01.L", "upperarm01.R")
        heights = _heights(own, top, tree.heads[between]), _heights(usual, top, [usual[bone] for bone in spine])
        assigned = linear_sum_assignment(np.abs(heights[0][:, None] - heights[1]))
        found |= {spine[bone]: between[joint] for joint, bone in zip(*assigned)}
    return {bone: joint for bone, joint in found.items() if bone in rig.bone_names}


def _clavicle(tree: _Tree, side: str, arm: int, chest: int) -> dict[str, int]:
    """The joint between chest and upper arm that is named for a collar bone, else the last, if it is one's length."""
    between = [joint for joint in ancestors(tree.parents, arm)[1:] if joint != chest and tree.below[joint, chest]]
    cost = tree.name_cost("clavicle", side)
    named = [joint for joint in between if cost[joint] < VAGUE]
    placed = [j for j in between[-1:] if cost[j] < CONTRADICTED and tree.along[arm] - tree.along[j] > CLAVICLE]
    return {f"clavicle.{side}": joint for joint in (named or placed)[:1]}


def _heights(heads: Mapping[str, np.ndarray], top: Sequence[str], points: Sequence[np.ndarray]) -> np.ndarray:
    """How high points (k, 3) are between hips, 0, and the top's bones, 1."""
    hips = (heads["upperleg01.L"] + heads["upperleg01.R"]) / 2
    trunk = np.mean([heads[bone] for bone in top], axis=0) - hips
    return (np.asarray(points) - hips) @ trunk / max(trunk @ trunk, 1e-12)
