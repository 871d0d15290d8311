"""Animation clips of glTF files: GLB, glTF, VRM, and VRMA, whose nodes rest in a T-pose.

Dimensions: `T` frames, `J` joints, `K` keys of a channel.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, listed, shown
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_joints import humanoid_nodes, skin_nodes
from physkin_core.motion.source_clip import MOST_PLACES, RATE_HZ, SourceClip, check_clip_size

__all__ = ["GltfClip", "chosen_clip", "gltf_clip_names", "read_gltf_clip"]

log = logging.getLogger(__name__)

SLOWEST_HZ = 24.0
"""Clips with fewer keys a second are sampled at this rate: between keys far apart, joints do not turn evenly."""
PARTS = {"translation": (0.0, 0, 0), "rotation": (0.0, 0, 0, 1), "scale": (1.0, 1, 1)}
"""Of a node's transform, and what they are where the node does not say."""
VALUES_A_KEY = {"LINEAR": 1, "STEP": 1, "CUBICSPLINE": 3}
ROUNDING = 1e-4
"""[s] of times in single precision: a frame has the key that is so near."""
BLOCK = 1024
"""Frames posed together, which bounds the memory."""
SQUARE_TURNS = Rotation.create_group("O").as_matrix()


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
        turn = _rotation(first[:, 0])
        return (turn * Rotation.from_rotvec(u * (turn.inv() * _rotation(second[:, 0])).as_rotvec())).as_quat()


class GltfClip:
    """How an animation moves the nodes of a file. Raises ContentError.

    start, end: [s] of its keys. rate_hz: of these, `SLOWEST_HZ` to `RATE_HZ`. moved: nodes; none where it only changes
    morph weights.
    """

    def __init__(self, file: GltfFile, animation: GltfEntry) -> None:
        self._file, self._channels = file, _channels(file, animation)
        self.moved = set(self._channels)
        times = [channel.times for its in self._channels.values() for channel in its.values()] or [np.zeros(1)]
        self.start, self.end = float(min(each[0] for each in times)), float(max(each[-1] for each in times))
        steps = np.concatenate([np.diff(each) for each in times])
        self.rate_hz = float(np.clip(1 / max(np.median(steps), 1e-6), SLOWEST_HZ, RATE_HZ)) if len(steps) else RATE_HZ

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


def read_gltf_clip(path: Path, *, clip: str = "") -> SourceClip:
    """Read a clip of a .glb, .gltf, .vrm or .vrma file, sampled at the rate of its keys, `SLOWEST_HZ` to `RATE_HZ`.

    clip: its name, or its number from 1; empty for the first, with a warning where there are others. Joints are those
    of skins and of the humanoid, or what moves where there are none, and all that they hang on. At rest they are in the
    skins' bind pose, along the scene's axes, or lie as their nodes do. Raises ContentError and OSError.
    """
    file = GltfFile(path)
    animation = chosen_clip(file, clip)
    motion = GltfClip(file, animation)
    if not motion.moved:
        raise ContentError(f"{animation.where} moves no node; choose another clip")
    humanoid, skins = humanoid_nodes(file) or {}, file.document.entries("skins")
    joints = set(humanoid.values()).union(*(skin_nodes(file, skin) for skin in skins)) or motion.moved
    for node in reversed(file.node_order):
        if node in joints and file.node_parents[node] >= 0:
            joints.add(int(file.node_parents[node]))
    nodes = [node for node in file.node_order if node in joints]
    number = {node: joint for joint, node in enumerate(nodes)}
    count = 1 + round((motion.end - motion.start) * motion.rate_hz)
    check_clip_size(count, len(nodes), motion.rate_hz)
    bind = _bind_pose(file, nodes, skins)
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


def chosen_clip(file: GltfFile, clip: str) -> GltfEntry:
    """An animation by name or number from 1; the first one for an empty name, with a warning where there are others.
    Raises ContentError."""
    names = gltf_clip_names(file)
    if not names:
        raise ContentError("it has no animation clip; export it with one, or choose another motion")
    if clip and clip not in names and clip not in map(str, range(1, len(names) + 1)):
        raise ContentError(f"it has no clip {shown(clip)}; allowed are {listed(names)}, or 1 to {len(names)}")
    if not clip and len(names) > 1:
        said = "%s: the first of %d clips is taken: %s; another: #NAME after the file"
        log.warning(said, file.path, len(names), listed(names))
    return file.document.item("animations", names.index(clip) if clip in names else int(clip or 1) - 1)


def _channels(file: GltfFile, animation: GltfEntry) -> dict[int, dict[str, _Channel]]:
    """What moves, by node and by what of it: one of `PARTS`."""
    found, keys = {}, 0
    for channel in animation.entries("channels"):
        node, part = channel.entry("target").index("node"), channel.entry("target").text("path")
        if node is None or part not in PARTS:  # weights of morphs, and what extensions point at
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
        shape = (len(times), a_key, len(PARTS[part]))
        rising = times.shape[1] == 1 and (np.diff(times[:, 0]) >= 0).all()
        if not rising or values.size != np.prod(shape) or not np.isfinite(values).all() or not np.isfinite(times).all():
            raise ContentError(f"{sampler.where} needs rising times and {shown(shape)} finite values; export it again")
        found.setdefault(node, {})[part] = _Channel(times[:, 0], values.reshape(shape), how == "STEP")
    return found


def _posed(node: GltfEntry, channels: dict[str, _Channel], seconds: np.ndarray) -> np.ndarray:
    """(T, 4, 4) from a node to its parent at times (T,)."""
    matrix, local = node.numbers("matrix", 16), np.tile(np.eye(4), (len(seconds), 1, 1))
    if matrix is not None:
        return local @ np.reshape(matrix, (4, 4)).T
    still = {part: np.array([node.numbers(part, len(usual)) or usual]) for part, usual in PARTS.items()}
    moved = still | {part: channel.at(seconds) for part, channel in channels.items()}
    local[:, :3, :3] = _rotation(moved["rotation"]).as_matrix() * moved["scale"][:, None]
    local[:, :3, 3] = moved["translation"]
    return local


def _rotation(quaternions: np.ndarray) -> Rotation:
    """Of quaternions (K, 4) of any length; none of those of no length."""
    long = (quaternions**2).sum(axis=1, keepdims=True) > 1e-12
    return Rotation.from_quat(np.where(long, quaternions, PARTS["rotation"]))


def _bind_pose(file: GltfFile, nodes: list[int], skins: list[GltfEntry]) -> np.ndarray:
    """(J, 4, 4) from each joint at rest to the scene. What no skin names lies on its parent as its node does."""
    bind: dict[int, np.ndarray] = {}
    for skin in skins:
        if "inverseBindMatrices" in skin:
            named, stored = skin_nodes(file, skin), file.accessor(skin.integer("inverseBindMatrices"))
            if len(stored) < len(named) or stored.shape[1] != 16 or not np.isfinite(stored).all():
                raise ContentError(f"{skin.where} needs a finite inverse bind matrix of 16 numbers for each joint")
            inverse = stored[: len(named)].reshape(-1, 4, 4).transpose(0, 2, 1)
            to_scene = _square(file.node_worlds[named] @ inverse)
            bind = dict(zip(named, to_scene @ np.linalg.pinv(inverse))) | bind
    for node in nodes:
        if node not in bind:
            local = (
                np.linalg.pinv(file.node_worlds[parent]) if (parent := int(file.node_parents[node])) in bind else None
            )
            bind[node] = file.node_worlds[node] if local is None else bind[parent] @ local @ file.node_worlds[node]
    return np.stack([bind[node] for node in nodes])


def _square(to_scene: np.ndarray) -> np.ndarray:
    """(4, 4) from a skin's mesh to the scene, by right angles, as axes differ, and one scale. to_scene: what each joint
    (k, 4, 4) makes of it, which differs where nodes are not in the bind pose."""
    frame = np.eye(4)
    mean, size = to_scene[:, :3, :3].mean(axis=0), np.cbrt(np.median(np.abs(np.linalg.det(to_scene[:, :3, :3]))))
    frame[:3, :3] = max(SQUARE_TURNS, key=lambda turn: float((turn * mean).sum())) * (size or 1.0)
    return frame
