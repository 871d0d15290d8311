"""A trial: the drape node between a player and a listener, each in a process of its own, and what they wrote down.

Dimensions: `K` avatars, `T` joint states sent to each, `R` clouds received, `k` poses kept, `n` vertices given of
all garments of an avatar.
Times are CLOCK_MONOTONIC, which a machine's processes share [ns].
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from physkin_ros.tools.children import Children
from physkin_ros.tools.listener import READY, garment_names

__all__ = ["Records", "finish", "start_node", "start_playing"]

START_SECONDS = 100.0
END_SECONDS = 60.0


@dataclass(frozen=True)
class Records:
    """What player and listener wrote down.

    stamps: (T, K) of the joint states, taken when sent. cpu: (2,) [s] processor time of the node's first thread, and of
    all, after the warm-up. load: average of a minute. avatars, garments, received_stamps, received: (R,) whose cloud,
    of which garment, its stamp and when it came. not_finite: clouds with values that are not. kept_stamps: (k,); kept:
    (k, n, 6), root frame, one garment's points after the other's.
    reports: the node's diagnostics, one a second and garment, values by name as text.
    """

    stamps: np.ndarray
    cpu: np.ndarray
    load: float
    avatars: np.ndarray
    garments: np.ndarray
    received_stamps: np.ndarray
    received: np.ndarray
    not_finite: int
    kept_stamps: np.ndarray
    kept: np.ndarray
    reports: list[dict[str, str]]

    def answers(self, garment: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """For each joint state how many clouds of a garment with its stamp came, and how late the first did [ms],
        (T, K) each; NaN: none came."""
        counts, delays = np.zeros(self.stamps.shape, dtype=int), np.full(self.stamps.shape, np.nan)
        for k, stamps in enumerate(self.stamps.T):
            its = (self.avatars == k) & (self.garments == garment)
            came, first, times = np.unique(self.received_stamps[its], return_index=True, return_counts=True)
            _, sent, found = np.intersect1d(stamps, came, return_indices=True)
            counts[sent, k] = times[found]
            delays[sent, k] = (self.received[its][first[found]] - came[found]) / 1e6
        return counts, delays

    def evaluations(self) -> np.ndarray:
        """Median and 99th percentile [µs] of the evaluations in each report that has any, (reports, 2)."""
        keys = ("evaluation p50 [us]", "evaluation p99 [us]")
        rows = [[float(report[key]) for key in keys] for report in self.reports if report[keys[0]] != "none"]
        return np.array(rows).reshape(-1, 2)


def start_node(
    children: Children,
    folder: Path,
    avatars: int,
    *,
    avatar: Mapping,
    garment: Mapping,
    outfit: Sequence[Mapping] = ({},),
    queue: int | None,
    **node,
) -> None:
    """Start a drape node with avatars a0, a1, ... of these parameters, each with one garment, g, or several. None: the
    node's default.

    outfit: parameters of the garments of each avatar, from the skin outwards, beside those of `garment`.
    queue: joint states and directions of gravity that may wait; None: the node's own. node: its other parameters.
    """
    parameters = dict(node)
    for k in range(avatars):
        parameters |= {f"avatars.a{k}.{name}": value for name, value in avatar.items()}
        for name, own in zip(garment_names(len(outfit)), outfit):
            chosen = {key: value for key, value in {**garment, **own}.items() if value is not None}
            parameters |= {f"avatars.a{k}.garments.{name}.{key}": value for key, value in chosen.items()}
        for topic in ("joint_states", "gravity") if queue is not None else ():
            parameters[f"qos_overrides./a{k}/{topic}.subscription.depth"] = queue
    config = folder / "avatars.yaml"
    config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": parameters}}, sort_keys=False))
    children.start("node", "physkin_core.cli", "node", "--config", config)


def start_playing(
    children: Children,
    folder: Path,
    avatars: int,
    motion: str,
    rate_hz: float,
    seconds: float,
    *more,
    garments: int = 1,
    keep_every: int = 0,
) -> None:
    """Wait until every garment answers, then start playing `motion`. more: options of the player. garments, keep_every:
    of the listener."""
    sent = folder / "sent.npz"
    chosen = ("--garments", garments, "--keep-every", keep_every)
    listening = (folder / "received.npz", avatars, motion, sent, *chosen)
    children.start("listener", "physkin_ros.tools.listener", *listening)
    children.wait(lambda: READY in children.log("listener").splitlines(), "the first clouds", START_SECONDS)
    children.start("player", "physkin_ros.tools.player", sent, avatars, motion, rate_hz, seconds, *more)


def finish(children: Children, folder: Path, seconds: float) -> Records:
    """Wait for player and listener, of whom the player takes about `seconds`."""
    children.wait(lambda: children.finished("player"), "the motion", 4 * seconds + START_SECONDS)
    children.wait(lambda: children.finished("listener"), "the last cloud", END_SECONDS)
    with np.load(folder / "sent.npz") as player, np.load(folder / "received.npz") as listener:
        found = {**player, **listener}
    return Records(**found | {"reports": json.loads(str(found["reports"]))})
