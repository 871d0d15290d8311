"""The skeleton of the figure in a glTF file: its skins, its joints, and the pose that its body is taken in.

How a mesh was bound stands in the inverse bind matrices of its skin. The transforms of nodes only say how the figure
is held when the file is opened: midway through a kick, or turned to look at the door. So the body is taken from the
bind pose, that of the skin with the most vertices; other skins come there by their own inverse bind matrices, and
joints of no skin follow their parents.

Dimensions: `g` nodes, `k` joints of a skin. glTF's frame and the file's unit.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from physkin_core.avatar.skinned_mesh import check_bone_count
from physkin_core.file_reading import ContentError, listed
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_joints import nearest_above, skin_nodes, with_nodes_above
from physkin_core.model.surface_paths import pieces
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS, nearest_quarter_turn
from physkin_core.rig.human_skeleton import HumanSkeleton, find_human_skeleton
from physkin_core.rig.rig import MOST_BONES, Rig, ancestors

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["GltfSkeleton", "GltfSkin", "bind_worlds", "find_skeleton", "read_skins", "rigid_skeleton"]

SAME_POSE = 1e-3
"""Share of the skeleton's extent by which joints of one pose may be apart in another, for it to be the same."""
UNLIKE_LENGTHS = 1.5
"""Poses turn bones and leave their lengths: inverse bind matrices by which the length of a limb segment differs by this
factor from that between nodes, the median of all being one, are not those of a pose."""
STANDS = 0.5
"""Least cosine between a thigh or shin and the way from shoulders to hips of somebody who stands."""
AS_LARGE = 0.9
"""Of several figures the first is taken that has this share of the largest one's extent."""
COPY, NEAR = 0.02, 0.25
"""Shares of a figure's extent: how far the joints of its copy lie from its own at most, and how far from a joint of it
something that hangs on joints of its own begins, to be part of it."""


@dataclass(frozen=True)
class GltfSkin:
    """joints: (k,) nodes. inverse_binds, binds: (k, 4, 4), from mesh space to each joint and back; NaN where the file
    has none that can be inverted. given: whether it has any."""

    joints: list[int]
    inverse_binds: np.ndarray
    binds: np.ndarray
    given: bool

    @cached_property
    def place(self) -> dict[int, int]:
        """Its place in the skin, by node, of each joint whose bind is known."""
        known = np.isfinite(self.binds).all(axis=(1, 2))
        return {joint: k for k, joint in enumerate(self.joints) if known[k]}

    def transforms(self, file: GltfFile, worlds: np.ndarray) -> np.ndarray:
        """(k, 3, 4) from mesh space to the scene where nodes are at worlds (g, 4, 4). A joint whose bind is not known
        moves as the nearest one above whose bind is, or else as the first."""
        found, place = (worlds[self.joints] @ self.inverse_binds)[:, :3], self.place
        for k in np.flatnonzero(~np.isfinite(found).all(axis=(1, 2))):
            above = (place[each] for each in ancestors(file.node_parents, self.joints[k]) if each in place)
            found[k] = found[next(above, next(iter(place.values())))]
        return found


@dataclass(frozen=True)
class GltfSkeleton:
    """nodes: of its joints, parents first. joint: index among these, by node; nodes of others that move with it have
    one, too. worlds: (g, 4, 4) from node to scene, in the pose that the body is taken in. skins: of the figure and of
    what moves with it, by number. warnings: what was assumed or left out."""

    nodes: list[int]
    joint: dict[int, int]
    worlds: np.ndarray
    skins: dict[int, GltfSkin]
    warnings: tuple[str, ...] = ()


def find_skeleton(
    file: GltfFile, vertex_counts: Mapping[int, int], rig: Rig, humanoid: Mapping[str, int] | None
) -> GltfSkeleton:
    """The skeleton of the figure that is worn: of several people the largest, or the first of about that size.

    vertex_counts: by skin of the file, 0 for those that draw nothing. humanoid: node by VRM humanoid bone; a VRM is
    taken as its nodes stand, in T-pose. Raises ContentError.
    """
    check_bone_count(len({joint for entry in file.document.entries("skins") for joint in skin_nodes(file, entry)}))
    drawing = sorted(vertex_counts, key=lambda number: -vertex_counts[number])
    drawing = [number for number in drawing if vertex_counts[number] or not vertex_counts[drawing[0]]]
    groups = sorted(_groups(file, read_skins(file, drawing)), key=min)
    figures = [_Figure(file, group, rig, humanoid) for group in groups]
    people = [figure for figure in figures if len(figures) > 1 and not figure.human.missing]
    people = people or [figure for figure in figures if drawing[0] in figure.skins]
    people = [figure for figure in people if _stands(figure.human, figure.heads)] or people  # no horse
    largest = max(figure.extent for figure in people)
    chosen = next(figure for figure in people if figure.extent >= AS_LARGE * largest)
    joint, worlds = {node: k for k, node in enumerate(chosen.nodes)}, chosen.worlds.copy()
    worn, left_out = dict(chosen.skins), []
    for other in figures:
        carriers = None if other is chosen else chosen.carriers_of(other)
        if carriers is not None and other.human.missing:
            other.join_space(file, chosen)
            carriers = chosen.carriers_of(other)
        if carriers is not None:
            worn |= other.skins
            added = [node for node in other.nodes if node not in joint]
            joint = {node: int(k) for node, k in zip(other.nodes, carriers)} | joint
            worlds[added] = other.worlds[added]
        elif other is not chosen:
            left_out.append(_called(file, other.skins))
    warnings = ()
    if left_out:
        taken = f"{_called(file, chosen.skins)} is taken, the largest person or the first of that size"
        warnings = (f"{len(left_out) + 1} figures are in the file: {taken}; left out: {', '.join(left_out)}",)
    return GltfSkeleton(chosen.nodes, joint, worlds, worn, warnings)


def rigid_skeleton(file: GltfFile, rig: Rig) -> GltfSkeleton | None:
    """Of a file without skins whose nodes move rigid parts, as a robot's do: all its nodes as they stand. None where
    they are no person's, or not every limb segment has a mesh."""
    if not 0 < len(file.nodes) <= MOST_BONES:
        return None
    nodes, unmoved = list(range(len(file.nodes))), np.tile(np.eye(4), (len(file.nodes), 1, 1))
    figure = _Figure(file, {0: GltfSkin(nodes, unmoved, unmoved, given=False)}, rig, None)
    joints, place = figure.human.joints, {node: k for k, node in enumerate(figure.nodes)}
    carriers = nearest_above(file, {figure.nodes[joints[bone]]: bone for bone in LIMB_SEGMENTS if bone in joints})
    whole = {carriers.get(node) for node in nodes if "mesh" in file.nodes[node]} >= LIMB_SEGMENTS.keys()
    return GltfSkeleton(figure.nodes, place, figure.worlds, {}) if whole else None


class _Figure:
    """What hangs together: skins that share joints, or whose joints hang on each other's.

    nodes: joints and all above them, parents first. parents: of these, -1 for none. worlds: (g, 4, 4) in the pose that
    is taken. heads: of the nodes. extent: of these. skins: the largest first.
    """

    def __init__(
        self, file: GltfFile, skins: Mapping[int, GltfSkin], rig: Rig, humanoid: Mapping[str, int] | None
    ) -> None:
        self.skins, self._rig = skins, rig
        self.joints = {joint for skin in skins.values() for joint in skin.joints}
        self.nodes = with_nodes_above(file, {*(humanoid or {}).values(), *self.joints})
        check_bone_count(len(self.nodes))
        place = {node: k for k, node in enumerate(self.nodes)}
        self._names = [file.nodes[node].text("name") or f"node {node}" for node in self.nodes]
        self.parents = np.array([place.get(int(file.node_parents[node]), -1) for node in self.nodes], dtype=int)
        self._humanoid = None if humanoid is None else {bone: place[node] for bone, node in humanoid.items()}
        self.worlds = file.node_worlds
        if humanoid is None and any(skin.given for skin in skins.values()):
            self._take_bind_pose(bind_worlds(file, skins))
        self.heads = self.worlds[self.nodes][:, :3, 3]
        self.extent = float(np.ptp(self.heads, axis=0).max(initial=0.0))

    def join_space(self, file: GltfFile, figure: _Figure) -> None:
        """Lie as if bound in another figure's mesh space, where that is as near to it: most skins of a file share one,
        and nodes, by which spaces are told apart, may be held in another pose."""
        from scipy.spatial import cKDTree

        first = next(iter(figure.skins.values()))
        if not first.given or figure.worlds is file.node_worlds or not all(skin.given for skin in self.skins.values()):
            return
        worlds, own = file.node_worlds.copy(), list(self.joints)
        for node, world in _bound_worlds(file, *self.skins.values(), to_scene=_to_scene(file, first)).items():
            worlds[node] = world
        if _as_near(cKDTree(figure.heads), worlds[own][:, :3, 3], self.worlds[own][:, :3, 3]):
            self.worlds, self.heads = worlds, worlds[self.nodes][:, :3, 3]

    def carriers_of(self, other: _Figure) -> np.ndarray | None:
        """Which of this figure's joints each of another's (n,) moves with; None where it is a figure of its own or far.

        A chain, as of hair, moves with the joint at which it begins.
        """
        from scipy.spatial import cKDTree

        apart, nearest = cKDTree(self.heads).query(other.heads)
        if not other.human.missing:  # clothes may bring the skeleton
            shared = self.human.joints.keys() & other.human.joints.keys()
            gaps = [self.heads[self.human.joints[bone]] - other.heads[other.human.joints[bone]] for bone in shared]
            return nearest if np.linalg.norm(gaps, axis=1).max() < COPY * self.extent else None
        joints = np.isin(other.nodes, list(other.joints))
        begins = joints & ~((other.parents >= 0) & joints[other.parents])
        for k in np.flatnonzero(joints & ~begins):
            nearest[k] = nearest[other.parents[k]]
        return nearest if np.median(apart[begins]) < NEAR * self.extent else None

    def _take_bind_pose(self, worlds: np.ndarray) -> None:
        """Take the body from the bind pose, unless it is none, or the figure stands as its nodes are and not there."""
        heads, shown_heads = worlds[self.nodes][:, :3, 3], self.worlds[self.nodes][:, :3, 3]
        if np.abs(heads - shown_heads).max() > SAME_POSE * np.ptp(shown_heads, axis=0).max():
            human, shown_human = self._recognised(worlds), self.human
            is_pose = not human.missing and _same_lengths(human, heads, shown_heads)
            if not shown_human.missing and not (is_pose and _stands(human, heads) >= _stands(shown_human, shown_heads)):
                return
            self.human = human
        self.worlds = worlds

    @cached_property
    def human(self) -> HumanSkeleton:
        """What is recognised in the pose that is taken."""
        return self._recognised(self.worlds)

    def _recognised(self, worlds: np.ndarray) -> HumanSkeleton:
        heads = worlds[self.nodes][:, :3, 3]
        finite = np.nan_to_num(heads)  # whoever takes a joint that is not finite says so
        return find_human_skeleton(self._names, self.parents, finite, self._rig, humanoid=self._humanoid)


def _same_lengths(human: HumanSkeleton, heads: np.ndarray, shown_heads: np.ndarray) -> bool:
    """Whether the limb segments of two poses, joints at (n, 3), have the same lengths but for a factor."""
    ends = [[human.joints.get(end, 0) for end in segment] for segment in LIMB_SEGMENTS.values()]
    first, second = (np.linalg.norm(np.diff(at[ends], axis=1)[:, 0], axis=1) for at in (heads, shown_heads))
    ratio = np.log(np.maximum(first, 1e-12) / np.maximum(second, 1e-12))
    return bool(np.abs(ratio - np.median(ratio)).max() < np.log(UNLIKE_LENGTHS))


def _stands(human: HumanSkeleton, heads: np.ndarray) -> bool:
    """Whether thighs and shins lead on from the trunk, joints at (n, 3); of a skeleton without these, too."""
    bones = [f"{bone}.{side}" for side in "LR" for bone in ("upperarm01", "upperleg01", "lowerleg01", "foot")]
    if any(bone not in human.joints for bone in bones):
        return True
    limbs = np.diff(heads[[human.joints[bone] for bone in bones]].reshape(2, 4, 3), axis=1)
    trunk, legs = limbs[:, 0].sum(axis=0), limbs[:, 1:]
    return bool((legs @ trunk > STANDS * np.linalg.norm(legs, axis=2) * np.linalg.norm(trunk)).all())


def read_skins(file: GltfFile, numbers: Iterable[int]) -> dict[int, GltfSkin]:
    """Skins by number. Raises ContentError for one without joints, or without any finite inverse bind matrix of 16."""
    return {number: _skin(file, number) for number in numbers}


def _skin(file: GltfFile, number: int) -> GltfSkin:
    entry = file.document.item("skins", number)
    joints, matrices = skin_nodes(file, entry), entry.index("inverseBindMatrices")
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if matrices is None:
        return GltfSkin(joints, inverse, inverse, given=False)
    stored, binds = file.accessor(matrices), np.full(inverse.shape, np.nan)
    if len(stored) >= len(joints) and stored.shape[1] == 16:
        inverse[:, :3] = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)[:, :3]
        known = np.isfinite(inverse).all(axis=(1, 2))
        known[known] = np.abs(np.linalg.det(inverse[known])) > np.finfo(float).tiny
        inverse[~known], binds[known] = np.nan, np.linalg.inv(inverse[known])
    if not np.isfinite(binds).any():
        raise ContentError(
            f"skin {number} has {len(joints)} joints and {len(stored)} inverse bind matrices of {stored.shape[1]} "
            "numbers; each joint needs a finite one of 16"
        )
    return GltfSkin(joints, inverse, binds, given=True)


def _groups(file: GltfFile, skins: Mapping[int, GltfSkin]) -> list[dict[int, GltfSkin]]:
    """Skins that share joints, or whose joints hang on each other's, together; each group in the order of `skins`."""
    number, edges = {skin: k for k, skin in enumerate(skins)}, []
    owner: dict[int, int] = {}
    for skin in skins:
        edges += [(number[skin], owner.setdefault(joint, number[skin])) for joint in skins[skin].joints]
    carrier = nearest_above(file, owner)
    edges += [(its, carrier.get(int(file.node_parents[joint]), its)) for joint, its in owner.items()]
    groups: dict[int, dict[int, GltfSkin]] = {}
    for skin, group in zip(skins, pieces(edges, len(skins))):
        groups.setdefault(group, {})[skin] = skins[skin]
    return list(groups.values())


def bind_worlds(file: GltfFile, skins: Mapping[int, GltfSkin]) -> np.ndarray:
    """(g, 4, 4) from node to scene where joints are as skins bind them, and others follow, or are as the file has them.

    Of skins that hang together, joints of the first are as it says. The scene's axes are mesh space's, turned by
    quarters towards what the file shows.
    """
    worlds = file.node_worlds.copy()
    given = {number: skin for number, skin in skins.items() if skin.given}
    for group in _groups(file, given) if given else []:
        for node, world in _bound_worlds(file, *group.values()).items():
            worlds[node] = world
    return worlds


def _bound_worlds(
    file: GltfFile, first: GltfSkin, *others: GltfSkin, to_scene: np.ndarray | None = None
) -> dict[int, np.ndarray]:
    """As `bind_worlds`, by node, of skins that hang together and of what hangs on their joints, or carries them.
    to_scene: (4, 4) from the first one's mesh space; default as `_to_scene`."""
    from scipy.spatial import cKDTree

    found: dict[int, np.ndarray] = {}
    parents, to_scene = file.node_parents, _to_scene(file, first) if to_scene is None else to_scene
    above, around = nearest_above(file, first.place), cKDTree(first.binds[list(first.place.values())][:, :3, 3])
    shares_space = {id(skin): _shares_space(file, skin, first, above, around) for skin in others}

    def world_of(node: int) -> np.ndarray | None:
        if node in first.place:
            return to_scene @ first.binds[first.place[node]]
        binding = [skin for skin in others if node in skin.place]
        for skin in binding:
            above = ancestors(parents, node)[1:]
            anchor = next((each for each in above if each in found and each in skin.place), None)
            if anchor is not None:
                return found[anchor] @ skin.inverse_binds[skin.place[anchor]] @ skin.binds[skin.place[node]]
        if (parent := found.get(int(parents[node]))) is None:
            return None
        in_space = next((skin for skin in binding if shares_space[id(skin)]), None)
        return parent @ file.node_locals[node] if in_space is None else to_scene @ in_space.binds[in_space.place[node]]

    def follow() -> None:
        for node in file.node_order:
            if node not in found and (world := world_of(node)) is not None:
                found[node] = world

    follow()
    below: dict[int, list[np.ndarray]] = {}
    for node in reversed(file.node_order):
        if node in below and node not in found:  # as most children have it: one of them may be turned
            away = np.abs(below[node] - np.median(below[node], axis=0)).sum(axis=(1, 2))
            found[node] = below[node][away.argmin()]
        if node in found and parents[node] >= 0 and parents[node] not in found:
            below.setdefault(int(parents[node]), []).append(found[node] @ np.linalg.pinv(file.node_locals[node]))
    follow()
    return found


def _shares_space(file: GltfFile, skin: GltfSkin, first: GltfSkin, above: Mapping[int, int], around: cKDTree) -> bool:
    """Whether a skin's inverse bind matrices are of the first one's mesh space, as most are: its joints then lie where
    the first one's do, at least as near as where nodes have them, which may be held in another pose.

    above: place of the first one's joint that each node hangs on. around: those joints, in its mesh space.
    """
    joints = [joint for joint in skin.place if joint in above]
    if not joints:
        return False
    carriers = [above[joint] for joint in joints]
    bound = skin.binds[[skin.place[joint] for joint in joints]]
    seen = np.linalg.pinv(file.node_worlds[[first.joints[k] for k in carriers]]) @ file.node_worlds[joints]
    held = first.binds[carriers] @ seen
    return _as_near(around, bound[:, :3, 3], held[:, :3, 3])


def _as_near(around: cKDTree, there: np.ndarray, here: np.ndarray) -> bool:
    """Whether joints are as near to those around them in one place, there (k, 3), as in another, here (k, 3)."""
    apart = [np.median(around.query(places)[0]) for places in (there, here)]
    return bool(apart[0] <= apart[1] + SAME_POSE * (around.maxes - around.mins).max())


def _to_scene(file: GltfFile, skin: GltfSkin) -> np.ndarray:
    """(4, 4) from mesh space to the scene, as the skin's first joint moves it but turned by quarters only."""
    rank = {node: k for k, node in enumerate(file.node_order)}
    root = min(skin.place, key=rank.__getitem__)
    found = file.node_worlds[root] @ skin.inverse_binds[skin.place[root]]
    u, stretch, vt = np.linalg.svd(found[:3, :3])
    turn = nearest_quarter_turn(u @ vt)
    bound = skin.binds[skin.place[root]][:3, 3]
    found[:3, :3] = turn @ (vt.T * stretch) @ vt
    found[:3, 3] = file.node_worlds[root][:3, 3] - found[:3, :3] @ bound
    return found


def _called(file: GltfFile, skins: Collection[int]) -> str:
    """Nodes whose meshes hang on skins, by name."""
    nodes = [k for k, node in enumerate(file.nodes) if node.index("skin") in skins and "mesh" in node]
    return listed([file.nodes[node].text("name") or f"node {node}" for node in nodes])
