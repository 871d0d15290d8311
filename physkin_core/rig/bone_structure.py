"""Which joint of a skeleton is which bone of the rig, by its shape, where names say nothing or not all.

A person's skeleton has a plane of symmetry, two pairs of long limbs that leave it, the legs nearer to the tree's root,
and two long segments in every limb. Dimensions: `j` joints. Any unit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, permutations, product

import numpy as np

from physkin_core.rig.rig import Rig, ancestors

__all__ = ["LIMB_BONES", "bones_by_limbs", "bones_by_structure", "limb_ends", "spine_bones", "spine_by_place"]

ASYMMETRY = 0.03
"""Of all following lengths the unit is the skeleton's largest extent. Mean distance of joints from mirror images."""
MIDLINE = 0.02
PAIR_GAP = 0.06
"""Between a limb's first joint and the mirror image of its counterpart."""
SHORTEST_LIMB = 0.2
LIMB_OFFSET = {"arm": 0.085, "leg": 0.03}
"""Least distance of shoulders and hips from the plane of symmetry: collar bones and halves of a pelvis begin nearer."""
SEGMENT_RATIO = {"arm": 1.12, "leg": 0.9}
"""Length of the upper over the lower segment; rigs differ in where hips are."""
RATIO_WEIGHT = 4.0
ANKLE_WEIGHT = 2.0
"""Of the turn from shin to foot."""
BRANCH = 0.4
"""Share of the longest branch that makes another one a branch, as thumb and fingers are."""
END_RATIO = (0.6, 1.6)
"""Length of the lower over the upper segment, of a limb whose end no name tells."""
SPINE_REACH = 0.12
"""How far, of the way from hips to neck, a joint of the spine may be from where the rig has its bone."""
LIMB_BONES = {
    "arm": ("upperarm01", "lowerarm01", "wrist", "clavicle"),
    "leg": ("upperleg01", "lowerleg01", "foot", ""),
}
"""Bones without their side at which upper and lower segment and the end begin, and the one above."""


def bones_by_structure(heads: np.ndarray, parents: np.ndarray, rig: Rig) -> dict[str, int] | None:
    """Joint by rig bone, or None for a skeleton that is not a person's, standing with its limbs held symmetrically.

    heads: (j, 3), axes of the root frame or quarter turns of them. parents: (j,), -1 for none, a parent before its
    children. Left is told from the feet's direction; without toes it is where the coordinate is larger, as in the root
    frame and in glTF's.
    """
    size = float(np.ptp(heads, axis=0).max())
    if not size > 0:
        return None
    tree = _Tree(heads / size, parents)
    axis = int(np.argmin(asymmetry := [tree.asymmetry(axis) for axis in range(3)]))
    if asymmetry[axis] > ASYMMETRY:
        return None
    limbs = _limbs(tree, axis)
    if limbs is None:
        return None
    found: dict[str, int] = {}
    chosen = {kind: [_joints_of(tree, way, kind, axis) for way in ways] for kind, (_, ways) in limbs.items()}
    if any(joints is None for both in chosen.values() for joints in both):
        return None
    hub, chest = limbs["leg"][0], limbs["arm"][0]
    sides = "LR" if _first_is_left(tree, axis, chosen, hub, chest) else "RL"
    for kind, both in chosen.items():
        for side, joints in zip(sides, both):
            found |= {f"{bone}.{side}": joint for bone, joint in zip(LIMB_BONES[kind], joints) if bone and joint >= 0}
    return _known(found | _trunk(tree, hub, chest, [way[0] for way in limbs["arm"][1]], rig), rig)


def bones_by_limbs(
    limbs: Mapping[tuple[str, str], Sequence[int]], heads: np.ndarray, parents: np.ndarray, rig: Rig
) -> dict[str, int] | None:
    """Joint by rig bone where it is known which joints are of which limb, in any pose; None where a limb is no chain of
    three joints. Of longer chains the two longest segments that follow each other are the limb's.

    limbs: joints by limb ("arm" or "leg") and side ("L" or "R"). heads: (j, 3), any unit. parents: (j,), as above.
    """
    tree = _Tree(heads, parents)
    found: dict[str, int] = {}
    starts: dict[str, list[int]] = {}
    for (kind, bones), side in product(LIMB_BONES.items(), "LR"):
        joints = limbs.get((kind, side), ())
        chain = sorted(joints, key=lambda joint: len(ancestors(tree.parents, joint)))
        if len(chain) < 3 or any(tree.parents[below] != above for above, below in zip(chain, chain[1:])):
            return None
        lengths = tree.edges[chain[1:]]
        first = int(np.argmax(np.minimum(lengths[:-1], lengths[1:])))
        found |= {f"{bone}.{side}": joint for bone, joint in zip(bones[:3], chain[first : first + 3])}
        starts.setdefault(kind, []).append(chain[0])
    hub, chest = (_meeting(tree, *starts[kind]) for kind in ("leg", "arm"))
    if hub is None or chest is None or hub not in ancestors(tree.parents, chest):
        return None
    arms = [next(j for j in ancestors(tree.parents, start) if tree.parents[j] == chest) for start in starts["arm"]]
    return _known(found | _trunk(tree, hub, chest, arms, rig), rig)


def _known(found: Mapping[str, int], rig: Rig) -> dict[str, int]:
    return {bone: joint for bone, joint in found.items() if bone in rig.bone_names}


def _meeting(tree: _Tree, one: int, other: int) -> int | None:
    """The nearest joint that both follow on."""
    above = ancestors(tree.parents, other)[1:]
    return next((joint for joint in ancestors(tree.parents, one)[1:] if joint in above), None)


def limb_ends(named: Mapping[str, int], heads: np.ndarray, parents: np.ndarray) -> dict[str, int]:
    """Joints of wrists and ankles that are not among the named ones (joint by rig bone), where the rest of the limb is.

    Of the joints that follow on elbow or knee it is the farthest, if it is as far as a person's. heads: (j, 3), any
    unit. parents: (j,).
    """
    found = {}
    for side, (upper, middle, end, _) in product("LR", LIMB_BONES.values()):
        first, joint = named.get(f"{upper}.{side}"), named.get(f"{middle}.{side}")
        if first is None or joint is None or f"{end}.{side}" in named:
            continue
        below = [child for child in np.flatnonzero(parents == joint) if child not in named.values()]
        lengths = [np.linalg.norm(heads[child] - heads[joint]) for child in below]
        upper_length = np.linalg.norm(heads[joint] - heads[first])
        if below and END_RATIO[0] * upper_length <= max(lengths) <= END_RATIO[1] * upper_length:
            found[f"{end}.{side}"] = int(below[int(np.argmax(lengths))])
    return found


def spine_by_place(named: Mapping[str, int], heads: np.ndarray, rig: Rig) -> dict[str, int]:
    """Joint by rig bone, with those of the spine where they are between hips and neck: one tool's torso begins at the
    chest, another's carries the legs.

    A joint that is not about where the rig has the bone it is named for goes to the nearest one there, unless that has
    a joint. named: joint by rig bone. heads: (j, 3), any unit.
    """
    ends = "upperleg01.L", "upperleg01.R", "neck01"
    spine = [bone for bone in spine_bones(rig) if bone in named]
    if not spine or any(bone not in named or bone not in rig.bone_names for bone in ends):
        return dict(named)

    def heights(place: Callable[[str], np.ndarray], bones: Sequence[str]) -> np.ndarray:
        hips = (place(ends[0]) + place(ends[1])) / 2
        trunk = place(ends[2]) - hips
        return np.array([(place(bone) - hips) @ trunk for bone in bones]) / max(trunk @ trunk, 1e-12)

    own = dict(zip(spine, heights(lambda bone: heads[named[bone]], spine)))
    usual = dict(zip(spine_bones(rig), heights(lambda bone: rig.heads[rig.bone_index(bone)], spine_bones(rig))))
    placed = {bone for bone in spine if abs(own[bone] - usual[bone]) <= SPINE_REACH}
    found = {bone: joint for bone, joint in named.items() if bone not in spine or bone in placed}
    for bone in spine:
        if bone not in placed:
            found.setdefault(min(usual, key=lambda other: abs(own[bone] - usual[other])), named[bone])
    return found


class _Tree:
    """Joints of a skeleton of unit size. reach: (j,) length of the longest way down from each."""

    def __init__(self, heads: np.ndarray, parents: np.ndarray) -> None:
        self.heads = heads - (heads.min(axis=0) + heads.max(axis=0)) / 2
        self.parents = [int(parent) for parent in parents]
        self.children: list[list[int]] = [[] for _ in parents]
        self.edges = np.zeros(len(parents))
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(joint)
                self.edges[joint] = np.linalg.norm(heads[joint] - heads[parent])
        self.reach = np.zeros(len(parents))
        for joint in reversed(range(len(parents))):
            self.reach[joint] = max((self.edges[c] + self.reach[c] for c in self.children[joint]), default=0.0)

    def asymmetry(self, axis: int) -> float:
        """Mean distance of joints from the mirror image of the nearest, those on the plane apart."""
        mirrored = self.heads * (1 - 2 * np.eye(3)[axis])
        beside = np.abs(self.heads[:, axis]) > MIDLINE
        gaps = np.linalg.norm(mirrored[beside, None] - self.heads[None], axis=2).min(axis=1)
        return float(gaps.mean()) if beside.any() else np.inf

    def straightness(self, before: int, joint: int, after: int) -> float:
        """Cosine of the turn at a joint; 1 where a neighbour lies at the same place."""
        come, go = self.heads[joint] - self.heads[before], self.heads[after] - self.heads[joint]
        length = np.linalg.norm(come) * np.linalg.norm(go)
        return float(come @ go / length) if length > 1e-9 else 1.0

    def way_down(self, joint: int) -> list[int]:
        """The longest way down, as far as the first joint with several branches."""
        way = [joint]
        while children := self.children[way[-1]]:
            lengths = {child: self.edges[child] + self.reach[child] for child in children}
            longest = max(children, key=lengths.__getitem__)
            others = [child for child in children if child != longest and not self._divides(child, longest)]
            if any(lengths[child] > BRANCH * lengths[longest] for child in others):
                break
            way.append(longest)
        return way

    def _divides(self, leaf: int, joint: int) -> bool:
        """Whether a joint without children lies on the way from its parent to another one, as twist joints do."""
        start = self.heads[self.parents[joint]]
        line, offset = self.heads[joint] - start, self.heads[leaf] - start
        share = offset @ line / max(line @ line, 1e-12)
        return not self.children[leaf] and share < 0.9 and bool(np.linalg.norm(offset - share * line) < MIDLINE)


def _limbs(tree: _Tree, axis: int) -> dict[str, tuple[int, list[list[int]]]] | None:
    """Of arms and of legs: the joint where both meet, and the way down from there on either side, the one with the
    larger coordinate along the axis first."""
    beside = np.abs(tree.heads[:, axis]) > MIDLINE
    starts = [j for j, p in enumerate(tree.parents) if p >= 0 and beside[j] and not beside[p]]
    pairs = []
    for one in (joint for joint in starts if tree.heads[joint, axis] > 0 and tree.reach[joint] > SHORTEST_LIMB):
        mirrored = tree.heads[one] * (1 - 2 * np.eye(3)[axis])
        other = min(starts, key=lambda joint: np.linalg.norm(tree.heads[joint] - mirrored))
        meeting = _meeting(tree, one, other)
        if meeting is not None and np.linalg.norm(tree.heads[other] - mirrored) < PAIR_GAP and other != one:
            ways = []
            for start in (one, other):
                above = ancestors(tree.parents, start)
                ways.append([*above[1 : above.index(meeting)][::-1], *tree.way_down(start)])
            pairs.append((tree.reach[one], meeting, ways))
    pairs.sort(key=lambda pair: -pair[0])
    for (_, hub, legs), (_, chest, arms) in permutations(pairs[:3], 2):
        if hub != chest and hub in ancestors(tree.parents, chest):
            return {"leg": (hub, legs), "arm": (chest, arms)}
    return None


def _joints_of(tree: _Tree, way: list[int], kind: str, axis: int) -> tuple[int, int, int, int, int] | None:
    """Joints at a limb's root, middle and end, before and after these (-1 for none).

    The longest two segments whose lengths are to each other as a person's; the foot turns off at the ankle.
    """
    along = np.cumsum([0.0, *tree.edges[way[1:]]])
    best, joints = -np.inf, None
    for first, middle, end in combinations(range(len(way)), 3):
        upper, lower = along[middle] - along[first], along[end] - along[middle]
        if min(upper, lower) < 1e-6 or abs(tree.heads[way[first], axis]) < LIMB_OFFSET[kind]:
            continue
        score = np.log(upper + lower) - RATIO_WEIGHT * np.log(upper / lower / SEGMENT_RATIO[kind]) ** 2
        after = max(tree.children[way[end]], key=lambda child: tree.edges[child], default=-1)
        if kind == "leg" and after >= 0:
            score += ANKLE_WEIGHT * (1 - tree.straightness(way[end - 1], way[end], after))
        if score > best:
            best, joints = score, (way[first], way[middle], way[end], way[first - 1] if first else -1, after)
    return joints


def _first_is_left(tree: _Tree, axis: int, limbs: dict, hub: int, chest: int) -> bool:
    """Whether the larger coordinate along the axis of symmetry is the skeleton's left."""
    up = tree.heads[chest] - tree.heads[hub]
    forward = sum((tree.heads[leg[4]] - tree.heads[leg[2]] for leg in limbs["leg"] if leg[4] >= 0), np.zeros(3))
    left = np.cross(up, forward - up * (forward @ up) / (up @ up))[axis]
    return bool(left >= 0) if abs(left) > 1e-4 else True


def _trunk(tree: _Tree, hub: int, chest: int, arms: list[int], rig: Rig) -> dict[str, int]:
    """Root, spine, neck and head. arms: joints that follow on the chest; of the others the longest way is the neck's.

    The joints between legs and arms are spread over the rig's spine.
    """
    found = {rig.bone_names[0]: hub}
    between = ancestors(tree.parents, chest)
    between = between[: between.index(hub)][::-1]
    spine = spine_bones(rig)
    for place, joint in enumerate(between, start=1):
        if spine:
            found[spine[max(round(place / len(between) * len(spine)), 1) - 1]] = joint
    if upwards := [joint for joint in tree.children[chest] if joint not in arms]:
        found["neck01"] = neck = max(upwards, key=lambda joint: tree.reach[joint] + tree.edges[joint])
        if above := tree.children[neck]:
            found["head"] = max(above, key=lambda joint: tree.reach[joint] + tree.edges[joint])
    return found


def spine_bones(rig: Rig) -> list[str]:
    """The rig's bones between its root and its collar bones."""
    if "clavicle.L" not in rig.bone_names:
        return []
    return [rig.bone_names[bone] for bone in rig.ancestors(rig.bone_index("clavicle.L"))[-2:0:-1]]
