"""A skinned mesh as a file has it, and what every loader does with it: clean it, know its unit, turn it upright.

Dimensions: `V` vertices, `f` faces, `j` joints of the avatar's skeleton, `K` influences. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.file_reading import ContentError
from physkin_core.model.garment import surface_fault
from physkin_core.rig.canonical_pose import nearest_quarter_turn
from physkin_core.rig.rig import MOST_BONES, Rig

__all__ = [
    "SkinnedMesh",
    "Surface",
    "check_bone_count",
    "check_influence_count",
    "check_size",
    "clean_surface",
    "turn_upright",
    "unit_scale",
    "with_joints_moved",
]

HEIGHT_RANGE = (0.5, 3.0)
UNITS = {"decimetres": 0.1, "centimetres": 0.01, "inches": 0.0254, "millimetres": 0.001}
UNITS |= {"hectometres": 100.0, "kilometres": 1000.0}
USUAL_SIZES = (0.95, 2.4)
"""[m] of the largest extent of a mesh that is taken to be in one of `UNITS`; none of these can be mistaken."""
MOST_HEADING, MOST_LEAN = 3.0, 0.07
"""How far asymmetry turns a skeleton's heading [degrees], and how far trunk and legs both lean one way [radians] by
their shape; a stoop is the trunk's alone."""

MOST_INFLUENCES = 16
"""Of a vertex."""


@dataclass(frozen=True)
class SkinnedMesh:
    """An avatar as its file has it: any pose, any origin; axes of the root frame (X forward, Y left, Z up), metres.

    vertices: (V, 3). faces: (f, 3) integers. joint_names: (j,). joint_parents: (j,), -1 for none, a parent before its
    children. joint_heads: (j, 3). joint_tails: (j, 3), NaN where the file does not say.
    influence_joints: (V, K) integers; influence_weights: (V, K), rows sum to 1.
    humanoid: joint by VRM humanoid bone, for files that state it. warnings: as in `Avatar`.
    part_names: names of each part of the mesh, the most telling first, and face_parts: (f,) the part of each face; None
    for a mesh of one part. clear_parts: those of a material that may show what is behind it, and seen: (f,) bool, faces
    where it does not; None: all. file_vertices: (V, 3) in the file's own frame and unit. file_corners: as in `Avatar`.
    joint_nodes: (j,) of the file, -1 for joints that it lacks, and joint_frames: (j, 4, 4) from each joint's own frame
    there to this mesh's; None for files without nodes.
    """

    vertices: np.ndarray
    faces: np.ndarray
    joint_names: tuple[str, ...]
    joint_parents: np.ndarray
    joint_heads: np.ndarray
    joint_tails: np.ndarray
    influence_joints: np.ndarray
    influence_weights: np.ndarray
    source: str
    humanoid: Mapping[str, int] | None = None
    warnings: tuple[str, ...] = ()
    part_names: tuple[tuple[str, ...], ...] = ()
    face_parts: np.ndarray | None = None
    clear_parts: frozenset[int] = frozenset()
    seen: np.ndarray | None = None
    file_vertices: np.ndarray | None = None
    file_corners: np.ndarray | None = None
    joint_nodes: np.ndarray | None = None
    joint_frames: np.ndarray | None = None


@dataclass(frozen=True)
class Surface:
    """A mesh without a skin, in its file's frame and unit. vertices: (V, 3). faces: (f, 3). Parts: `SkinnedMesh`'s."""

    vertices: np.ndarray
    faces: np.ndarray
    part_names: tuple[tuple[str, ...], ...] = ()
    face_parts: np.ndarray | None = None
    clear_parts: frozenset[int] = frozenset()
    seen: np.ndarray | None = None


def check_bone_count(count: int) -> None:
    """Raises ContentError for more bones, or joints of a skeleton, than time allows."""
    if count > MOST_BONES:
        raise ContentError(f"its skeleton has {count} bones, allowed are {MOST_BONES}; remove helper bones")


def check_influence_count(count: int) -> None:
    """Raises ContentError for more influences a vertex than memory is meant for."""
    if count > MOST_INFLUENCES:
        raise ContentError(f"a vertex has {count} skinning weights, allowed are {MOST_INFLUENCES}")


def clean_surface(
    surface: Surface, attributes: Sequence[np.ndarray], source: str
) -> tuple[Surface, tuple[np.ndarray, ...], np.ndarray]:
    """Check a surface, weld equal vertices (texture seams, triangle soups) and drop unused vertices, empty faces and
    faces that are there already: in their part, or the other way round, as of a body that is to be seen from inside.

    attributes: arrays (V, ...) that must be equal, too, for vertices to be welded. The order of what remains is kept;
    the last result tells which faces (f,) do. Raises AvatarError on no faces, NaN or an index out of range.
    """
    vertices, faces = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces)
    if faces.size and faces.dtype.kind in "iu" and 0 <= faces.min() and faces.max() < len(vertices):
        vertices = np.where(np.isin(np.arange(len(vertices)), faces)[:, None], vertices, 0.0)
    if fault := surface_fault(vertices, faces):
        raise AvatarError(f"avatar {source}: {fault}")
    key = np.concatenate([array.reshape(len(vertices), -1).astype(np.float64) for array in (vertices, *attributes)], 1)
    faces = _first_of_its_kind(key + 0.0)[faces]
    corners, wound = np.sort(faces, axis=1), (faces < np.roll(faces, -1, axis=1)).sum(axis=1)
    own = corners if surface.face_parts is None else np.column_stack([corners, surface.face_parts])
    kept = (np.diff(corners) > 0).all(axis=1) & (_first_of_its_kind(own) == np.arange(len(faces)))
    kept &= wound == wound[_first_of_its_kind(corners)]
    used, faces = np.unique(faces[kept], return_inverse=True)
    if len(used) == 0:
        raise AvatarError(f"avatar {source}: all faces are degenerate; a triangle mesh is needed")
    parts, seen = (None if each is None else each[kept] for each in (surface.face_parts, surface.seen))
    cleaned = replace(surface, vertices=vertices[used], faces=faces.reshape(-1, 3), face_parts=parts, seen=seen)
    return cleaned, tuple(array[used] for array in attributes), kept


def _first_of_its_kind(rows: np.ndarray) -> np.ndarray:
    """Index of the first row equal to each row of (n, k), (n,). `np.unique` sorts rows under the interpreter's lock,
    which would hold up the clouds of a running node; columns are sorted without it."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = np.empty(len(rows), dtype=np.intp)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def unit_scale(vertices: np.ndarray) -> tuple[float, tuple[str, ...]]:
    """Metres per unit of a person's vertices (V, 3), guessed from the size, and a warning unless they are in metres."""
    size = float(np.ptp(vertices, axis=0).max())
    low, high = USUAL_SIZES
    for unit, scale in UNITS.items():
        if not HEIGHT_RANGE[0] <= size <= HEIGHT_RANGE[1] and low <= size * scale <= high:
            return scale, (f"{size:.4g} units in size: taken to be in {unit}, {size * scale:.2f} m",)
    return 1.0, ()


def check_size(vertices: np.ndarray, source: str) -> None:
    """Raise AvatarError unless the height is that of a person in metres."""
    height = float(np.ptp(vertices[:, 2]))
    low, high = HEIGHT_RANGE
    if not low <= height <= high:
        raise AvatarError(
            f"avatar {source} is {height:.4g} m high, allowed {low} to {high} m, or {USUAL_SIZES[0]} to "
            f"{USUAL_SIZES[1]} m in {', '.join(UNITS)}; a plain mesh's rig file may say "
            '"scale": 0.01, "up": "Y", "forward": "Z"'
        )


def turn_upright(mesh: SkinnedMesh, bone_joint: Mapping[str, int], rig: Rig) -> SkinnedMesh:
    """Turn until the skeleton stands up and looks forward: by quarters, and on where it is still turned or tilted more
    than a posture explains. A warning says when that was needed."""
    from scipy.spatial.transform import Rotation

    ends = [f"{bone}.{side}" for bone in ("upperarm01", "upperleg01") for side in "LR"]
    if any(name not in bone_joint for name in ends):
        return mesh
    heads = {bone: mesh.joint_heads[joint] for bone, joint in bone_joint.items()}
    left_arm, right_arm, left_leg, right_leg = (heads[name] for name in ends)
    up = (left_arm + right_arm) - (left_leg + right_leg)
    left = (left_arm - right_arm) + (left_leg - right_leg)
    if min(np.linalg.norm(up), np.linalg.norm(left), np.linalg.norm(np.cross(left, up))) < 1e-6:
        raise AvatarError(
            f"avatar {mesh.source}: shoulders and hips fall together, the skeleton has no upright direction"
        )
    turn, warnings = nearest_quarter_turn(_axes(left, up).T), mesh.warnings
    if not np.array_equal(turn, np.eye(3)):
        facing, rising = _axis_name(turn[0]), _axis_name(turn[2])
        warnings += (f"the skeleton faces {facing} with {rising} up where X and Z were expected: turned",)
    own, usual = (
        _standing_axes({bone: turn @ at for bone, at in heads.items()}),
        _standing_axes(dict(zip(rig.bone_names, rig.heads))),
    )
    heading = np.degrees(np.arctan2(-own[0][0, 1], own[0][1, 1]))
    leans = [one[:, 2] - other[:, 2] for one, other in zip(own[1:], usual[1:])]
    least = min(map(np.linalg.norm, leans))
    if least > MOST_LEAN and leans[0] @ leans[1] > 0:
        turn = usual[0] @ own[0].T @ turn
        warnings += (f"the skeleton is tilted by {np.degrees(least):.0f} degrees: turned upright",)
    elif abs(heading) > MOST_HEADING:
        turn = Rotation.from_euler("z", -heading, degrees=True).as_matrix() @ turn
        warnings += (f"the skeleton is turned by {heading:.0f} degrees about the upright axis: turned back",)
    if np.array_equal(turn, np.eye(3)):
        return mesh
    transforms = np.zeros((len(mesh.joint_names), 3, 4))
    transforms[:, :, :3] = turn
    return with_joints_moved(replace(mesh, vertices=mesh.vertices @ turn.T, warnings=warnings), transforms)


def with_joints_moved(mesh: SkinnedMesh, transforms: np.ndarray) -> SkinnedMesh:
    """The mesh with its joints, but not its vertices, moved by transforms (j, 3, 4)."""
    frames = mesh.joint_frames
    if frames is not None:
        frames = frames.copy()
        frames[:, :3] = transforms[..., :3] @ frames[:, :3]
        frames[:, :3, 3] += transforms[..., 3]
    heads, tails = (
        np.einsum("jab,jb->ja", transforms[..., :3], at) + transforms[..., 3]
        for at in (mesh.joint_heads, mesh.joint_tails)
    )
    return replace(mesh, joint_heads=heads, joint_tails=tails, joint_frames=frames)


def _standing_axes(heads: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Of somebody whose joints are at (3,): columns forward, left and up (3, 3), where up is from between the feet to
    between the shoulders; and the same with the way up of the trunk, and of the legs."""
    bones = "upperarm01", "upperleg01"
    shoulders, hips = (sum(heads[f"{bone}.{side}"] for side in "LR") for bone in bones)
    feet = sum(heads.get(f"foot.{side}", heads[f"upperleg01.{side}"] - [0, 0, 1]) for side in "LR")
    left = sum(heads[f"{bone}.L"] - heads[f"{bone}.R"] for bone in bones)
    ways_up = shoulders - feet, shoulders - hips, hips - feet
    return [_axes(left, up - left * (left @ up) / (left @ left)) for up in ways_up]


def _axes(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(3, 3) columns forward, left and up, of two directions (3,)."""
    left, up = left / np.linalg.norm(left), up / np.linalg.norm(up)
    return np.stack([np.cross(left, up), left, up], axis=1)


def _axis_name(direction: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return ("-" if direction[axis] < 0 else "") + "XYZ"[axis]
