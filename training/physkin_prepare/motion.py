"""Retarget the motion clips inside the pybullet wheel (zlib licence) to the default rig.

`python -m physkin_prepare.motion` writes `physkin_core/assets/motions/*.safetensors` and prints how well each
clip is met. The source humanoid (DeepMimic's) looks along X, has Y up and its right at Z; at zero it stands with arms
and legs hanging straight down, as `physkin_core.motion.retargeting` wants it.

Dimensions: `T` frames. Radians and metres.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.loading import MOTIONS_DIRECTORY, save_motion
from physkin_core.motion.motion import Motion
from physkin_core.motion.retargeting import leg_length, on_floor, retarget
from physkin_core.rig.rig import Rig

__all__ = ["CLIPS", "prepare_motion", "read_clip"]

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


def prepare_motion(path: Path, name: str, *, rig: Rig, rate_hz: float = RATE_HZ) -> tuple[Motion, dict[str, float]]:
    """Retarget one clip file: it starts above the world's origin, faces X and stands on the floor.

    Returns the clip and the report of `retarget`.
    """
    rotations, positions, source_hz, cycle = read_clip(path)
    joint_positions, report = retarget(rig, rotations)
    root = rotations["root"]
    forward = root[0].apply([1.0, 0.0, 0.0])
    ahead = Rotation.from_euler("z", -np.arctan2(forward[1], forward[0]))
    positions = ahead.apply(positions - positions[0] * [1, 1, 0]) * (leg_length(rig) / SOURCE_LEG)
    motion = Motion(rig.joint_names, joint_positions, (ahead * root).as_quat(), positions, source_hz, name)
    if cycle:
        motion = _closed(motion)
    motion = motion.resampled(rate_hz)
    return on_floor(replace(motion, positions=np.clip(motion.positions, rig.lower, rig.upper))), report


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
