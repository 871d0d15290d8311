"""Animation clips of glTF files: GLB, glTF, VRM, FBX, and VRMA, whose nodes rest in a T-pose.

Dimensions: `T` frames, `J` joints, `K` keys of a channel.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.gltf_skeleton import GltfSkin, bind_worlds, read_skins
from physkin_core.file_reading import ContentError, listed, shown
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import (
    TRANSFORM_PARTS,
    GltfFile,
    local_transforms,
    node_transform_parts,
    rotations_of,
)
from physkin_core.formats.gltf_joints import humanoid_nodes, with_nodes_above
from physkin_core.motion.source_clip import MOST_PLACES, RATE_HZ, SourceClip, check_clip_size

__all__ = ["GltfClip", "gltf_clip_names", "read_gltf_clip", "the_clip"]

log = logging.getLogger(__name__)

SLOWEST_HZ = 24.0
"""Clips with fewer keys a second are sampled at this rate: between keys far apart, joints do not turn evenly."""
VALUES_A_KEY = {"LINEAR": 1, "STEP": 1, "CUBICSPLINE": 3}
ROUNDING = 1e-4
"""[s] of times in single precision: a frame has the key that is so near."""
BLOCK = 1024
"""Frames posed together, which bounds the memory."""


@dataclass(frozen=True)
class _Channel:
    """times: (K,) [s], rising. values: (K, 1, w), or (K, 3, w) of a cubic spline: slope before, value, slope after."""

    times: np.ndarray
    values: np.ndarray
    is_stepped: bool

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """(T, w) at times (T,); before and after all keys, the nearest one."""
        key = np.maximum(np.searchsorted(self.times, seconds + ROUNDING, side="right") - 1, 0)
        following = np.minimum(key + 1, len(self.times) - 1)
        step = np.maximum(self.times[following] - self.times[key], 1e-9)[:, None]
        u = np.clip((seconds - self.times[key])[:, None] / step, 0, 1)
        first, second = self.values[key], self.values[following]
        if self.is_stepped:
            return first[:, 0]
        if first.shape[1] == 3:
            slopes = (u**3 - 2 * u**2 + u) * first[:, 2] + (u**3 - u**2) * second[:, 0]
            return (2 * u**3 - 3 * u**2 + 1) * first[:, 1] + (3 * u**2 - 2 * u**3) * second[:, 1] + step * slopes
        if first.shape[2] == 3:
            return first[:, 0] + u * (second - first)[:, 0]
        turn = rotations_of(first[:, 0])
        return (turn * Rotation.from_rotvec(u * (turn.inv() * rotations_of(second[:, 0])).as_rotvec())).as_quat()


class GltfClip:
    """How an animation moves the nodes of a file. Raises ContentError.

    within: nodes whose channels count; None: all. start, end: [s] of their keys. rate_hz: of these, `SLOWEST_HZ` to
    `RATE_HZ`. moved: nodes; none where it only changes morph weights.
    """

    def __init__(self, file: GltfFile, animation: GltfEntry, *, within: Collection[int] | None = None) -> None:
        channels = _channels(file, animation)
        self._channels = {node: its for node, its in channels.items() if within is None or node in within}
        self._file = file
        self.moved = set(self._channels)
        times = [channel.times for its in self._channels.values() for channel in its.values()] or [np.zeros(1)]
        self.start, self.end = float(min(each[0] for each in times)), float(max(each[-1] for each in times))
        steps = np.concatenate([np.diff(each) for each in times])
        self.rate_hz = (
            float(np.clip(1 / max(np.median(steps), 1e-6), SLOWEST_HZ, RATE_HZ)) if len(steps) else SLOWEST_HZ
        )

    def worlds(self, nodes: Sequence[int], seconds: np.ndarray) -> Iterator[np.ndarray]:
        """(T, 4, 4) from each node to the scene at times (T,). nodes: with all that they hang on, parents first."""
        found = {-1: np.eye(4)}
        for node in nodes:
            local = _posed(self._file.nodes[node], self._channels.get(node, {}), seconds)
            found[node] = found[int(self._file.node_parents[node])] @ local
            yield found[node]


def gltf_clip_names(file: GltfFile) -> list[str]:
    """Names of a file's clips; their numbers from 1 where they have none. Raises ContentError."""
    return [clip.text("name") or str(number) for number, clip in enumerate(file.document.entries("animations"), 1)]


def read_gltf_clip(file: GltfFile, animation: GltfEntry) -> SourceClip:
    """Read a clip of a glTF, VRM, VRMA or FBX file, sampled at the rate of its keys, `SLOWEST_HZ` to `RATE_HZ`.

    Joints are those of the humanoid, else of the skins of the figure that moves most, or what moves where there are
    none, and all that they hang on. At rest they are in the skins' bind pose, along the scene's axes, or lie as their
    nodes do. Raises ContentError.
    """
    motion = GltfClip(file, animation)
    if not motion.moved:
        raise ContentError(f"{animation.where} moves no node; choose another clip")
    humanoid, skins = humanoid_nodes(file) or {}, read_skins(file, range(file.document.count("skins")))
    nodes = with_nodes_above(file, _figure(file, skins.values(), motion.moved).union(humanoid.values()) or motion.moved)
    motion = GltfClip(file, animation, within=nodes)
    if not motion.moved:
        raise ContentError(f"{animation.where} moves no node of a figure; choose another clip")
    number = {node: joint for joint, node in enumerate(nodes)}
    count = 1 + round((motion.end - motion.start) * motion.rate_hz)
    check_clip_size(count, len(nodes), motion.rate_hz)
    bind = bind_worlds(file, skins)[nodes]
    undone = np.linalg.pinv(bind[:, :3, :3])
    quaternions, places = np.empty((count, len(nodes), 4)), np.empty((count, len(nodes), 3))
    for frames in np.array_split(np.arange(count), -(-count // BLOCK)):
        for joint, world in enumerate(motion.worlds(nodes, motion.start + frames / motion.rate_hz)):
            turned = world[:, :3, :3] @ undone[joint]
            turned[np.linalg.det(turned) < 1e-9] = np.eye(3)  # scaled to nothing, to hide what hangs there
            quaternions[frames, joint] = Rotation.from_matrix(turned).as_quat()
            places[frames, joint] = world[:, :3, 3]
    names = tuple(file.nodes[node].text("name") or f"node {node}" for node in nodes)
    parents = np.array([number.get(int(file.node_parents[node]), -1) for node in nodes])
    by_bone = {bone: number[node] for bone, node in humanoid.items()} or None
    return SourceClip(names, parents, bind[:, :3, 3], quaternions, places, motion.rate_hz, by_bone)


def _figure(file: GltfFile, skins: Iterable[GltfSkin], moved: Set[int]) -> set[int]:
    """Joints of the skin that a clip moves most, and of others that share some, or move and have other names."""
    found, names = set[int](), set[str]()
    for joints in sorted((set(skin.joints) for skin in skins), key=lambda joints: -len(joints & moved)):
        called = {file.nodes[joint].text("name") or "" for joint in joints}
        if not found or found & joints or (joints & moved and names.isdisjoint(called)):
            found, names = found | joints, names | called
    return found


def the_clip(file: GltfFile, clip: str) -> GltfEntry:
    """The clip of a name or a number from 1; empty for the first that moves several nodes, with a warning where there
    are others. Raises ContentError."""
    names = gltf_clip_names(file)
    if not names:
        raise ContentError("it has no animation clip; export it with one, or choose another motion")
    if clip and clip not in names and clip not in map(str, range(1, len(names) + 1)):
        raise ContentError(f"it has no clip {shown(clip)}; allowed are {listed(names)}, or 1 to {len(names)}")
    number = names.index(clip) if clip in names else int(clip or 1) - 1
    if not clip and len(names) > 1:
        samplers = (animation.entries("samplers") for animation in file.document.entries("animations"))
        inputs = ([file.document.item("accessors", each.integer("input")) for each in its] for its in samplers)
        moving = (sum(each.integer("count") > 1 for each in its) for its in inputs)
        number = next((k for k, count in enumerate(moving) if count > len(TRANSFORM_PARTS)), 0)
        taken = file.path, len(names), shown(names[number]), listed(names)
        log.warning("%s: of %d clips %s is taken: %s; another: #NAME after the file", *taken)
    return file.document.item("animations", number)


def _channels(file: GltfFile, animation: GltfEntry) -> dict[int, dict[str, _Channel]]:
    """What moves, by node and by what of it: one of `TRANSFORM_PARTS`."""
    found, keys = {}, 0
    for channel in animation.entries("channels"):
        node, part = channel.entry("target").index("node"), channel.entry("target").text("path")
        if node is None or part not in TRANSFORM_PARTS:  # weights of morphs, and what extensions point at
            continue
        file.document.item("nodes", node)
        sampler = animation.item("samplers", channel.integer("sampler"))
        a_key = VALUES_A_KEY[how] if (how := sampler.text("interpolation") or "LINEAR") in VALUES_A_KEY else None
        if a_key is None:
            raise ContentError(f"{sampler.where} is interpolated by {shown(how)}, allowed: {', '.join(VALUES_A_KEY)}")
        keys += file.document.item("accessors", sampler.integer("output")).integer("count")
        if keys > MOST_PLACES:
            raise ContentError(f"{animation.where} has more than {MOST_PLACES} keys; thin them or cut it")
        times, values = (file.accessor(sampler.integer(key)).astype(np.float64) for key in ("input", "output"))
        shape = (len(times), a_key, len(TRANSFORM_PARTS[part]))
        rising = times.shape[1] == 1 and (np.diff(times[:, 0]) >= 0).all()
        if not rising or values.size != np.prod(shape) or not np.isfinite(values).all() or not np.isfinite(times).all():
            raise ContentError(f"{sampler.where} needs rising times and {shown(shape)} finite values; export it again")
        found.setdefault(node, {})[part] = _Channel(times[:, 0], values.reshape(shape), how == "STEP")
    return found


def _posed(node: GltfEntry, channels: dict[str, _Channel], seconds: np.ndarray) -> np.ndarray:
    """(T, 4, 4) from a node to its parent at times (T,)."""
    matrix = node.numbers("matrix", 16)
    if matrix is not None:
        return np.tile(np.reshape(matrix, (4, 4)).T, (len(seconds), 1, 1))
    resting = {part: np.tile(value, (len(seconds), 1)) for part, value in node_transform_parts(node).items()}
    return local_transforms(**resting | {part: channel.at(seconds) for part, channel in channels.items()})
