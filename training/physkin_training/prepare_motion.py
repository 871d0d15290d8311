"""Retarget the motion clips inside the pybullet wheel (zlib licence) to the default rig.

`python -m physkin_training.prepare_motion` writes `physkin_core/assets/motions/*.safetensors` and prints how well each
clip is met. The source humanoid (DeepMimic's) looks along X, has Y up and its right at Z; at zero it stands with arms
and legs hanging straight down. Its limbs' directions and hinges are what the rig follows: a bounded least-squares
problem over the rig's degrees of freedom, all frames of a clip at once. A light pull towards the canonical pose shares
one source rotation among the rig's bones (one chest joint, three spine bones; a limb's twist over its two halves).

Dimensions: `T` frames, `b` bones, `d` degrees of freedom. Radians and metres.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.body_model import load_body_model
from physkin_core.motion import MOTIONS_DIRECTORY, Motion, save_motion
from physkin_core.rig import Rig

__all__ = ["CLIPS", "prepare_motion", "read_clip", "retarget"]

CLIPS = {
    "walk": "humanoid3d_walk",
    "run": "humanoid3d_run",
    "dance": "humanoid3d_dance_b",
    "kick": "humanoid3d_kick",
    "jump": "humanoid3d_jump",
    "cartwheel": "humanoid3d_cartwheel",
    "crawl": "humanoid3d_crawl",
}
RATE_HZ = 60.0

FROM_SOURCE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # source axes -> X forward, Z up

# Source joint -> (parent, columns of its quaternion w, x, y, z or of its hinge angle about source Z).
JOINTS = {
    "root": (None, slice(4, 8)),
    "chest": ("root", slice(8, 12)),
    "neck": ("chest", slice(12, 16)),
    "hip.R": ("root", slice(16, 20)),
    "knee.R": ("hip.R", 20),
    "ankle.R": ("knee.R", slice(21, 25)),
    "shoulder.R": ("chest", slice(25, 29)),
    "elbow.R": ("shoulder.R", 29),
    "hip.L": ("root", slice(30, 34)),
    "knee.L": ("hip.L", 34),
    "ankle.L": ("knee.L", slice(35, 39)),
    "shoulder.L": ("chest", slice(39, 43)),
    "elbow.L": ("shoulder.L", 43),
}
FRAME_SIZE = 44
SOURCE_LEG = (1.686184 + 1.639480) / 4  # [m] thigh and shin of the source humanoid (its description is in 1/4 m)
SOURCE_NOTE = "{clip}.txt of pybullet 3.2.7 (zlib licence), retargeted to the default rig: an altered version"

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
CLOSING_LIMIT = 0.5  # [rad] a cycle's ends may differ by this much in the source and still be closed


def read_clip(path: Path) -> tuple[dict[str, Rotation], np.ndarray, float, bool]:
    """Read a DeepMimic clip.

    Returns global rotations by source joint (T each), root positions (T, 3) [m], the rate [Hz] and whether the clip is
    meant as a cycle, in axes X forward, Y left, Z up. Raises ValueError for frames of another size or an uneven rate.
    """
    data = json.loads(Path(path).read_text())
    try:
        frames = np.array(data["Frames"], dtype=np.float64)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is not a DeepMimic clip: {error}") from error
    if frames.ndim != 2 or frames.shape[1] != FRAME_SIZE or len(frames) < 2:
        raise ValueError(f"{path}: frames have shape {frames.shape}; expected (T, {FRAME_SIZE}), T > 1")
    durations = frames[:-1, 0]
    if np.ptp(durations) > 0.01 * durations.mean():
        raise ValueError(f"{path}: frame durations differ, from {durations.min()} to {durations.max()} s")
    to_ours = Rotation.from_matrix(FROM_SOURCE)
    rotations: dict[str, Rotation] = {}
    for joint, (parent, columns) in JOINTS.items():
        if isinstance(columns, slice):
            local = Rotation.from_quat(np.roll(frames[:, columns], -1, axis=1))
        else:
            local = Rotation.from_rotvec(frames[:, [columns]] * [0.0, 0.0, 1.0])
        local = to_ours * local * to_ours.inv()
        rotations[joint] = local if parent is None else rotations[parent] * local
    return rotations, frames[:, 1:4] @ FROM_SOURCE.T, 1.0 / durations.mean(), data.get("Loop") == "wrap"


def retarget(rig: Rig, rotations: dict[str, Rotation], *, iterations: int = 60) -> tuple[np.ndarray, dict[str, float]]:
    """Joint positions (T, d) [rad] that follow global source rotations, and how well they do.

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

        def residual(q: np.ndarray, between: np.ndarray = between) -> np.ndarray:
            missed = rig.bone_transforms(q)[..., bones, :, :3] @ frames - targets
            pulls = [PULL * (q - rig.rest)[..., solved], SMOOTHING * (q - between)[..., solved]]
            return np.concatenate([missed.reshape(*q.shape[:-1], -1), *pulls], axis=-1)

        q = _bounded_step(residual, q, solved, rig)
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


def prepare_motion(path: Path, name: str, *, rig: Rig, rate_hz: float = RATE_HZ) -> tuple[Motion, dict[str, float]]:
    """Retarget one clip file: it starts above the world's origin, faces X and stands on the floor.

    Returns the clip and the report of `retarget`.
    """
    rotations, positions, source_hz, cycle = read_clip(path)
    joint_positions, report = retarget(rig, rotations)
    root = rotations["root"]
    forward = root[0].apply([1.0, 0.0, 0.0])
    ahead = Rotation.from_euler("z", -np.arctan2(forward[1], forward[0]))
    positions = ahead.apply(positions - positions[0] * [1, 1, 0]) * (_leg_length(rig) / SOURCE_LEG)
    motion = Motion(rig.joint_names, joint_positions, (ahead * root).as_quat(), positions, source_hz, name)
    if cycle:
        motion = _closed(motion)
    motion = motion.resampled(rate_hz)
    return _on_floor(replace(motion, positions=np.clip(motion.positions, rig.lower, rig.upper))), report


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


def _closed(motion: Motion) -> Motion:
    """Spread what is missing between the last and the first frame over the clip, so that it repeats.

    Joints and tilt are closed; heading and place on the floor may go on. A clip whose ends differ by more than
    `CLOSING_LIMIT` is returned as it is.
    """
    gap = motion.positions[0] - motion.positions[-1]
    root = Rotation.from_quat(motion.root_orientation)
    turned = (root[-1] * root[0].inv()).as_rotvec()
    tilt = (Rotation.from_rotvec(turned * [0, 0, 1]) * root[0] * root[-1].inv()).as_rotvec()
    if max(np.abs(gap).max(), np.linalg.norm(tilt)) > CLOSING_LIMIT:
        return motion
    share = np.linspace(0.0, 1.0, motion.frame_count)[:, None]
    lift = (motion.root_position[0] - motion.root_position[-1]) * [0, 0, 1]
    return replace(
        motion,
        positions=motion.positions + share * gap,
        root_orientation=(Rotation.from_rotvec(share * tilt) * root).as_quat(),
        root_position=motion.root_position + share * lift,
    )


def _leg_length(rig: Rig) -> float:
    hip, knee, ankle = (rig.heads[rig.bone_index(f"{bone}.L")] for bone in ("upperleg01", "lowerleg01", "foot"))
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def _on_floor(motion: Motion) -> Motion:
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


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", type=Path, help="folder of DeepMimic clips; default: the installed pybullet's")
    parser.add_argument("--output", type=Path, default=MOTIONS_DIRECTORY)
    arguments = parser.parse_args()
    source = arguments.source
    if source is None:
        try:
            import pybullet_data
        except ImportError:
            parser.error("pybullet is not installed: pip install 'physkin[data]', or give --source")
        source = Path(pybullet_data.getDataPath()) / "data" / "motions"
    arguments.output.mkdir(parents=True, exist_ok=True)
    rig = load_body_model().rig
    for name, clip in CLIPS.items():
        motion, report = prepare_motion(source / f"{clip}.txt", name, rig=rig)
        path = arguments.output / f"{name}.safetensors"
        save_motion(motion, path, notes={"source": SOURCE_NOTE.format(clip=clip), "licence": "Zlib"})
        seconds, kind = (motion.frame_count - 1) / motion.rate_hz, "a cycle" if motion.is_cycle else "not a cycle"
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB, {seconds:.2f} s, {kind}")
        at_limit = report.pop("at_limit")
        print(f"  {100 * at_limit:.1f} % of joint positions at a limit; error in degrees, mean / largest:")
        print("  " + ", ".join(f"{bone} {mean:.1f} / {largest:.1f}" for bone, (mean, largest) in report.items()))


if __name__ == "__main__":
    main()
