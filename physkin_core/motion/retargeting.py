"""Retargeting of motion from another humanoid to the default rig.

The rig follows the directions and hinges of the source's limbs: a bounded least-squares problem over the rig's degrees
of freedom, all frames of a clip at once (`pose_solver`). A light pull towards the canonical pose shares one source
rotation among the rig's bones (one chest joint, three spine bones; a limb's twist over its two halves).

Dimensions: `T` frames, `b` bones, `d` degrees of freedom. Radians and metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.motion import Motion
from physkin_core.motion.pose_solver import PoseSolver
from physkin_core.progress import Watch
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig

__all__ = ["leg_length", "on_floor", "retarget"]

# Source joint -> (rig bone that follows it, bones whose heads give the limb's direction; None: turns as a whole).
FOLLOWERS: dict[str, tuple[str, tuple[str, str] | None]] = {"chest": ("spine02", None), "neck": ("head", None)}
for _side in ("L", "R"):
    FOLLOWERS |= {
        f"clavicle.{_side}": (f"clavicle.{_side}", (f"clavicle.{_side}", f"upperarm01.{_side}")),
        f"hip.{_side}": (f"upperleg02.{_side}", (f"upperleg01.{_side}", f"lowerleg01.{_side}")),
        f"knee.{_side}": (f"lowerleg01.{_side}", (f"lowerleg01.{_side}", f"foot.{_side}")),
        f"ankle.{_side}": (f"foot.{_side}", None),
        f"shoulder.{_side}": (f"upperarm02.{_side}", (f"upperarm01.{_side}", f"lowerarm01.{_side}")),
        f"elbow.{_side}": (f"lowerarm01.{_side}", (f"lowerarm01.{_side}", f"wrist.{_side}")),
    }
UNUSED_BONES = ("wrist",)  # files do not agree on how palms lie at rest

HINGE_SHARE = 0.3  # how much a limb's hinge axis counts beside its direction
FOOT_SHARE = 0.15  # the rig's ankle does not turn about the shin: its foot must not drag the leg along
BLOCK = 128  # frames posed together: bounds the memory


def retarget(
    rig: Rig, rotations: dict[str, Rotation], *, watch: Watch = lambda share: None
) -> tuple[np.ndarray, dict[str, float]]:
    """Joint positions (T, d) [rad] that follow global source rotations, and how well they do.

    rotations: of `root`, `chest`, `neck`, and `clavicle`, `hip`, `knee`, `ankle`, `shoulder`, `elbow` with `.L` and
    `.R`, T each, relative to a body that looks along X, Z up, arms and legs hanging straight down, elbows and knees
    bending about Y. Collar bones that are left out stay at rest.
    watch: told the share done, 0 to 1, after every iteration.
    The report gives, by rig bone, the mean and largest angle [degrees] between its direction (trunk and feet: its
    orientation) and the source's, and `at_limit`, the share of solved joint positions that lie on a limit.
    """
    followers = {joint: follower for joint, follower in FOLLOWERS.items() if joint in rotations}
    bones = [rig.bone_index(bone) for bone, _ in followers.values()]
    axes, targets = zip(*(_directions(rig, rotations, joint) for joint in followers), strict=True)
    axes, targets = np.stack(axes), np.stack(targets, axis=1)
    still = UNUSED_BONES if "clavicle.L" in rotations else (*UNUSED_BONES, "clavicle")
    solver = PoseSolver(rig, bones, axes, still=still)

    q = solver.solve(targets, watch)
    turned = np.concatenate([rig.bone_transforms(part)[:, bones, :, :3] for part in _parts(q)]) @ axes
    report = {}
    for k, (bone, limb) in enumerate(followers.values()):
        if limb is None:
            angle = Rotation.from_matrix(turned[:, k] @ targets[:, k].transpose(0, 2, 1)).magnitude()
        else:
            angle = np.arccos(np.clip(np.sum(turned[:, k, :, 0] * targets[:, k, :, 0], axis=1), -1, 1))
        report[bone] = (float(np.degrees(angle.mean())), float(np.degrees(angle.max())))
    at_limit = (q <= rig.lower + 1e-6) | (q >= rig.upper - 1e-6)
    return q, {**report, "at_limit": float(at_limit[:, solver.dofs].mean())}


def leg_length(rig: Rig) -> float:
    """Thigh and shin of the rig [m], by which a source's walk is scaled."""
    hip, knee, ankle = (rig.heads[rig.bone_index(f"{bone}.L")] for bone in ("upperleg01", "lowerleg01", "foot"))
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def on_floor(motion: Motion) -> Motion:
    """Shift the clip up or down as a whole so that the template body stands on Z = 0 in all but its lowest frames."""
    body = load_body_model()
    rig, vertices = body.rig, body.vertices(body.garment_body)
    points = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    weights = dense_weights(body.influence_bones, body.influence_weights, rig.bone_count)
    carried = (weights[:, :, None] * points[:, None]).reshape(len(points), -1).astype(np.float32)  # (V, b 4)
    up = Rotation.from_quat(motion.root_orientation).as_matrix()[:, 2]  # world Z in the root frame
    lowest = motion.root_position[:, 2].astype(np.float64)
    for part in _parts(np.arange(motion.frame_count)):
        rows = np.einsum("ti,tbij->tbj", up[part], rig.bone_transforms(motion.positions[part]))
        lowest[part] += (carried @ rows.reshape(len(part), -1).T.astype(np.float32)).min(axis=0)  # of heights (V, t)
    return replace(motion, root_position=motion.root_position - [0.0, 0.0, np.quantile(lowest, 0.1)])


def _parts(frames: np.ndarray) -> Iterator[np.ndarray]:
    """An array (T, ...), a bounded number of frames at a time."""
    return (frames[start : start + BLOCK] for start in range(0, len(frames), BLOCK))


def _directions(rig: Rig, rotations: dict[str, Rotation], joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Weighted axes of a rig bone at the canonical pose (3, 3), in columns, and where the source has them (T, 3, 3)."""
    relative = (rotations["root"].inv() * rotations[joint]).as_matrix()
    weights = np.diag([1.0, HINGE_SHARE, 0.0])
    bone, limb = FOLLOWERS[joint]
    if joint.startswith("clavicle"):  # its turn from rest leads the shoulder
        shoulder = rig.heads[rig.bone_index(limb[1])] - rig.heads[rig.bone_index(limb[0])]
        axes = np.outer(shoulder / np.linalg.norm(shoulder), [1.0, 0.0, 0.0])
        return axes, relative @ axes
    if limb is None:
        weights = np.eye(3) if joint in ("chest", "neck") else FOOT_SHARE * np.diag([1.0, HINGE_SHARE, HINGE_SHARE])
        return weights, relative @ weights
    head = {name: rig.heads[rig.bone_index(name)] for name in rig.bone_names}
    direction = head[limb[1]] - head[limb[0]]
    hinge = np.array([0.0, 1.0, 0.0])
    if "arm" in bone:  # the canonical elbow is bent: its hinge is known
        side = bone[-2:]
        elbow, wrist = head[f"lowerarm01{side}"], head[f"wrist{side}"]
        hinge = np.cross(wrist - elbow, elbow - head[f"upperarm01{side}"])
    along = direction / np.linalg.norm(direction)
    hinge = hinge - along * (hinge @ along)
    hinge /= np.linalg.norm(hinge)
    here = np.stack([along, hinge, np.cross(along, hinge)], axis=1)
    there = np.stack([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], axis=1)  # hanging; bends about Y
    return here @ weights, relative @ there @ weights
