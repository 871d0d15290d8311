"""What the demo found: which clouds came, how late, and how they look."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Motion, Outfit
from physkin_core.machine import machine_line, versions_line
from physkin_core.outfit.layer_order import TURNS
from physkin_core.picture import contact_sheet, render, save_png
from physkin_core.render.filming import dressed_meshes
from physkin_ros.tools.trial import Records

__all__ = ["complete", "draw", "largest_error", "table"]

COLUMNS = 4
PICTURE_SIZE = (420, 440)
SWINGS_ON = 1.0
"""[s] in which cloth that sways still moves by what was before the first frame."""


def complete(records: Records, garments: int = 1) -> bool:
    """Whether every joint state came back as one cloud a garment, of finite values, and nothing else did."""
    counts = np.array([records.answers(garment)[0] for garment in range(garments)])
    return bool((counts == 1).all()) and len(records.received) == counts.size and not records.not_finite


def largest_error(records: Records, outfit: Outfit, motion: Motion) -> float:
    """Largest distance [m] of a point of the kept clouds from where the core puts it; 0 if there are none.

    Cloth keeps its pace from frame to frame, and layers their order, where each vertex has its turn in one of `TURNS`.
    How often the listener had to ask for a first cloud, upright in the first pose, nobody has counted: the core starts
    in every turn, and what comes closest counts.
    """
    kept = _compared(records, outfit, motion)
    if not kept:
        return 0.0
    positions = motion.positions_for(outfit.rig)
    largest = []
    for asked in range(1, 1 + (TURNS if outfit.orders else 1)):
        core, distance = outfit.twin(), 0.0
        for _ in range(asked):
            core.drape(positions[0])
        for frame in range(max(kept) + 1):
            time = 1e-9 * int(records.stamps[frame, 0])
            expected = np.concatenate(core.drape(positions[frame], motion.gravity[frame], time=time))
            if frame in kept:
                off = np.linalg.norm(kept[frame][:, :3].astype(np.float64) - expected[:, :3], axis=1)
                distance = max(distance, float(np.nan_to_num(off, nan=np.inf).max()))
        largest.append(distance)
    return min(largest)


def table(records: Records, outfit: Outfit, motion: Motion, error: float) -> str:
    """The figures, a line each. error: of the kept clouds [m], from `largest_error`."""
    poses = len(_compared(records, outfit, motion))
    answers = [records.answers(garment) for garment in range(len(outfit.layers))]
    counts = np.array([each for each, _ in answers])
    delays = np.max([each for _, each in answers], axis=0)  # of the last garment's cloud
    delays, evaluations = delays[np.isfinite(delays)], records.evaluations()
    latest = records.reports[-1] if records.reports else {}
    end_to_end, evaluator = "none received", "not reported"
    if len(delays):
        end_to_end = "p50 {:.2f}, p99 {:.2f}".format(*np.percentile(delays, (50, 99)))
    if len(evaluations):  # the percentiles of all evaluations are not known here
        median, tail = np.median(evaluations[:, 0]), evaluations[:, 1].max()
        evaluator = f"median of each second's p50 {median:.1f}, worst of each second's p99 {tail:.1f}"
    given = [
        f"{layer.name}, {layer.vertex_count} of {len(layer.hidden)} vertices, {len(layer.bound.node_rest)} garment "
        "nodes"
        for layer in outfit.layers
    ]
    rows = {
        **{f"garment {k}" if len(given) > 1 else "garment": text for k, text in enumerate(given, 1)},
        "joint states sent": f"{counts[0].size}",
        "clouds received": f"{len(records.received)}",
        "clouds lost": f"{(counts != 1).sum()}",
        "clouds with values not finite": f"{records.not_finite}",
        "largest error [mm]": f"{1e3 * error:.3f} in {poses} poses compared with the core's",
        "evaluator [µs]": evaluator,
        "end to end [ms]": end_to_end,
        "instruction set": latest.get("instruction set", "?"),
        "machine": machine_line(),
        "versions": versions_line("physkin", "ros-jazzy-rclpy", "numpy"),
    }
    width = max(map(len, rows))
    return "\n".join(["", *(f"  {name:<{width}}  {value}" for name, value in rows.items()), ""])


def draw(path: Path, records: Records, outfit: Outfit, motion: Motion) -> None:
    """Write a contact sheet of the kept clouds to `path` (PNG): garments as they were received, the body in its pose.

    Raises PictureError when the extra `[view]` is not installed.
    """
    positions, rotations = motion.positions_for(outfit.rig), Rotation.from_quat(motion.root_orientation)
    frames, captions = [], []
    for frame, cloud in _kept_frames(records):
        body = outfit.posed_body(positions[frame])
        cloth = np.split(cloud[:, :3], np.cumsum([layer.vertex_count for layer in outfit.layers])[:-1])
        frames.append([rotations[frame].apply(points) for points in (body, *cloth)])
        captions.append(f"{frame / motion.rate_hz:.2f} s")
    drawn = np.concatenate([points for frame in frames for points in frame])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = []
    for body, *cloth in frames:
        pictures.append(render(dressed_meshes(outfit, body, cloth), bounds=bounds, size=PICTURE_SIZE))
    save_png(path, contact_sheet(pictures, columns=COLUMNS, captions=captions))


def _compared(records: Records, outfit: Outfit, motion: Motion) -> dict[int, np.ndarray]:
    """Of the kept clouds those that are compared, by frame. Cloth that sways swings on from the pose in which a first
    cloud was asked for, and when that was nobody knows: its first clouds are left out, if there are others."""
    kept = dict(_kept_frames(records))
    if all(layer.model.sway is None for layer in outfit.layers):
        return kept
    return {frame: cloud for frame, cloud in kept.items() if frame >= SWINGS_ON * motion.rate_hz} or kept


def _kept_frames(records: Records) -> list[tuple[int, np.ndarray]]:
    """Clouds (n, 6) of all garments that answer a joint state of the first avatar, each with the index of that."""
    frames = {stamp: index for index, stamp in enumerate(records.stamps[:, 0].tolist())}
    return [(frames[s], cloud) for s, cloud in zip(records.kept_stamps.tolist(), records.kept) if s in frames]
