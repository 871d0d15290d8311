"""The joint states of a bag as a motion clip.

Dimensions: `T` frames, `d` joints. Times in ns.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from physkin_core.file_reading import reading
from physkin_core.motion.bag_reader import BagError, BagReader, Recorded, decode
from physkin_core.motion.motion import MOST_FRAMES, Motion, upright_orientation

__all__ = ["load_bag_motion"]

log = logging.getLogger(__name__)

AXES = ("x", "y", "z")
ROOT = (*AXES, "turn x", "turn y", "turn z", "turn w")
LARGEST_DISAGREEMENT = 5.0  # [degrees] of odometry and gravity about what is down: else it is of another body
MOST_FRAMES_A_STATE = 100
"""A clip has at most this many frames for each joint state: more would be a pause of hours, or stamps of two clocks."""
LARGEST_CLIP = 1 << 29  # [bytes] of the joint positions


@dataclass(frozen=True)
class _Sample:
    """A message: when it was stamped (0: never) and recorded [ns], and its values (k,) by name."""

    stamp_ns: int
    time_ns: int
    names: tuple[str, ...]
    values: np.ndarray


def load_bag_motion(path: str | Path) -> Motion:
    """Read a bag as a clip at the rate of the joint states' median step, with joints linear in time between messages.

    Times are the stamps, or those of recording if a message has no stamp. A joint that a message does not name is
    interpolated from messages that do. The root is where odometry (`/odom`) says, if that agrees with gravity; else it
    stays in one place, tilted as gravity says, or upright without it.
    Positions that are not finite, and messages that are damaged, are left out with a warning; joint states that have no
    positions, without one.
    Raises BagError for a bag that cannot be read, or has fewer than two joint states at different times.
    """
    kept: dict[str, list[_Sample]] = {"joint_state": [], "gravity": [], "odometry": []}
    left_out = 0
    joint_names: dict[tuple[str, ...], tuple[str, ...]] = {}  # equal ones are kept once
    with reading(f"bag {path}", BagError), BagReader(path, root=["odometry"]) as bag:
        for message in bag:
            try:
                sample = _sample(message)
            except ValueError:
                left_out += 1
            else:
                if len(sample.values):
                    kept[message.kind].append(replace(sample, names=joint_names.setdefault(sample.names, sample.names)))
    if left_out:
        log.warning("bag %s: %d messages that cannot be used were left out", path, left_out)
    if gaps := sum(not np.isfinite(sample.values).all() for sample in kept["joint_state"]):
        log.warning("bag %s: positions of %d joint states are not finite; these are interpolated", path, gaps)
    if not all(sample.stamp_ns for samples in kept.values() for sample in samples):
        kept = {kind: [replace(each, stamp_ns=each.time_ns) for each in samples] for kind, samples in kept.items()}
    states, downs, roots = kept.values()
    times = np.unique([sample.stamp_ns for sample in states])
    if len(times) < 2:
        raise BagError(
            f"bag {path}: a clip needs joint states with positions at two times at least, {bag.topic} has {len(times)}"
        )
    step, length = float(np.median(np.diff(times))), float(times[-1] - times[0])
    if length / step > min(MOST_FRAMES_A_STATE * len(times), MOST_FRAMES):
        raise BagError(
            f"bag {path}: {len(times)} joint states {step / 1e6:.3g} ms apart span {length / 1e9:.3g} s; allowed are "
            f"{MOST_FRAMES_A_STATE} frames for each of them, and {MOST_FRAMES} in all"
        )
    frames = times[0] + np.linspace(0.0, length, 1 + round(length / step))
    width = len({name for sample in states for name in sample.names})
    if (size := 8 * len(frames) * width) > LARGEST_CLIP:
        raise BagError(
            f"bag {path}: {len(frames)} frames of {width} joints take {size} bytes, allowed are {LARGEST_CLIP}"
        )
    positions = _tracks(states, frames)
    down = _tracks(downs, frames)
    gravity = np.stack([down[axis] for axis in AXES], axis=1) if downs else np.tile([0.0, 0.0, -1.0], (len(frames), 1))
    joints = np.stack(list(positions.values()), axis=1)
    still = upright_orientation(gravity), np.zeros((len(frames), 3))
    root = _root(roots, frames) if roots else still
    clip = Motion(tuple(positions), joints, *root, 1e9 * (len(frames) - 1) / length, Path(path).stem)
    apart = np.degrees(np.median(np.arccos(np.clip((clip.gravity * gravity).sum(axis=1), -1, 1)))) if downs else 0.0
    if apart > LARGEST_DISAGREEMENT:
        log.warning("bag %s: odometry and gravity differ by %.0f degrees; odometry is left out", path, apart)
        clip = replace(clip, root_orientation=still[0], root_position=still[1])
    return clip


def _root(samples: Sequence[_Sample], frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orientation (T, 4) x, y, z, w and position (T, 3) [m] of the root."""
    samples = sorted(samples, key=lambda sample: sample.stamp_ns)
    turns = np.array([sample.values[3:] for sample in samples])
    flips = np.cumprod([1.0, *np.where((turns[1:] * turns[:-1]).sum(axis=1) < 0, -1.0, 1.0)])
    turned = [replace(each, values=each.values * [1, 1, 1, *[flip] * 4]) for each, flip in zip(samples, flips)]
    values = np.stack(list(_tracks(turned, frames).values()), axis=1)
    return values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True), values[:, :3]


def _sample(recorded: Recorded) -> _Sample:
    """Raises ValueError for a message that cannot be used."""
    message = decode(recorded)
    stamp = message.header.stamp
    if recorded.kind == "odometry":
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        names, values = ROOT, np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
        usable = np.isfinite(values).all() and abs(np.linalg.norm(values[3:]) - 1) < 0.01
    elif recorded.kind == "gravity":
        names, values = AXES, np.array([getattr(message.vector, axis) for axis in AXES])
        length = np.linalg.norm(values)
        usable = 1e-9 < length < np.inf
        values /= length if usable else 1.0
    else:
        names, values = tuple(message.name), np.asarray(message.position, dtype=np.float64)
        usable = len(names) > 0 and (len(names) == len(values) and np.isfinite(values).any() or not len(values))
    if not usable:
        raise ValueError(f"values {values.tolist()} of {', '.join(names)}")
    return _Sample(stamp.sec * 10**9 + stamp.nanosec, recorded.time_ns, names, values)


def _tracks(samples: Sequence[_Sample], frames: np.ndarray) -> dict[str, np.ndarray]:
    """Values (T,) at the times `frames` (T,) by name."""
    alike: dict[tuple[str, ...], list[_Sample]] = defaultdict(list)
    for sample in samples:
        alike[sample.names].append(sample)
    known: dict[str, list[np.ndarray]] = defaultdict(list)
    for names, group in alike.items():
        times = np.array([sample.stamp_ns for sample in group], dtype=np.float64)
        for name, values in zip(names, np.stack([sample.values for sample in group], axis=1), strict=True):
            known[name].append(np.stack([times, values]))
    tracks = {}
    for name, parts in known.items():
        times, values = np.concatenate(parts, axis=1)
        order = np.argsort(times, kind="stable")
        order = order[np.isfinite(values[order])]
        if len(order):
            tracks[name] = np.interp(frames, times[order], values[order])
    return tracks
