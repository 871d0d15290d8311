"""Canonical pose: bring a body, however its arms and legs are held, into the garment model's A-pose.

The trunk stays as it is; each limb segment is turned by the smallest rotation that gives it the canonical rig's
direction, children following their parents. Applied alike to training bodies and to users' avatars, so that the same
person encodes alike from a T-pose and from an A-pose.

Dimensions: `j` joints.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

__all__ = [
    *("LIMB_SEGMENTS", "limb_rotations", "nearest_quarter_turn", "smallest_rotation", "t_pose_rotations"),
    "turned_down_the_chain",
]

LIMB_SEGMENTS = {
    f"{start}.{side}": (f"{start}.{side}", f"{end}.{side}")
    for side in "LR"
    for chain in (("upperarm01", "lowerarm01", "wrist"), ("upperleg01", "lowerleg01", "foot"))
    for start, end in zip(chain[:-1], chain[1:], strict=True)
}
"""Bone that turns -> (bone whose head starts the segment, bone whose head ends it); parents come before children."""


def smallest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation of least angle taking direction `start` (3,) to direction `end` (3,). Returns (3, 3).

    Opposite directions have no unique answer: half a turn about an axis perpendicular to `start`.
    Raises ValueError when a direction has no length.
    """
    start_length, end_length = np.linalg.norm(start), np.linalg.norm(end)
    if not (start_length > 1e-9 and end_length > 1e-9):
        raise ValueError(f"a limb segment has no length: {np.asarray(start).tolist()} -> {np.asarray(end).tolist()}")
    a, b = np.asarray(start) / start_length, np.asarray(end) / end_length
    cosine = float(a @ b)
    if cosine < -1 + 1e-9:
        perpendicular = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        perpendicular /= np.linalg.norm(perpendicular)
        return 2 * np.outer(perpendicular, perpendicular) - np.eye(3)
    x, y, z = np.cross(a, b)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def nearest_quarter_turn(turn: np.ndarray) -> np.ndarray:
    """The orthogonal matrix nearest to `turn` (3, 3) that takes axes to axes, a mirror image where that is one."""
    from scipy.spatial.transform import Rotation

    quarters = np.sign(np.linalg.det(turn)) * np.round(Rotation.create_group("O").as_matrix())
    return max(quarters, key=lambda candidate: np.trace(candidate.T @ turn))


def limb_rotations(heads: Mapping[str, np.ndarray], canonical_heads: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """World rotation (3, 3) that each limb bone of `LIMB_SEGMENTS` needs to reach its canonical direction.

    heads, canonical_heads: joint centres (3,) [m] by rig bone name, root frame. Segments missing from either are
    skipped. A lower segment's rotation includes its upper segment's.
    """
    rotations: dict[str, np.ndarray] = {}
    previous_end: dict[str, str] = {}
    for bone, (start, end) in LIMB_SEGMENTS.items():
        if any(name not in table for name in (start, end) for table in (heads, canonical_heads)):
            continue
        carried = rotations[previous_end[start]] if start in previous_end else np.eye(3)
        direction = carried @ (np.asarray(heads[end]) - np.asarray(heads[start]))
        target = np.asarray(canonical_heads[end]) - np.asarray(canonical_heads[start])
        rotations[bone] = smallest_rotation(direction, target) @ carried
        previous_end[end] = bone
    return rotations


def t_pose_rotations(heads: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """As `limb_rotations`, to arms straight out and legs straight down."""
    straight = {name: np.zeros(3) for name in heads}
    for start, end in LIMB_SEGMENTS.values():
        outward = np.array([0.0, 1.0 if start.endswith("L") else -1.0, 0.0])
        straight[end] = straight[start] + (outward if "arm" in start else np.array([0.0, 0.0, -1.0]))
    return limb_rotations(heads, straight)


def turned_down_the_chain(
    heads: np.ndarray, parents: np.ndarray, turns: Mapping[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Give joints the world rotations (3, 3) of `turns`; the others follow their parents, to which all stay attached.

    heads: (j, 3) [m]. parents: (j,), a parent before its children, -1 for none.
    Returns transforms (j, 3, 4) from the old to the new pose, and the new heads (j, 3).
    """
    rotation, posed = np.tile(np.eye(3), (len(heads), 1, 1)), np.array(heads, dtype=np.float64)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            posed[joint] = posed[parent] + rotation[parent] @ (heads[joint] - heads[parent])
            rotation[joint] = rotation[parent]
        rotation[joint] = turns.get(joint, rotation[joint])
    translation = posed - np.einsum("jab,jb->ja", rotation, heads)
    return np.concatenate([rotation, translation[..., None]], axis=2), posed
