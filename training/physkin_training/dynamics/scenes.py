"""Scenes that cloth with inertia is simulated in: clips eased in and out, and plain motions of the root.

A scene begins and ends at rest, so that what cloth does comes from what is seen of the motion and nothing else.
Dimensions: `T` frames, `d` degrees of freedom. Radians, metres, seconds.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from physkin_core.motion.loading import load_motion
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.rig.rig import Rig

__all__ = [
    "LOOPED",
    "RATE_HZ",
    "ROOT_SCENES",
    "SWING_ACCELERATION",
    "load_scene",
    "planted_legs",
    "scene_wind",
    "smooth_step",
]

RATE_HZ = 60.0
EASE = 0.4
"""Seconds in which a clip starts from standing, and comes to a stop."""
STANDING = 1.5
"""Seconds at the end in which the body stands still."""
SWING_ACCELERATION = 2.5
"""[m/s2] largest sideways acceleration of the swinging root."""
SWING_BEGINS = 0.25
LOOPED = ("walk", "run")
"""Shipped clips whose end goes on as they begin, in speed, too."""
ROOT_SCENES = ("swing-0.5", "swing-1", "swing-2", "swing-4", "stop", "turn", "slow-turn", "gust")
"""Motions of the root of a body that holds the rig's rest pose: to and fro sideways, so many times a second; ahead at
1.4 m/s and a stop within a quarter of a second; a turn by 180 degrees within 0.6 seconds, and a whole one within 2.4;
none, while the wind blows."""
ROOT_HEIGHT = 0.9
"""[m] of a body that stands."""
GUST = 4.0
"""[m/s] from the left behind, for a second and a half."""


def load_scene(name: str, rig: Rig, *, seconds: float) -> Motion:
    """A scene of ceil(60 seconds) frames at 60 Hz.

    name: one of `ROOT_SCENES`; or a clip as `load_motion` takes it, from its start or, written
    CLIP@SECONDS, later.
    Raises MotionError for a clip that is not there or shorter than its start, or a scene too short to ease in and out.
    """
    if not (math.isfinite(seconds) and seconds >= STANDING + 3 * EASE):
        raise MotionError(f"a scene lasts {STANDING + 3 * EASE:g} seconds or more, got {seconds}")
    times = np.arange(math.ceil(round(seconds * RATE_HZ, 6))) / RATE_HZ
    if name in ROOT_SCENES:
        return _root_scene(name, rig, times)
    clip, _, start = name.partition("@")
    motion = load_motion(clip)
    begin = float(start) if start else 0.0
    if motion.name in LOOPED:
        motion = motion.looped(begin + seconds)
    lasts = (motion.frame_count - 1) / motion.rate_hz
    if not 0 <= begin <= lasts - 2 * EASE:
        raise MotionError(f"scene {name!r} begins at {begin:g} s; the clip lasts {lasts:.1f} s and eases in and out")
    return _eased(motion, begin, min(lasts - begin, seconds - STANDING - EASE), times)


def scene_wind(motion: Motion) -> np.ndarray:
    """Wind (T, 3) [m/s] in the world in the frames of a scene: in `gust` it rises within 0.3 s and falls within 0.5."""
    times = np.arange(motion.frame_count) / motion.rate_hz
    blows = smooth_step((times - 0.5) / 0.3) * (1 - smooth_step((times - 2.0) / 0.5))
    return np.outer(GUST * blows * (motion.name == "gust"), [0.6, -0.8, 0.0])


def _eased(motion: Motion, begin: float, length: float, times: np.ndarray) -> Motion:
    """`length` seconds of a clip, played from standing still to standing still."""
    source = begin + _eased_time(times, length)
    frames = np.arange(motion.frame_count) / motion.rate_hz
    return Motion(
        motion.joint_names,
        CubicSpline(frames, motion.positions, bc_type="natural")(source),
        RotationSpline(frames, Rotation.from_quat(motion.root_orientation))(source).as_quat(),
        CubicSpline(frames, motion.root_position, bc_type="natural")(source),
        RATE_HZ,
        f"{motion.name}@{begin:g}" if begin else motion.name,
    )


def _eased_time(times: np.ndarray, length: float) -> np.ndarray:
    """Time of the clip at times of the scene: its speed goes from 0 to 1 and at the end back, by smooth steps."""

    def ramp(t: np.ndarray) -> np.ndarray:  # integral of the smooth step 3 u^2 - 2 u^3 over u = t / EASE
        u = np.clip(t / EASE, 0, 1)
        return EASE * (u**3 - u**4 / 2) + np.maximum(t - EASE, 0)

    return np.clip(ramp(times) - ramp(times - length), 0, length)


def _root_scene(name: str, rig: Rig, times: np.ndarray) -> Motion:
    position, yaw = np.zeros((len(times), 3)), np.zeros(len(times))
    if name == "turn":
        yaw = np.pi * smooth_step((times - 1.0) / 0.6)
    elif name == "stop":
        position[:, 0] = 1.4 * (_ramped(times - 0.25, 0.5) - _ramped(times - 2.0, 0.25))
    elif name == "slow-turn":
        yaw = 2 * np.pi * smooth_step((times - 0.4) / 2.4)
    elif name.startswith("swing"):
        rate = 2 * np.pi * float(name.partition("-")[2])
        since = np.maximum(times - SWING_BEGINS, 0)
        position[:, 1] = SWING_ACCELERATION / rate**2 * np.sin(rate * since) * smooth_step(since * rate / (2 * np.pi))
    orientation = Rotation.from_euler("z", yaw[:, None]).as_quat()
    positions = np.tile(rig.rest, (len(times), 1))
    return Motion(rig.joint_names, positions, orientation, position + [0, 0, ROOT_HEIGHT], RATE_HZ, name)


def planted_legs(rig: Rig, root: np.ndarray, pitch: np.ndarray) -> dict[str, np.ndarray]:
    """Turns (T,) [rad] of hips, knees and ankles, by joint names, that leave both feet where they stand at rest, while
    the root goes by `root` (T, 3) and leans forwards by `pitch` (T,). Raises MotionError for a rig without such legs.
    """
    turns = {}
    for side in "LR":
        bones = [f"{bone}.{side}" for bone in ("upperleg01", "lowerleg01", "foot")]
        if missing := [bone for bone in bones if bone not in rig.bone_names]:
            raise MotionError(f"a rig without bones {', '.join(missing)} cannot sit")
        # in the plane across Y, as complex numbers whose angle is about Y: turns by a multiply by exp(i a)
        hip, knee, ankle = (rig.heads[rig.bone_index(bone)] @ [1, 0, -1j] for bone in bones)
        to_ankle = (ankle - root @ [1, 0, -1j]) * np.exp(-1j * pitch) - hip
        thigh, shin = knee - hip, ankle - knee
        cosine = (np.abs(to_ankle) ** 2 - abs(thigh) ** 2 - abs(shin) ** 2) / (2 * abs(thigh * shin))
        bend = np.arccos(np.clip(cosine, -1, 1)) + np.angle(thigh / shin)
        turn = np.angle(to_ankle / (thigh + shin * np.exp(1j * bend)))
        turns |= {f"{bones[0]}_y": turn, f"{bones[1]}_y": bend, f"{bones[2]}_y": -pitch - turn - bend}
    return turns


def smooth_step(u: np.ndarray) -> np.ndarray:
    """0 before 0, 1 after 1, between with acceleration that does not jump."""
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)


def _ramped(t: np.ndarray, length: float) -> np.ndarray:
    """Integral of `smooth_step(t / length)`."""
    u = np.clip(t / length, 0, 1)
    return length * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - length, 0)
