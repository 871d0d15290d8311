"""Motions of walkers that cloth is simulated on, each drawn by its own seed, at 60 Hz.

A third are shipped clips, some with another bearing or along curves. A fifth go smoothly from one everyday pose to the
next. Some sit down and get up again. The others hold a pose, many of them just stand, while the root swings, stops or
turns. Most change their speed. In a third of all motions the wind blows, in gusts. Half of all are mirrored.

Dimensions: `B` walkers, `T` frames, `d` degrees of freedom. Radians, metres, seconds; world and root frame have Z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from physkin_core.motion.loading import load_motion
from physkin_core.rig.rig import Rig
from physkin_core.runtime.around_legs import of_legs
from physkin_training.dynamics.scenes import LOOPED, RATE_HZ, planted_legs, smooth_step
from physkin_training.energies.motion import Dynamics
from physkin_training.sampling.everyday_poses import EverydayPoses
from physkin_training.sampling.mirrored_poses import mirrored

__all__ = ["MotionPool", "WalkerMotions", "mirrored_motion"]

CLIPS = {"walk": 3.0, "run": 2.0, "dance": 2.0, "jump": 1.5, "kick": 1.5, "crawl": 0.7, "cartwheel": 0.7}
"""Shipped clips, and how often each is drawn."""
LOOPED_SECONDS = 12.0
FROM_CLIPS, THROUGH_POSES, SITTING = 0.34, 0.19, 0.07
"""Shares of the motions; the others hold a pose."""
AT_REST, NEARLY = 0.5, 0.2
"""Shares of held poses that are the rest pose, and that are near it: there a skirt swings free of what legs do."""
STEADY = 0.4
"""Share of the motions at an even speed, in which a swing to and fro keeps its rhythm."""
LOWEST_SEAT, HIGHEST_SEAT = 0.42, 0.28
"""[m] by how much hips are lower on a seat."""
POSES = 8192
MIRROR = np.diag([1.0, -1.0, 1.0])
BRAKES = 0.6
"""[s] in which a clip that ends comes to a stop."""
WINDY, LIGHTEST, STRONGEST = 0.33, 0.5, 6.0
"""Share of the motions in wind, and how strong gusts are [m/s]."""

Moved = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Joint positions (T, d), place (T, 3) and turn (T, 3, 3) of the root."""


@dataclass(frozen=True)
class WalkerMotions:
    """Joint positions (B, T, d) [rad] within limits; place (B, T, 3) [m], turn (B, T, 3, 3) of the root in the world;
    gravity (B, T, 3) in the root frame, in units of gravity, with the pull of the wind; all float32."""

    positions: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    gravity: np.ndarray


class MotionPool:
    """Draws motions of a rig. Raises ValueError for a rig that everyday poses are not of."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        generator = torch.Generator().manual_seed(0)
        poses, _ = EverydayPoses(rig, torch.device("cpu")).sample(POSES, generator=generator)
        self._poses = poses.numpy().astype(np.float64)
        self._of_legs = of_legs(rig)[rig.dof_bones]
        self._clips = []
        for name in CLIPS:
            motion = load_motion(name)
            motion = motion.looped(LOOPED_SECONDS) if name in LOOPED else motion
            orientation = RotationSpline(motion.times, Rotation.from_quat(motion.root_orientation))
            paths = (motion.positions_for(rig), motion.root_position)
            self._clips.append((*(CubicSpline(motion.times, path) for path in paths), orientation))
        chances = np.array(list(CLIPS.values()))
        self._chances = chances / chances.sum()

    def drawn(self, walkers: range, frames: int, *, seed: int) -> WalkerMotions:
        """Motions of these walkers, each of them by itself."""
        rows = [self._drawn(np.random.default_rng((seed, walker)), frames) for walker in walkers]
        return WalkerMotions(*(np.stack(arrays).astype(np.float32) for arrays in zip(*rows)))

    def _drawn(self, rng: np.random.Generator, frames: int) -> tuple[np.ndarray, ...]:
        own_time = _own_time(rng, frames)
        kind = rng.random()
        if kind < FROM_CLIPS:
            make = self._from_clip
        elif kind < FROM_CLIPS + THROUGH_POSES:
            make = self._through_poses
        elif kind < FROM_CLIPS + THROUGH_POSES + SITTING:
            make = self._sits_down
        else:
            make = self._held_pose
        positions, place, turn = make(rng, own_time)
        positions = positions.clip(self.rig.lower, self.rig.upper)
        if rng.random() < 0.5:
            positions, place, turn = mirrored_motion(self.rig, positions, place, turn)
        return positions, place, turn, Dynamics().effective_gravity(turn, _wind(rng, frames))

    def _from_clip(self, rng: np.random.Generator, own_time: np.ndarray) -> Moved:
        joints, root, orientation = self._clips[rng.choice(len(self._clips), p=self._chances)]
        last = joints.x[-1]
        begin = rng.uniform(0, min(max(last - 2.0, 0.0), 8.0)) if rng.random() < 0.7 else 0.0
        at = _braked(begin + own_time, last)
        positions, place, turn = joints(at), root(at), orientation(at).as_matrix()
        rest = self.rig.rest
        positions = rest + (positions - rest) * rng.uniform(0.8, 1.12)
        if rng.random() < 0.5:  # another bearing
            gaps = rng.uniform(0.8, 2.5, size=_gaps(own_time, 0.8))
            others = self._path(rng, gaps)
            positions = positions + rng.uniform(0, 0.2) * (others(np.arange(len(own_time)) / RATE_HZ) - rest)
        if rng.random() < 0.5:  # along a curve
            _, yaw = _wander(rng, own_time, rng.uniform(0.3, 1.2))
            turned = _about_vertical(yaw + own_time * rng.normal() * 0.5)
            steps = np.diff(place, axis=0, prepend=place[:1])
            place = place[0] + np.cumsum((turned @ steps[..., None])[..., 0], axis=0)
            turn = turned @ turn
        return positions, place, turn

    def _through_poses(self, rng: np.random.Generator, own_time: np.ndarray) -> Moved:
        quickest = rng.uniform(0.25, 0.8)
        gaps = rng.uniform(quickest, quickest + 0.9, size=_gaps(own_time, quickest))
        kind = rng.random()
        if kind < 0.25:  # anything within the limits, not quite as far
            rig, shape = self.rig, (len(gaps) + 1, len(self.rig.rest))
            poses = rig.rest + 0.6 * (rng.uniform(rig.lower, rig.upper, size=shape) - rig.rest)
            path = _spline(gaps, poses)
        else:
            path = self._path(rng, gaps, share=rng.uniform(0.2, 1) if kind < 0.625 else 1.0)
        place, yaw = _wander(rng, own_time, rng.uniform(0.2, 1.2))
        return path(own_time), place, _about_vertical(yaw)

    def _sits_down(self, rng: np.random.Generator, own_time: np.ndarray) -> Moved:
        """Down on a seat and up again, feet where they stand, with what the upper body does in an everyday pose."""
        seated, leans, begin = np.zeros(len(own_time)), np.zeros(len(own_time)), rng.uniform(0.1, 0.6)
        while begin < own_time[-1]:
            down, stays, up = rng.uniform(0.7, 1.8), rng.uniform(0.5, 2.5), rng.uniform(0.7, 1.5)
            falls, rises = (own_time - begin) / down, (own_time - begin - down - stays) / up
            seated += _pulse(own_time - begin, down, stays, up)
            leans += _hump(falls) + _hump(rises)
            begin += down + stays + up + rng.uniform(0.3, 1.5)
        root = np.outer(seated, [-rng.uniform(0.3, 0.42), 0, -rng.uniform(HIGHEST_SEAT, LOWEST_SEAT)])
        pitch = math.radians(rng.uniform(10, 35)) * leans + math.radians(rng.uniform(-12, 5)) * seated
        share = smooth_step(own_time / 0.6) * rng.uniform(0, 1)
        other = self._poses[rng.integers(len(self._poses))]
        positions = self.rig.rest + np.outer(share, np.where(self._of_legs, 0, other - self.rig.rest))
        apart = math.radians(rng.uniform(-3, 18)) * seated
        for joint, angles in planted_legs(self.rig, root, pitch).items():
            positions[:, self.rig.joint_names.index(joint)] += angles
        for joint, sign in (("upperleg01.L_x", 1), ("upperleg01.R_x", -1)):
            positions[:, self.rig.joint_names.index(joint)] += sign * apart
        heading = Rotation.from_euler("z", rng.uniform(0, 2 * math.pi))
        turn = (heading * Rotation.from_euler("y", pitch[:, None])).as_matrix()
        return positions, heading.apply(root), turn

    def _held_pose(self, rng: np.random.Generator, own_time: np.ndarray) -> Moved:
        kind, other = rng.random(), self._poses[rng.integers(len(self._poses))]
        away = 0.0 if kind < AT_REST else rng.uniform(0, 1) ** 3 if kind < AT_REST + NEARLY else 1.0
        pose = self.rig.rest + away * (other - self.rig.rest)
        heading = rng.uniform(0, 2 * math.pi)
        ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
        times = np.arange(len(own_time)) / RATE_HZ
        place, yaw = np.zeros((len(times), 3)), np.zeros(len(times))
        which = rng.integers(4)
        if which == 0:  # to and fro
            rate = 2 * math.pi * _log_uniform(rng, 0.4, 4)
            place = np.outer(rng.uniform(0.8, 4) / rate**2 * np.sin(rate * own_time), ahead)
        elif which == 1:  # goes and stops
            begin = 0.3
            while begin < times[-1]:
                up, hold, down = rng.uniform(0.2, 0.7), rng.uniform(0.3, 1.5), rng.uniform(0.2, 0.5)
                speed = _pulse(times - begin, up, hold, down)
                place = place + np.outer(np.cumsum(rng.uniform(0.5, 1.8) * speed) / RATE_HZ, ahead)
                begin += up + hold + down + rng.uniform(0.8, 2)
        elif which == 2:  # turns
            begin = 0.3
            while begin < times[-1]:
                lasts = rng.uniform(0.4, 1.2)
                yaw = yaw + rng.choice([-1, 1]) * rng.uniform(0.5, 3.14) * smooth_step((times - begin) / lasts)
                begin += lasts + rng.uniform(0.5, 2)
        else:
            place, yaw = _wander(rng, own_time, rng.uniform(0.5, 1.5))
        return np.tile(pose, (len(times), 1)), place, _about_vertical(yaw)

    def _path(self, rng: np.random.Generator, gaps: np.ndarray, *, share: float = 1.0) -> CubicSpline:
        """A smooth path through everyday poses that are `gaps` [s] apart. share: how far each is from the rest pose,
        1 for the whole distance."""
        poses = self._poses[rng.integers(len(self._poses), size=len(gaps) + 1)]
        return _spline(gaps, self.rig.rest + share * (poses - self.rig.rest))


def mirrored_motion(rig: Rig, positions: np.ndarray, place: np.ndarray, turn: np.ndarray) -> Moved:
    """A motion seen in a mirror: positions (T, d), place (T, 3) and turn (T, 3, 3)."""
    return mirrored(rig, positions), place @ MIRROR, MIRROR @ turn @ MIRROR


def _spline(gaps: np.ndarray, poses: np.ndarray) -> CubicSpline:
    return CubicSpline(np.concatenate([[0], np.cumsum(gaps)]), poses)


def _gaps(own_time: np.ndarray, shortest: float) -> int:
    """How many gaps of at least `shortest` [s] are enough: own time runs up to 1.3 times as fast."""
    return max(3, math.ceil(max(own_time[-1], len(own_time) / RATE_HZ) / shortest))


def _own_time(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Time (T,) [s] of the motion in each frame. It runs evenly, or faster or slower with pauses; half of the uneven
    motions begin from standing."""
    times = np.arange(frames) / RATE_HZ
    if rng.random() < STEADY:
        return times
    speed = np.full(frames, rng.uniform(0.6, 1.3))
    begin = rng.uniform(0.5, 2.5)
    while begin < times[-1]:
        ease, pause = rng.uniform(0.15, 0.5), rng.uniform(0.3, 1.5)
        speed *= 1 - _pulse(times - begin, ease, pause, ease)
        begin += 2 * ease + pause + rng.uniform(1.0, 4.0)
    if rng.random() < 0.5:
        speed *= smooth_step(times / 0.4)
    return np.concatenate([[0], np.cumsum(speed)[:-1]]) / RATE_HZ


def _braked(at: np.ndarray, last: float) -> np.ndarray:
    """Times (T,) [s] of a clip that lasts until `last`: where they run past it they come to a stop before."""
    past = np.flatnonzero(at >= last)
    if not len(past):
        return at
    brakes = at[past[0]] - BRAKES
    since = np.clip((at - brakes) / BRAKES, 0, None)
    return np.where(at < brakes, at, brakes + BRAKES / 2 * (1 - np.maximum(1 - since, 0) ** 2))


def _wander(rng: np.random.Generator, times: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Place (T, 3) [m] and yaw (T,) [rad] of a root that moves and turns at random, about as hard at any rate."""
    place, yaw = np.zeros((len(times), 3)), np.zeros(len(times))
    for _ in range(6):
        rate = 2 * math.pi * _log_uniform(rng, 0.3, 3)
        reach = rng.normal(size=3) * [1.2, 1.2, 0.6] * size / rate**2
        place += np.outer(np.sin(rate * times + rng.uniform(0, 2 * math.pi)), reach)
        rate = 2 * math.pi * _log_uniform(rng, 0.25, 1.5)
        yaw += np.sin(rate * times + rng.uniform(0, 2 * math.pi)) * rng.normal() * 4 * size / rate**2
    return place + np.outer(times, [*(0.6 * rng.normal(size=2)), 0.0]), yaw


def _wind(rng: np.random.Generator, frames: int) -> np.ndarray:
    """(T, 3) [m/s] of the wind: in most motions none, else gusts over a breeze from the same side."""
    if rng.random() >= WINDY:
        return np.zeros((frames, 3))
    times, heading = np.arange(frames) / RATE_HZ, rng.uniform(0, 2 * math.pi)
    speed = np.full(frames, rng.uniform(0, 0.5))
    begin = rng.uniform(-1, 1)
    while begin < times[-1]:
        rise, lasts, fall = rng.uniform(0.15, 0.8), rng.uniform(0.2, 1.5), rng.uniform(0.2, 1)
        speed = speed + rng.uniform(0.3, 1) * _pulse(times - begin, rise, lasts, fall)
        begin += rise + lasts + fall + rng.uniform(-0.3, 1.5)
    ahead = [math.cos(heading), math.sin(heading), 0.2 * rng.normal()]
    return np.outer(_log_uniform(rng, LIGHTEST, STRONGEST) * speed, ahead)


def _pulse(since: np.ndarray, rise: float, lasts: float, fall: float) -> np.ndarray:
    """From 0 to 1 and back at times [s] since it begins: it rises, lasts and falls for so many seconds."""
    return smooth_step(since / rise) * (1 - smooth_step((since - rise - lasts) / fall))


def _hump(u: np.ndarray) -> np.ndarray:
    """0 before 0 and after 1, 1 about in the middle, smooth."""
    return smooth_step(u / 0.6) * (1 - smooth_step((u - 0.45) / 0.55))


def _about_vertical(yaw: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("z", yaw[:, None]).as_matrix()


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))
