"""Motion capture files, BVH and ASF/AMC, as motion of the default rig.

Both are a tree of joints with offsets at rest and a rotation each a frame. Joints are recognised by their usual names;
which way the skeleton looks is read off its hips and spine. Elbow and knee axes are those about which the clip bends
them, as files do not agree on where arms and palms are at rest.

Dimensions: `T` frames, `J` joints. Offsets in the file's own unit: a clip is scaled by the length of its legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.motion.motion import Motion, MotionError
from physkin_core.motion.retargeting import leg_length, on_floor, retarget
from physkin_core.rig.rig import Rig

__all__ = ["AMC_RATE_HZ", "load_mocap"]

AMC_RATE_HZ = 120.0
"""An AMC file does not state its rate; this is that of the CMU database."""
RATE_HZ = 60.0

# What a joint is called, in order of preference; L and R stand for a side, without which the name is the trunk's.
TRUNK_NAMES = {
    "root": ("root", "hips", "hip", "pelvis"),
    "chest": ("thorax", "spine3", "spine2", "spine1", "chest", "spine"),
    "neck": ("head", "neck"),
}
LIMB_NAMES = {
    "hip": ("{side}upleg", "{s}femur", "{side}thigh", "{side}hip", "{s}thigh"),
    "knee": ("{side}leg", "{s}tibia", "{side}shin", "{side}knee", "{s}shin"),
    "ankle": ("{side}foot", "{s}foot", "{side}ankle"),
    "shoulder": ("{side}arm", "{s}humerus", "{side}uparm", "{side}upperarm", "{s}shldr", "{side}shoulder"),
    "elbow": ("{side}forearm", "{s}radius", "{side}lowarm", "{s}forearm", "{side}elbow"),
    "wrist": ("{side}hand", "{s}hand", "{s}wrist", "{side}wrist"),
}
HINGE_GUESS = 0.05  # how much a T-pose's elbow and knee axes count beside those seen in the clip


@dataclass(frozen=True)
class _Skeleton:
    """names, parents (-1: root), offsets (J, 3) at rest from the parent; rotations: (T,) each, from rest, world; root
    positions (T, 3)."""

    names: list[str]
    parents: list[int]
    offsets: np.ndarray
    rotations: list[Rotation]
    positions: np.ndarray
    rate_hz: float


def load_mocap(
    path: str | Path, rig: Rig, *, skeleton: str | Path | None = None, source_rate_hz: float = AMC_RATE_HZ
) -> tuple[Motion, dict[str, float]]:
    """Read a .bvh or .amc file as motion of the default rig at 60 Hz, standing on the floor and facing X at first.

    rig: the default one. skeleton: the .asf of an .amc; None: `02.asf` for `02_02.amc`. source_rate_hz: of an .amc.
    Also returns the mean angle [degrees] between a bone's direction and the source's, by rig bone.
    Raises MotionError: unreadable, malformed, or a joint that cannot be found by name.
    """
    path = Path(path)
    if not 0 < source_rate_hz < np.inf:
        raise MotionError(f"source_rate_hz must be positive and finite, got {source_rate_hz}")
    try:
        if path.suffix.lower() == ".bvh":
            source = _read_bvh(path.read_text())
        else:
            asf = Path(skeleton) if skeleton else path.with_name(f"{path.stem.split('_')[0]}.asf")
            source = _read_amc(path.read_text(), asf.read_text(), source_rate_hz)
    except (OSError, UnicodeDecodeError) as error:
        raise MotionError(f"cannot read {path}: {error}") from error
    except (ValueError, IndexError, KeyError) as error:
        raise MotionError(f"motion capture file {path} is malformed: {error}") from error
    if not np.isfinite(source.positions).all() or len(source.positions) == 0:
        raise MotionError(f"motion capture file {path} has no frames, or root positions that are not finite")
    stride = max(1, round(source.rate_hz / RATE_HZ))
    rotations, positions, leg = _hanging(source, path, slice(None, None, stride))
    joint_positions, report = retarget(rig, rotations)
    report.pop("at_limit")
    root = rotations["root"]
    forward = root[0].apply([1.0, 0.0, 0.0])
    ahead = Rotation.from_euler("z", -np.arctan2(forward[1], forward[0]))
    positions = ahead.apply(positions - positions[0] * [1, 1, 0]) * (leg_length(rig) / leg)
    rate = source.rate_hz / stride
    motion = Motion(rig.joint_names, joint_positions, (ahead * root).as_quat(), positions, rate, path.stem)
    return on_floor(motion.resampled(RATE_HZ)), {bone: mean for bone, (mean, _) in report.items()}


def _hanging(source: _Skeleton, path: Path, frames: slice) -> tuple[dict[str, Rotation], np.ndarray, float]:
    """What `retarget` wants: rotations by its joints; also root positions (T, 3) Z up and the length of a leg."""
    joint = {role: _find(source.names, TRUNK_NAMES[role], path) for role in TRUNK_NAMES}
    for s, side in (("l", "left"), ("r", "right")):
        for role, patterns in LIMB_NAMES.items():
            names = [pattern.format(s=s, side=side) for pattern in patterns]
            joint[f"{role}.{s.upper()}"] = _find(source.names, names, path)
    at_rest = np.zeros_like(source.offsets)
    for k, parent in enumerate(source.parents):
        at_rest[k] = source.offsets[k] + (at_rest[parent] if parent >= 0 else 0)
    up = _nearest_axis(at_rest[joint["neck"]] - at_rest[joint["root"]])
    left = _nearest_axis(at_rest[joint["hip.L"]] - at_rest[joint["hip.R"]])
    turn = np.stack([np.cross(left, up), left, up])  # ours <- source
    to_ours = Rotation.from_matrix(turn)
    at_rest = at_rest @ turn.T
    turned = {role: to_ours * source.rotations[k][frames] * to_ours.inv() for role, k in joint.items()}

    rotations = {role: turned[role] for role in ("root", "chest", "neck", "ankle.L", "ankle.R")}
    for side in "LR":
        # elbows bend forwards, knees backwards: about -Y and +Y of a limb that hangs
        for first, second, end, sense in (("shoulder", "elbow", "wrist", -1), ("hip", "knee", "ankle", 1)):
            heads = [at_rest[joint[f"{role}.{side}"]] for role in (first, second, end)]
            upper, lower = heads[1] - heads[0], heads[2] - heads[1]
            above = turned[f"{first}.{side}"]
            along = [above.apply(_unit(upper)), turned[f"{second}.{side}"].apply(_unit(lower))]
            seen = above.inv().apply(sense * np.cross(along[0], along[1])).mean(axis=0)
            guess = Rotation.align_vectors([_unit(upper)], [[0.0, 0.0, -1.0]])[0].apply([0.0, 1.0, 0.0])
            hinge = above.apply(_unit(seen + HINGE_GUESS * guess))
            for role, direction in zip((first, second), along):
                axis = hinge - direction * (hinge * direction).sum(axis=1, keepdims=True)
                axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
                columns = [np.cross(axis, -direction), axis, -direction]  # images of X, Y, Z
                rotations[f"{role}.{side}"] = Rotation.from_matrix(np.stack(columns, axis=-1))
    legs = [at_rest[joint[f"{role}.L"]] for role in ("hip", "knee", "ankle")]
    length = float(np.linalg.norm(legs[1] - legs[0]) + np.linalg.norm(legs[2] - legs[1]))
    return rotations, source.positions[frames] @ turn.T, length


def _find(names: list[str], wanted, path: Path) -> int:
    plain = [name.split(":")[-1].replace("_", "").lower() for name in names]
    for name in wanted:
        if name in plain:
            return plain.index(name)
    raise MotionError(f"{path} has no joint called {' or '.join(wanted)}; it has {', '.join(names)}")


def _read_bvh(text: str) -> _Skeleton:
    head, _, data = text.partition("MOTION")
    names, parents, offsets, channels, stack = [], [], [], [], []
    current = None  # None inside an End Site
    for line in head.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else -1)
            current = len(names)
            names.append(words[1])
            offsets.append([0.0, 0.0, 0.0])
            channels.append([])
        elif words[0] == "End":
            current = None
        elif words[0] == "OFFSET" and current is not None:
            offsets[current] = [float(word) for word in words[1:4]]
        elif words[0] == "CHANNELS" and current is not None:
            channels[current] = words[2:]
        elif words[0] == "{":
            stack.append(current)
        elif words[0] == "}":
            stack.pop()
    lines = data.split("\n")
    values = {line.split(":")[0].strip(): line.split(":")[1] for line in lines[:4] if ":" in line}
    count, step = int(values["Frames"]), float(values["Frame Time"])
    rows = [line.split() for line in lines if line.strip() and ":" not in line]
    frames = np.array(rows, dtype=np.float64)
    width = sum(map(len, channels))
    if frames.shape != (count, width) or not np.isfinite(frames).all() or step <= 0:
        raise ValueError(
            f"frames of shape {frames.shape}, expected {(count, width)}, finite, and a positive frame time"
        )
    rotations: list[Rotation] = []
    positions = np.tile(np.array(offsets[0]), (count, 1))
    column = 0
    for k, parent in enumerate(parents):
        local = Rotation.identity(count)
        for channel in channels[k]:
            axis, kind = channel[0].upper(), channel[1:].lower()
            if kind == "rotation":
                local = local * Rotation.from_euler(axis, frames[:, [column]], degrees=True)
            elif k == 0:
                positions[:, "XYZ".index(axis)] = frames[:, column]
            column += 1
        rotations.append(local if parent < 0 else rotations[parent] * local)
    return _Skeleton(names, parents, np.array(offsets), rotations, positions, 1 / step)


def _read_amc(text: str, asf: str, rate_hz: float) -> _Skeleton:
    bones = {"root": {"axis": Rotation.identity(), "dof": [], "end": np.zeros(3)}}
    for block in asf.partition(":bonedata")[2].partition(":hierarchy")[0].split("begin")[1:]:
        fields = {line.split()[0]: line.split()[1:] for line in block.splitlines() if line.split()}
        axis = Rotation.from_euler(fields["axis"][3].lower(), [float(v) for v in fields["axis"][:3]], degrees=True)
        end = float(fields["length"][0]) * np.array([float(v) for v in fields["direction"]])
        bones[fields["name"][0]] = {"axis": axis, "dof": fields.get("dof", []), "end": end}
    parent_of = {"root": None}
    for line in asf.partition(":hierarchy")[2].splitlines():
        words = line.split()
        parent_of |= {child: words[0] for child in words[1:]} if words and words[0] in bones else {}
    order = asf.partition(":root")[2].partition("order")[2].split("\n")[0].upper().split()
    frames: list[dict[str, list[float]]] = []
    for line in text.splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif words and frames and words[0] in bones:
            frames[-1][words[0]] = [float(word) for word in words[1:]]
    names, rotations = list(parent_of), []
    root = np.array([frame["root"] for frame in frames], dtype=np.float64)
    for name in names:
        bone, parent = bones[name], parent_of[name]
        if parent is None:
            columns = [order.index(f"R{letter}") for letter in "XYZ"]
            rotations.append(Rotation.from_euler("xyz", root[:, columns], degrees=True))
            continue
        local = Rotation.identity(len(frames))
        if bone["dof"]:
            angles = np.array([frame[name] for frame in frames], dtype=np.float64)
            for letter, values in zip((word[1] for word in bone["dof"]), angles.T, strict=True):
                local = Rotation.from_euler(letter, values[:, None], degrees=True) * local
        rotations.append(rotations[names.index(parent)] * bone["axis"] * local * bone["axis"].inv())
    offsets = np.array([np.zeros(3) if parent_of[name] is None else bones[parent_of[name]]["end"] for name in names])
    parents = [-1 if parent_of[name] is None else names.index(parent_of[name]) for name in names]
    positions = root[:, [order.index(f"T{letter}") for letter in "XYZ"]]
    return _Skeleton(names, parents, offsets, rotations, positions, rate_hz)


def _nearest_axis(vector: np.ndarray) -> np.ndarray:
    axis = np.zeros(3)
    largest = np.abs(vector).argmax()
    axis[largest] = np.sign(vector[largest])
    return axis


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
