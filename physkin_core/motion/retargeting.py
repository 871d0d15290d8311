"""Retargeting of motion from another humanoid to the default rig.

The rig follows the directions and hinges of the source's limbs: a bounded least-squares problem over the rig's degrees
of freedom, all frames of a clip at once. A light pull towards the canonical pose shares one source rotation among the
rig's bones (one chest joint, three spine bones; a limb's twist over its two halves).

Dimensions: `T` frames, `b` bones, `d` degrees of freedom. Radians and metres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.motion import Motion
from physkin_core.rig.rig import Rig

__all__ = ["leg_length", "on_floor", "retarget"]

# Source joint -> (rig bone that follows it, bones whose heads give the limb's direction; None: turns as a whole).
FOLLOWERS = {"chest": ("spine02", None), "neck": ("head", None)}
for _side in ("L", "R"):
    FOLLOWERS |= {
        f"hip.{_side}": (f"upperleg02.{_side}", (f"upperleg01.{_side}", f"lowerleg01.{_side}")),
        f"knee.{_side}": (f"lowerleg01.{_side}", (f"lowerleg01.{_side}", f"foot.{_side}")),
        f"ankle.{_side}": (f"foot.{_side}", None),
        f"shoulder.{_side}": (f"upperarm02.{_side}", (f"upperarm01.{_side}", f"lowerarm01.{_side}")),
        f"elbow.{_side}": (f"lowerarm01.{_side}", (f"lowerarm01.{_side}", f"wrist.{_side}")),
    }
UNUSED_BONES = ("clavicle", "wrist")  # the source has neither: they stay at rest

HINGE_SHARE = 0.3  # how much a limb's hinge axis counts beside its direction
FOOT_SHARE = 0.5  # the rig's ankle does not turn about the shin: its foot must not drag the leg along
PULL = 0.03  # towards the canonical pose [1/rad]; a limb's direction counts 1
SMOOTHING = 0.3  # towards the mean of the frames before and after [1/rad]
MAX_STEP = 0.4  # [rad] an iteration
BLOCK = 128  # frames solved together: bounds the memory


def retarget(rig: Rig, rotations: dict[str, Rotation], *, iterations: int = 60) -> tuple[np.ndarray, dict[str, float]]:
    """Joint positions (T, d) [rad] that follow global source rotations, and how well they do.

    rotations: of `root`, `chest`, `neck`, and `hip`, `knee`, `ankle`, `shoulder`, `elbow` with `.L` and `.R`, T each,
    relative to a body that looks along X, Z up, arms and legs hanging straight down, elbows and knees bending about Y.
    The report gives, by rig bone, the mean and largest angle [degrees] between its direction (trunk and feet: its
    orientation) and the source's, and `at_limit`, the share of solved joint positions that lie on a limit.
    """
    bones = [rig.bone_index(bone) for bone, _ in FOLLOWERS.values()]
    frames, targets = zip(*(_directions(rig, rotations, joint) for joint in FOLLOWERS), strict=True)
    frames, targets = np.stack(frames), np.stack(targets, axis=1)  # (targets, 3, 3), (T, targets, 3, 3)
    solved = [k for k, dof in enumerate(rig.dofs) if not dof.bone.startswith(UNUSED_BONES)]

    q = np.tile(np.clip(rig.rest, rig.lower, rig.upper), (targets.shape[0], 1))
    for _ in range(iterations):
        between = np.concatenate([q[:1], (q[:-2] + q[2:]) / 2, q[-1:]])
        steps = []
        for block in range(0, len(q), BLOCK):
            here = slice(block, block + BLOCK)

            def residual(q: np.ndarray, between: np.ndarray = between[here], targets: np.ndarray = targets[here]):
                missed = rig.bone_transforms(q)[..., bones, :, :3] @ frames - targets
                pulls = [PULL * (q - rig.rest)[..., solved], SMOOTHING * (q - between)[..., solved]]
                return np.concatenate([missed.reshape(*q.shape[:-1], -1), *pulls], axis=-1)

            steps.append(_bounded_step(residual, q[here], solved, rig))
        q = np.concatenate(steps)
    turned = rig.bone_transforms(q)[..., bones, :, :3] @ frames
    report = {}
    for k, (bone, limb) in enumerate(FOLLOWERS.values()):
        if limb is None:
            angle = Rotation.from_matrix(turned[:, k] @ targets[:, k].transpose(0, 2, 1)).magnitude()
        else:
            angle = np.arccos(np.clip(np.sum(turned[:, k, :, 0] * targets[:, k, :, 0], axis=1), -1, 1))
        report[bone] = (float(np.degrees(angle.mean())), float(np.degrees(angle.max())))
    at_limit = (q <= rig.lower + 1e-6) | (q >= rig.upper - 1e-6)
    return q, {**report, "at_limit": float(at_limit[:, solved].mean())}


def leg_length(rig: Rig) -> float:
    """Thigh and shin of the rig [m], by which a source's walk is scaled."""
    hip, knee, ankle = (rig.heads[rig.bone_index(f"{bone}.L")] for bone in ("upperleg01", "lowerleg01", "foot"))
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def on_floor(motion: Motion) -> Motion:
    """Shift the clip up or down as a whole so that the template body stands on Z = 0 in all but its lowest frames."""
    body = load_body_model()
    vertices = body.vertices(body.garment_body)
    points = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    up = Rotation.from_quat(motion.root_orientation).as_matrix()[:, 2]  # world Z in the root frame
    lowest = []
    for q, axis, height in zip(motion.positions, up, motion.root_position[:, 2], strict=True):
        rows = np.einsum("i,bij->bj", axis, body.rig.bone_transforms(q))  # a point's height, bone by bone
        heights = np.einsum("vk,vkj,vj->v", body.influence_weights, rows[body.influence_bones], points)
        lowest.append(heights.min() + height)
    return replace(motion, root_position=motion.root_position - [0.0, 0.0, np.quantile(lowest, 0.1)])


def _directions(rig: Rig, rotations: dict[str, Rotation], joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Weighted axes of a rig bone at the canonical pose (3, 3), in columns, and where the source has them (T, 3, 3)."""
    relative = (rotations["root"].inv() * rotations[joint]).as_matrix()
    weights = np.diag([1.0, HINGE_SHARE, 0.0])
    bone, limb = FOLLOWERS[joint]
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


def _bounded_step(residual, q: np.ndarray, solved: list[int], rig: Rig) -> np.ndarray:
    """One Gauss-Newton step of all frames (T, d) within the rig's limits; what pushes against a limit stays there."""
    nudge = 1e-5
    value = residual(q)
    nudged = np.repeat(q[None], len(solved), axis=0)
    nudged[np.arange(len(solved)), :, solved] += nudge
    jacobian = np.moveaxis((residual(nudged) - value) / nudge, 0, -1)  # (T, residuals, solved)
    gradient = np.einsum("trs,tr->ts", jacobian, value)
    low, high = rig.lower[solved], rig.upper[solved]
    held = ((q[:, solved] <= low) & (gradient > 0)) | ((q[:, solved] >= high) & (gradient < 0))
    jacobian = np.where(held[:, None], 0.0, jacobian)
    normal = jacobian.transpose(0, 2, 1) @ jacobian + 1e-9 * np.eye(len(solved))
    step = -np.linalg.solve(normal, np.where(held, 0.0, gradient)[..., None])[..., 0]
    step *= np.minimum(1.0, MAX_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
    q = q.copy()
    q[:, solved] = np.clip(q[:, solved] + step, low, high)
    return q
