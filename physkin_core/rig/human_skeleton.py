"""Which joint of a skeleton is which bone of the rig, for avatars and motion alike.

A limb is three joints that descend from each other: where its upper and lower segment and its hand or foot begin. Every
such triple gets a cost for each limb, of what the joints' names say (`joint_names`) and of how long its segments are;
pairs of triples another, of how alike left and right are and where they meet; legs and arms a third, of how they are
to each other. The cheapest of all is taken, and no limb where every triple costs more than `LACKING`. Lengths are along
the skeleton, so they do not depend on the pose; only limbs that no name tells must mirror each other.

Dimensions: `j` joints, `t` triples. Any unit; an error in the assignment is worse than a refusal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.joint_names import JointName, plain_name, read_name
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["LIMB_BONES", "HumanSkeleton", "find_human_skeleton", "required_bones", "spine_bones"]

LIMB_BONES = {"arm": ("upperarm01", "lowerarm01", "wrist"), "leg": ("upperleg01", "lowerleg01", "foot")}
"""Bones without their side at which upper and lower segment and the end begin."""
LIMBS = tuple(product(LIMB_BONES, "LR"))
LACKING = 12.0
"""Cost of a limb that no joints are taken for; others cost less."""
UNNAMED, VAGUE, CONTRADICTED = 3.0, 2.0, 14.0
"""Cost of a joint whose name says nothing, only its limb and side, or another bone. A bone's name costs 0 to 1.3."""
NO_END = 5.0
"""Cost of a limb whose hand or foot has no joint."""
LEVELS = 10
"""How many joints above a hand or foot its limb may begin."""
CANDIDATES = 64
"""Triples of a limb, and pairs of these, that are looked at further: the cheapest."""
SEGMENT_RATIO = {"arm": 1.12, "leg": 0.9}
"""Length of the upper over the lower segment; rigs differ in where hips are."""
RATIO_WEIGHT, MOST_SHAPE = 4.0, 3.0
ANKLE_WEIGHT, ANKLE_TURN = 2.0, 0.6
"""Of the turn from shin to foot, 1 less its cosine; the most that counts."""
ASYMMETRY_WEIGHT, REACH_WEIGHT = 2.0, 2.0
"""Of the logarithm of left over right lengths, and of the way from where limbs meet to where they begin."""
MIRROR_GAP = 0.06
"""Between a nameless limb and the other's image; of this and the following the unit is the skeleton's extent."""
ASYMMETRY, MIDDLE = 0.03, 0.02
"""Mean distance of joints from mirror images, those this near to the middle apart, of a skeleton without names."""
PARALLEL = 0.95
"""Least cosine between nameless hips and shoulders."""
LIMB_OFFSET = {"arm": 0.085, "leg": 0.03}
"""Least distance of nameless shoulders and hips from the middle: collar bones and halves of a pelvis begin nearer."""
BRANCH, PART_WAY = 0.4, 0.9
"""Share of the longest branch that makes another one a branch, as thumb and fingers are; and that an end short of which
only divides the way, as twist joints do."""
STRAIGHT = 0.9
"""Least distance over way along the skeleton of a nameless limb's segments."""
CLAVICLE = 0.02
"""Least length of a collar bone that its place alone tells."""
FACING = 0.005
"""Least sum of what feet, knees and elbows point forwards."""
LISTED_NAMES = 3
"""Of each kind, in an error."""


@dataclass(frozen=True)
class HumanSkeleton:
    """What was recognised.

    Attributes:
        joints: joint by rig bone.
        costs: by bone of the limbs, how little the joint's name says so: 0 for names that mean nothing else, `VAGUE`
            for those that say the limb only, `UNNAMED` for joints that their place alone tells.
        own_names: whether all required bones have joints of the rig's own names.
        missing: required bones that no joint was recognised for.
        doubt: what else could not be told, a sentence; "" for nothing.
        severed: joints whose names are those of a limb's bones, though they do not hang on each other.
    """

    joints: dict[str, int]
    costs: dict[str, float]
    own_names: bool
    missing: tuple[str, ...]
    doubt: str = ""
    severed: tuple[int, ...] = ()

    def remarks(self, names: Sequence[str]) -> tuple[str, ...]:
        """What was assumed, for the user to read: joints that were taken for their place."""
        placed = [bone for bone, cost in self.costs.items() if cost >= VAGUE]
        taken = ", ".join(f"{shown(names[self.joints[bone]])} for {bone}" for bone in placed)
        remark = f"by their place in the skeleton, not by name, these joints were taken: {taken}"
        return (*((remark,) if placed else ()), *((self.doubt,) if self.doubt else ()))

    def refusal(self, names: Sequence[str], required: int) -> str:
        """Which required bones are missing, which joints were taken for those that are not, and which are not known; or
        which joints are named for a limb and do not hang on each other."""
        if self.severed:
            limb = ", ".join(shown(names[joint]) for joint in self.severed)
            return (
                f"joints {limb} are not a limb: each must be above the next in the skeleton; rename or re-parent them"
            )
        taken = [f"{shown(names[joint])} as {bone}" for bone, joint in self.joints.items() if joint < len(names)]
        others = [shown(name) for joint, name in enumerate(names) if joint not in self.joints.values()]
        return (
            f"no joint for {len(self.missing)} of the {required} rig bones it must have: {_some(self.missing)}; taken: "
            f"{_some(taken)}; not recognised: {_some(others)}. Name joints as the rig, Mixamo, VRM or Unreal do"
        )


def _some(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - LISTED_NAMES} more" if len(texts) > LISTED_NAMES else ""
    return (", ".join(texts[:LISTED_NAMES]) or "none") + more


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
) -> HumanSkeleton:
    """Joint by bone of `rig`, as far as names, lengths, symmetry and hierarchy tell.

    Args:
        names: of the joints; they may say nothing.
        parents: (j,) -1 for none, a parent before its children.
        heads: (j, 3) places of the joints in any pose. Limbs that no name tells must be held symmetrically; if no name
            tells left from right, feet, knees and elbows must tell where the skeleton faces.
        rig: the default rig; of others, only joints of the rig's own names are found.
        humanoid: joint by VRM humanoid bone; replaces the names where a file has it.
    """
    if humanoid is not None:
        roles = {joint: role for role, joint in humanoid.items()}
        names = [roles.get(joint, "") for joint in range(len(names))]
    required = required_bones(rig)
    own = _own_names(names, rig)
    if all(bone in own for bone in required):
        return HumanSkeleton(own, {}, own_names=True, missing=())
    if len(required) < len(LIMBS) * 3:
        return HumanSkeleton(own, {}, False, tuple(bone for bone in required if bone not in own))
    tree = _Tree(names, np.asarray(parents), np.asarray(heads, dtype=np.float64))
    joints, doubt = _limbs_and_trunk(tree, rig)
    costs = {bone: float(tree.name_cost(*bone.split("."))[joints[bone]]) for bone in required if bone in joints}
    missing = tuple(bone for bone in required if bone not in joints)
    return HumanSkeleton(joints, costs, False, missing, doubt, _severed(tree, missing))


def _severed(tree: _Tree, missing: Sequence[str]) -> tuple[int, ...]:
    """Joints named for the bones of a limb that was not found, which do not follow on each other."""
    for kind, side in LIMBS:
        bones = [f"{bone}.{side}" for bone in LIMB_BONES[kind]]
        costs = [tree.name_cost(*bone.split(".")) for bone in bones]
        limb = tuple(int(np.argmin(cost)) for cost in costs)
        named = all(cost.min() < VAGUE for cost in costs)
        if named and set(bones) <= set(missing) and not (tree.below[limb[1], limb[0]] and tree.below[limb[2], limb[1]]):
            return limb
    return ()


def _own_names(names: Sequence[str], rig: Rig) -> dict[str, int]:
    joints: dict[str, int] = {}
    for joint, name in enumerate(names):
        joints.setdefault(plain_name(name), joint)
    return {bone: joints[plain_name(bone)] for bone in rig.bone_names if plain_name(bone) in joints}


class _Tree:
    """A skeleton's joints. said: what their names say. along: (j,) way from the root. reach: (j,) that of the farthest
    below. branchings: (j,) how many joints above branch. below: (j, j) bool, whether a joint (row) is another (column)
    or follows on it."""

    def __init__(self, names: Sequence[str], parents: np.ndarray, heads: np.ndarray) -> None:
        self.said: list[JointName] = [read_name(name) for name in names]
        self.parents, self.heads = parents, heads
        self.size = float(np.ptp(heads, axis=0).max()) or 1.0
        count = len(names)
        self.along, self.reach, self.depth = np.zeros(count), np.zeros(count), np.zeros(count, dtype=int)
        self.below = np.eye(count, dtype=bool)
        for joint, parent in enumerate(parents):
            if parent >= 0:
                self.along[joint] = self.along[parent] + np.linalg.norm(heads[joint] - heads[parent])
                self.depth[joint] = self.depth[parent] + 1
                self.below[joint] |= self.below[parent]
        for joint in reversed(range(count)):
            self.reach[joint] = max((self.reach[child] for child in self.children(joint)), default=self.along[joint])
        branches = np.array([self._branches(joint) for joint in range(count)])
        self.branchings = (self.below & branches).sum(axis=1) - branches

    def children(self, joint: int) -> list[int]:
        """Those that follow on a joint."""
        return np.flatnonzero(self.parents == joint).tolist()

    def _branches(self, joint: int) -> bool:
        """Whether two long ways lead on from a joint."""
        lengths = {child: self.reach[child] - self.along[joint] for child in self.children(joint)}
        longest = max(lengths.values(), default=0.0)
        least = {child: BRANCH if self.children(child) else PART_WAY for child in lengths}
        return sum(length > least[child] * longest for child, length in lengths.items()) > 1

    def toes(self, joint: int) -> int | None:
        """The farthest joint that follows on a foot."""
        return max(self.children(joint), key=lambda child: self.along[child], default=None)

    def name_cost(self, bone: str, side: str = "") -> np.ndarray:
        """(j,) cost of taking each joint for a bone, of its name."""
        kind = next((kind for kind, bones in LIMB_BONES.items() if bone in bones), "")

        def cost(said: JointName) -> float:
            if said.side and said.side != side or said.limb and said.limb != kind:
                return CONTRADICTED
            if said.bones:
                return said.bones.get(bone, CONTRADICTED)
            return VAGUE if said.limb else UNNAMED

        return np.array([cost(said) for said in self.said])

    def turn(self, joint: int) -> float:
        """1 less the cosine of the turn from the way to a joint to that from there to its toes, 0 without these."""
        toe, parent = self.toes(joint), self.parents[joint]
        if toe is None or parent < 0:
            return 0.0
        come, go = self.heads[joint] - self.heads[parent], self.heads[toe] - self.heads[joint]
        length = np.linalg.norm(come) * np.linalg.norm(go)
        return 1 - float(come @ go) / length if length > 1e-9 * self.size**2 else 0.0

    def meeting(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(t,) the last joint that both joints (t,) follow on, -1 for none."""
        both = self.below[one] & self.below[other]
        return np.where(both.any(axis=1), np.argmax(both * (1 + self.depth), axis=1), -1)


@dataclass(frozen=True)
class _Triples:
    """Candidates for a limb, the first of them none at all. joints: (t, 3) first, middle and end, -1 for none.
    cost: (t,). lengths: (t, 2) of both segments. told: (t,) how many of the joints are named."""

    joints: np.ndarray
    cost: np.ndarray
    lengths: np.ndarray
    told: np.ndarray


def _triples(tree: _Tree) -> np.ndarray:
    """(t, 3) joints that descend from each other, `LEVELS` joints apart at most; the last may be -1."""
    above = [np.arange(len(tree.parents))]
    for _ in range(LEVELS):
        above.append(np.where(above[-1] >= 0, tree.parents[above[-1]], -1))
    found = [np.stack([above[first], above[middle], above[0]], axis=1) for middle, first in _pairs(1)]
    found += [np.stack([above[first], above[0], np.full(len(above[0]), -1)], axis=1) for first in range(1, LEVELS)]
    every = np.concatenate(found)
    return every[(every[:, :2] >= 0).all(axis=1)]


def _pairs(start: int) -> list[tuple[int, int]]:
    return list(combinations(range(start, LEVELS + 1), 2))


def _candidates(tree: _Tree, triples: np.ndarray, kind: str, side: str, turns: np.ndarray) -> _Triples:
    """The cheapest triples for a limb."""
    first, middle, end = triples.T
    named = np.stack([tree.name_cost(bone, side)[joint] for bone, joint in zip(LIMB_BONES[kind], triples.T)], axis=1)
    named[end < 0, 2] = NO_END
    least = 1e-6 * tree.size
    upper = np.maximum(tree.along[middle] - tree.along[first], least)
    lower = np.maximum(tree.along[end] - tree.along[middle], least)
    lower[end < 0] = upper[end < 0] / SEGMENT_RATIO[kind]
    shape = RATIO_WEIGHT * np.log(upper / lower / SEGMENT_RATIO[kind]) ** 2 - np.log((upper + lower) / tree.size)
    shape = np.clip(shape, 0, MOST_SHAPE)
    if kind == "leg":
        shape -= ANKLE_WEIGHT * np.where(end >= 0, np.minimum(turns[end], ANKLE_TURN), 0)
    cost, told = named.sum(axis=1) + shape, (named < UNNAMED).sum(axis=1)
    cost[(told < 2) & (tree.branchings[np.where(end < 0, middle, end)] > tree.branchings[first])] = np.inf
    best = np.argsort(cost, kind="stable")[:CANDIDATES]
    best = best[cost[best] < LACKING]
    return _Triples(
        np.concatenate([np.full((1, 3), -1), triples[best]]),
        np.concatenate([[LACKING], cost[best]]),
        np.concatenate([np.ones((1, 2)), np.stack([upper, lower], axis=1)[best]]),
        np.concatenate([[3], told[best]]),
    )


@dataclass(frozen=True)
class _Pair:
    """Both arms or both legs: joints (2, 3), left first; cost; where they meet, -1 for nowhere; whether names tell."""

    joints: np.ndarray
    cost: float
    meeting: int
    named: bool


def _pairs_of(tree: _Tree, kind: str, left: _Triples, right: _Triples) -> list[_Pair]:
    """The cheapest pairs of a left and a right limb."""
    a, b = (grid.ravel() for grid in np.meshgrid(np.arange(len(left.cost)), np.arange(len(right.cost)), indexing="ij"))
    joints = np.stack([left.joints[a], right.joints[b]], axis=1)
    cost, both = left.cost[a] + right.cost[b], (a > 0) & (b > 0)
    cost += np.where(
        both, ASYMMETRY_WEIGHT * np.minimum(np.abs(np.log(left.lengths[a] / right.lengths[b])), 1).sum(axis=1), 0
    )
    firsts = joints[:, 0, 0], joints[:, 1, 0]
    meeting = np.where(both, tree.meeting(*firsts), -1)
    apart = ~(tree.below[firsts] | tree.below[firsts[::-1]]) & ((joints[:, 0, 2] < 0) == (joints[:, 1, 2] < 0))
    reach = sum(np.abs(tree.along[first] - tree.along[meeting]) for first in firsts) / tree.size
    cost += np.where(both & (meeting >= 0), REACH_WEIGHT * np.minimum(reach, 1), 0)
    named = (left.told[a] >= 2) & (right.told[b] >= 2)
    allowed = np.where(both, apart & (named | (_mirrored(tree, kind, joints) & (meeting >= 0))), named)
    cost[~allowed] = np.inf
    best = np.argsort(cost, kind="stable")[:CANDIDATES]
    return [_Pair(joints[k], float(cost[k]), int(meeting[k]), bool(named[k])) for k in best[np.isfinite(cost[best])]]


def _mirrored(tree: _Tree, kind: str, joints: np.ndarray) -> np.ndarray:
    """(t,) whether limbs (t, 2, 3) are each other's mirror images, begin away from the middle and are straight between
    their joints."""
    left, right = (tree.heads[joints[:, side]] for side in (0, 1))
    across = left[:, 0] - right[:, 0]
    apart = np.linalg.norm(across, axis=1)
    normal = (across / np.maximum(apart, 1e-9 * tree.size)[:, None])[:, None]
    from_middle = ((right - left[:, :1] + across[:, None] / 2) * normal).sum(axis=2, keepdims=True)
    gap = np.linalg.norm(right - 2 * from_middle * normal - left, axis=2).max(axis=1)
    away = apart / 2 >= LIMB_OFFSET[kind] * tree.size
    distances = np.linalg.norm(np.diff(tree.heads[joints], axis=2), axis=3)
    straight = (distances >= STRAIGHT * np.diff(tree.along[joints], axis=2)).all(axis=(1, 2))
    return (gap < MIRROR_GAP * tree.size) & away & straight & (joints >= 0).all(axis=(1, 2))


def _asymmetry(tree: _Tree, legs: _Pair) -> float:
    """Mean distance of joints from the mirror image of the nearest, across the middle of the legs."""
    left, right = tree.heads[legs.joints[:, 0]]
    normal = (left - right) / np.linalg.norm(left - right)
    aside = (tree.heads - (left + right) / 2) @ normal
    beside = np.abs(aside) > MIDDLE * tree.size
    mirrored = (tree.heads - 2 * aside[:, None] * normal)[beside]
    return float(np.linalg.norm(mirrored[:, None] - tree.heads, axis=2).min(axis=1).mean() / tree.size)


def _limbs_and_trunk(tree: _Tree, rig: Rig) -> tuple[dict[str, int], str]:
    """Joint by rig bone, and what could not be told."""
    triples, turns = _triples(tree), np.array([tree.turn(joint) for joint in range(len(tree.parents))])
    found = {limb: _candidates(tree, triples, *limb, turns) for limb in LIMBS}
    pairs = {kind: _pairs_of(tree, kind, found[kind, "L"], found[kind, "R"]) for kind in LIMB_BONES}
    together = sorted(product(pairs["arm"], pairs["leg"]), key=lambda both: both[0].cost + both[1].cost)
    arms, legs = next(both for both in together if _fit_together(tree, *both))
    if not (arms.named and legs.named) and _asymmetry(tree, legs) > ASYMMETRY:
        return {}, ""
    chosen, doubt = {"arm": arms.joints, "leg": legs.joints}, ""
    if not _side_is_told(tree, arms, legs) and min(arms.joints.min(), legs.joints.min()) >= 0:
        chosen, doubt = _by_facing(tree, chosen)
    joints: dict[str, int] = {}
    for (kind, both), side in product(chosen.items(), (0, 1)):
        limb = {f"{bone}.{'LR'[side]}": int(joint) for bone, joint in zip(LIMB_BONES[kind], both[side])}
        joints |= {bone: joint for bone, joint in limb.items() if joint >= 0}
    return _with_trunk(tree, joints, arms, legs, rig), doubt


def _fit_together(tree: _Tree, arms: _Pair, legs: _Pair) -> bool:
    """Whether arms and legs can be those of one skeleton: as names have them, or as a person's are held."""
    named = arms.named and legs.named
    if min(arms.joints[:, 0].min(), legs.joints[:, 0].min(), arms.meeting, legs.meeting) < 0:
        return named
    shoulders, hips = tree.heads[arms.joints[:, 0]], tree.heads[legs.joints[:, 0]]
    across, normal = (ends[0] - ends[1] for ends in (shoulders, hips))
    width = max(float(np.linalg.norm(normal)), 1e-12)
    along = across @ normal / max(float(np.linalg.norm(across)) * width, 1e-12)
    if along < 0 and not _side_is_told(tree, arms, legs):
        return False
    aside = (shoulders.mean(axis=0) - hips.mean(axis=0)) @ normal / width
    held_alike = along >= PARALLEL and abs(aside) <= MIDDLE * tree.size
    on_top = tree.below[arms.meeting, legs.meeting] and arms.meeting != legs.meeting
    return named or (held_alike and on_top and not tree.below[arms.joints[:, 0]][:, legs.joints[:, 0]].any())


def _side_is_told(tree: _Tree, arms: _Pair, legs: _Pair) -> bool:
    return any(tree.said[joint].side for pair in (arms, legs) for joint in pair.joints.ravel() if joint >= 0)


def _by_facing(tree: _Tree, limbs: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], str]:
    """The limbs with left and right as feet, knees and elbows say, and a sentence where they do not."""
    heads = {kind: tree.heads[both] for kind, both in limbs.items()}
    up = heads["arm"][:, 0].mean(axis=0) - heads["leg"][:, 0].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-12)
    across = sum(both[0, 0] - both[1, 0] for both in heads.values())
    toes = [(tree.toes(int(foot)), foot) for foot in limbs["leg"][:, 2] if foot >= 0]
    forward = sum((tree.heads[toe] - tree.heads[foot] for toe, foot in toes if toe is not None), np.zeros(3))
    if not forward.any():
        for kind, sense in (("leg", 1), ("arm", -1)):
            for first, middle, end in heads[kind]:
                line = end - first
                bend = middle - first - line * ((middle - first) @ line / max(line @ line, 1e-12))
                forward = forward + sense * bend
    left = np.cross(up, forward)
    if abs(left @ across) > FACING * tree.size * np.linalg.norm(across):
        swapped, doubt = left @ across < 0, ""
    else:
        swapped = across[np.argmax(np.abs(across))] < 0
        doubt = "left and right are a guess: neither names nor feet, knees or elbows tell where the skeleton faces"
    return {kind: both[::-1] if swapped else both for kind, both in limbs.items()}, doubt


def _with_trunk(tree: _Tree, joints: dict[str, int], arms: _Pair, legs: _Pair, rig: Rig) -> dict[str, int]:
    """The joints with those of collar bones, root, spine, neck and head."""
    from scipy.optimize import linear_sum_assignment

    hub, chest = legs.meeting, arms.meeting
    found = dict(joints)
    for side in "LR":
        if f"upperarm01.{side}" in joints:
            found |= _clavicle(tree, side, joints[f"upperarm01.{side}"], chest)
    if hub >= 0:
        found[rig.bone_names[0]] = hub
    for bone in ("neck01", "head"):
        cost = tree.name_cost(bone)
        if hub >= 0:
            cost = np.where(tree.below[:, hub], cost, CONTRADICTED)
        if cost.min() < VAGUE:
            found[bone] = int(np.argmin(cost))
    if chest >= 0 and not (arms.named and legs.named):
        firsts = joints["upperarm01.L"], joints["upperarm01.R"]
        onward = [child for child in tree.children(chest) if not tree.below[list(firsts), child].any()]
        for bone in ("neck01", "head"):
            if onward and bone not in found:
                found[bone] = max(onward, key=lambda joint: tree.reach[joint])
            onward = tree.children(found[bone]) if bone in found else []
    if found.get("neck01") == chest >= 0:  # 3ds Max's bipeds hang their collar bones on the neck
        chest = int(tree.parents[chest])
    if 0 <= hub and 0 <= chest and tree.below[chest, hub]:
        between = ancestors(tree.parents, chest)
        between = between[: between.index(hub)]
        if spine := spine_bones(rig):
            usual = dict(zip(rig.bone_names, rig.heads))
            own = {bone: tree.heads[joint] for bone, joint in found.items()}
            gaps = np.abs(_heights(own, tree.heads[between])[:, None] - _heights(usual, [usual[b] for b in spine]))
            found |= {spine[bone]: between[joint] for joint, bone in zip(*linear_sum_assignment(gaps))}
    return {bone: joint for bone, joint in found.items() if bone in rig.bone_names}


def _clavicle(tree: _Tree, side: str, arm: int, chest: int) -> dict[str, int]:
    """The joint between chest and upper arm that is named for a collar bone, else the last, if it is one's length."""
    above = ancestors(tree.parents, arm)[1:]
    between = above[: above.index(chest)] if chest in above else above[:1]
    cost = tree.name_cost("clavicle", side)
    named = [joint for joint in between if cost[joint] < VAGUE]
    placed = [j for j in between[:1] if chest >= 0 and tree.along[arm] - tree.along[j] > CLAVICLE * tree.size]
    return {f"clavicle.{side}": joint for joint in (named or [j for j in placed if cost[j] < CONTRADICTED])[:1]}


def _heights(heads: Mapping[str, np.ndarray], points: Sequence[np.ndarray]) -> np.ndarray:
    """How high points (k, 3) are between hips, 0, and neck, 1; without a neck between hips and shoulders."""
    hips = (heads["upperleg01.L"] + heads["upperleg01.R"]) / 2
    top = heads["neck01"] if "neck01" in heads else (heads["upperarm01.L"] + heads["upperarm01.R"]) / 2
    trunk = top - hips
    return (np.asarray(points) - hips) @ trunk / max(trunk @ trunk, 1e-12)
