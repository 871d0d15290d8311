"""Scenes that cloth with inertia is simulated in: clips eased in and out, plain motions of the root, and two that are
acted: a walk upstairs, and sitting down.

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
    "ACTED_SCENES",
    "LOOPED",
    "RATE_HZ",
    "RISE",
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
ACTING_BEGINS = 0.25
RISE, GOING, STEP_SECONDS = 0.19, 0.28, 0.6
"""[m] height and depth of a stair, and how long a foot is on its way."""
LEAD = 0.03
"""[m] the root is before the foot that stands when it is about to lift off."""
FOOTSTEPS = (("L", 0, 1), ("R", 0, 2), ("L", 1, 3), ("R", 2, 3))
"""Which foot goes from which stair to which."""
SITS_DOWN = 1.5
SEAT_DROP, SEAT_BACK = 0.38, 0.40
"""[m] by how much the hips of one who sits are lower, and farther back."""
ACTED_SCENES = {"stairs": ACTING_BEGINS + STEP_SECONDS * len(FOOTSTEPS), "sit": ACTING_BEGINS + SITS_DOWN}
"""Motions of the whole body that are made here, and when each ends [s]: three stairs up, thighs raised to 70 degrees in
turn; down on a chair until thighs are level. There is neither stair nor chair that cloth could touch."""


def load_scene(name: str, rig: Rig, *, seconds: float) -> Motion:
    """A scene of ceil(60 seconds) frames at 60 Hz.

    name: one of `ROOT_SCENES` or `ACTED_SCENES`; or a clip as `load_motion` takes it, from its start or, written
    CLIP@SECONDS, later.
    Raises MotionError for a clip that is not there, shorter than its start, a scene too short to ease in and out or
    to be acted to its end, or a rig that cannot act it.
    """
    if not (math.isfinite(seconds) and seconds >= STANDING + 3 * EASE):
        raise MotionError(f"a scene lasts {STANDING + 3 * EASE:g} seconds or more, got {seconds}")
    times = np.arange(math.ceil(round(seconds * RATE_HZ, 6))) / RATE_HZ
    if name in ROOT_SCENES:
        return _root_scene(name, rig, times)
    if name in ACTED_SCENES:
        return _acted_scene(name, rig, times)
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


def _acted_scene(name: str, rig: Rig, times: np.ndarray) -> Motion:
    """Root and feet go along smooth steps; legs follow in their planes, so that a foot that stands stays."""
    if times[-1] < (least := ACTED_SCENES[name] + EASE):
        raise MotionError(f"scene {name!r} lasts {least:.2f} seconds or more, got {times[-1]:.2f}")
    root, pitch, joints = (_upstairs if name == "stairs" else _sitting)(rig, times)
    index = {joint: k for k, joint in enumerate(rig.joint_names)}
    if missing := sorted(joints.keys() - index.keys()):
        raise MotionError(f"scene {name!r} needs joints that the rig has not: {', '.join(missing)}")
    positions = np.tile(rig.rest, (len(times), 1))
    for joint, angles in joints.items():
        positions[:, index[joint]] += angles
    positions = positions.clip(rig.lower, rig.upper)
    orientation = Rotation.from_euler("y", pitch[:, None]).as_quat()
    return Motion(rig.joint_names, positions, orientation, root + [0, 0, ROOT_HEIGHT], RATE_HZ, name)


def _upstairs(rig: Rig, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    begin = ACTING_BEGINS + STEP_SECONDS * np.arange(len(FOOTSTEPS))
    root = np.zeros((len(times), 3))
    for since, ahead, up in zip(begin, np.diff([0, LEAD, LEAD + GOING, LEAD + 2 * GOING, 3 * GOING]), (0, 1, 1, 1)):
        # each stair's part overlaps with the next one's, as nobody halts on a stair
        root[:, 0] += ahead * smooth_step((times - since + 0.1) / (STEP_SECONDS + 0.1))
        root[:, 2] += RISE * up * smooth_step((times - since) / STEP_SECONDS)
    climbs = smooth_step((times - ACTING_BEGINS) / 0.5) * (1 - smooth_step((times - begin[-1]) / STEP_SECONDS))
    root[:, 2] -= 0.02 * climbs
    feet = {side: np.zeros((len(times), 3)) for side in "LR"}
    toes = {side: np.zeros(len(times)) for side in "LR"}
    arms = np.zeros(len(times))
    for since, (side, low, high) in zip(begin, FOOTSTEPS):
        u = (times - since) / STEP_SECONDS
        lifted = smooth_step(u / 0.45) * (1 - smooth_step((u - 0.55) / 0.45))
        feet[side][:, 0] += (high - low) * GOING * smooth_step((u - 0.12) / 0.82)
        feet[side][:, 2] += (high - low) * RISE * smooth_step(u / 0.7) + 0.07 * lifted
        toes[side] += np.radians(25) * smooth_step(u / 0.25) * (1 - smooth_step((u - 0.25) / 0.5))
        arms += (1 if side == "L" else -1) * smooth_step(u / 0.6) * (1 - smooth_step((u - 0.6) / 0.8))
    pitch = np.radians(6) * climbs
    joints = _bent(climbs * np.radians(5))
    for side, sign in (("L", 1), ("R", -1)):
        joints |= _leg(rig, side, root, pitch, feet[side], toes[side])
        joints[f"upperarm01.{side}_x"] = -sign * np.radians(24) * smooth_step(times / 0.6)
        joints[f"upperarm01.{side}_z"] = np.radians(22) * arms
    return root, pitch, joints


def _sitting(rig: Rig, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    u = (times - ACTING_BEGINS) / SITS_DOWN
    root = np.zeros((len(times), 3))
    root[:, 0] = -SEAT_BACK * smooth_step(u / 0.9)
    root[:, 2] = -SEAT_DROP * smooth_step((u - 0.05) / 0.95)
    leans = smooth_step(u / 0.6) * (1 - smooth_step((u - 0.55) / 0.45))
    pitch = np.radians(28) * leans
    joints = _bent(np.radians(8) * leans) | planted_legs(rig, root, pitch)
    for side, sign in (("L", 1), ("R", -1)):
        joints[f"upperarm01.{side}_x"] = -sign * np.radians(20) * smooth_step(u)
        joints[f"upperarm01.{side}_z"] = -sign * np.radians(25) * smooth_step(u)
    return root, pitch, joints


def planted_legs(rig: Rig, root: np.ndarray, pitch: np.ndarray) -> dict[str, np.ndarray]:
    """Turns (T,) [rad] of hips, knees and ankles, by joint names, that leave both feet where they stand at rest, while
    the root goes by `root` (T, 3) and leans forwards by `pitch` (T,). Raises MotionError for a rig without such legs.
    """
    stays, flat = np.zeros((len(pitch), 3)), np.zeros(len(pitch))
    return _leg(rig, "L", root, pitch, stays, flat) | _leg(rig, "R", root, pitch, stays, flat)


def _bent(lean: np.ndarray) -> dict[str, np.ndarray]:
    """The spine leans forwards by three times `lean` (T,)."""
    return {f"{bone}_y": lean for bone in ("spine05", "spine03", "spine02")}


def _leg(
    rig: Rig, side: str, root: np.ndarray, pitch: np.ndarray, foot: np.ndarray, toes: np.ndarray
) -> dict[str, np.ndarray]:
    """Turns (T,) of hip, knee and ankle that bring the ankle from where it is at rest by `foot` (T, 3), while the root
    goes by `root` (T, 3) and leans forwards by `pitch` (T,); the sole is turned down at the toes by `toes` (T,)."""
    bones = [f"{bone}.{side}" for bone in ("upperleg01", "lowerleg01", "foot")]
    if missing := [bone for bone in bones if bone not in rig.bone_names]:
        raise MotionError(f"a rig without bones {', '.join(missing)} can neither climb nor sit")
    # in the plane across Y, as complex numbers whose angle is about Y: turns by a multiply by exp(i a)
    hip, knee, ankle = (rig.heads[rig.bone_index(bone)] @ [1, 0, -1j] for bone in bones)
    way = (ankle + (foot - root) @ [1, 0, -1j]) * np.exp(-1j * pitch) - hip
    thigh, shin = knee - hip, ankle - knee
    cosine = (np.abs(way) ** 2 - abs(thigh) ** 2 - abs(shin) ** 2) / (2 * abs(thigh * shin))
    bend = np.arccos(np.clip(cosine, -1, 1)) + np.angle(thigh / shin)
    turn = np.angle(way / (thigh + shin * np.exp(1j * bend)))
    return {f"{bones[0]}_y": turn, f"{bones[1]}_y": bend, f"{bones[2]}_y": toes - pitch - turn - bend}


def smooth_step(u: np.ndarray) -> np.ndarray:
    """0 before 0, 1 after 1, between with acceleration that does not jump."""
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)


def _ramped(t: np.ndarray, length: float) -> np.ndarray:
    """Integral of `smooth_step(t / length)`."""
    u = np.clip(t / length, 0, 1)
    return length * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - length, 0)
