"""What the demo found: which clouds came, how late, and how they look."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Avatar, Draper, GarmentModel, Motion
from physkin_core.picture import CLOTH_COLOUR, Mesh, contact_sheet, render, save_png
from physkin_ros.tools.machine import machine_line, versions_line
from physkin_ros.tools.trial import Records

__all__ = ["complete", "draw", "largest_error", "table"]

COLUMNS = 4
PICTURE_SIZE = (420, 440)


def complete(records: Records) -> bool:
    """Whether every joint state came back as one cloud of finite values, and nothing else did."""
    counts, _ = records.answers()
    return bool((counts == 1).all()) and len(records.received) == counts.size and not records.not_finite


def largest_error(records: Records, draper: Draper, motion: Motion) -> float:
    """Largest distance [m] of a point of the kept clouds from where the core puts it; 0 if there are none."""
    positions, largest = motion.positions_for(draper.model.rig), 0.0
    for frame, cloud in _kept_frames(records):
        expected = draper.drape(positions[frame], motion.gravity[frame])
        distances = np.linalg.norm(cloud[:, :3].astype(np.float64) - expected[:, :3], axis=1)
        largest = max(largest, float(np.nan_to_num(distances, nan=np.inf).max()))
    return largest


def table(records: Records, model: GarmentModel, error: float) -> str:
    """The figures, a line each. error: of the kept clouds [m], from `largest_error`."""
    counts, delays = records.answers()
    delays, evaluations = delays[np.isfinite(delays)], records.evaluations()
    latest = records.reports[-1] if records.reports else {}
    end_to_end, evaluator = "none received", "not reported"
    if len(delays):
        end_to_end = "p50 {:.2f}, p99 {:.2f}".format(*np.percentile(delays, (50, 99)))
    if len(evaluations):  # the percentiles of all evaluations are not known here
        median, tail = np.median(evaluations[:, 0]), evaluations[:, 1].max()
        evaluator = f"median of each second's p50 {median:.1f}, worst of each second's p99 {tail:.1f}"
    rows = {
        "garment": f"{model.name}, {len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes",
        "joint states sent": f"{counts.size}",
        "clouds received": f"{len(records.received)}",
        "clouds lost": f"{(counts != 1).sum()}",
        "clouds with values not finite": f"{records.not_finite}",
        "largest error [mm]": f"{1e3 * error:.3f} in {len(_kept_frames(records))} clouds compared with the core's",
        "evaluator [µs]": evaluator,
        "end to end [ms]": end_to_end,
        "backend": f"{latest.get('backend', '?')}, instruction set {latest.get('instruction set', '?')}",
        "machine": machine_line(),
        "versions": versions_line(),
    }
    width = max(map(len, rows))
    return "\n".join(["", *(f"  {name:<{width}}  {value}" for name, value in rows.items()), ""])


def draw(path: Path, records: Records, model: GarmentModel, avatar: Avatar, motion: Motion) -> None:
    """Write a contact sheet of the kept clouds to `path` (PNG): the garment as it was received, the body in its pose.

    Raises PictureError when the extra `[view]` is not installed.
    """
    positions, rotations = motion.positions_for(model.rig), Rotation.from_quat(motion.root_orientation)
    frames, captions = [], []
    for frame, cloud in _kept_frames(records):
        body = avatar.posed_vertices(model.rig.bone_transforms(positions[frame], heads=avatar.bone_heads))
        frames.append([rotations[frame].apply(points) for points in (body, cloud[:, :3])])
        captions.append(f"{frame / motion.rate_hz:.2f} s")
    drawn = np.concatenate([points for frame in frames for points in frame])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = []
    for body, cloth in frames:
        meshes = [Mesh(body, avatar.faces), Mesh(cloth, model.garment.faces, CLOTH_COLOUR)]
        pictures.append(render(meshes, bounds=bounds, size=PICTURE_SIZE))
    save_png(path, contact_sheet(pictures, columns=COLUMNS, captions=captions))


def _kept_frames(records: Records) -> list[tuple[int, np.ndarray]]:
    """The kept clouds (n, 6) that answer a joint state of the first avatar, each with the index of its joint state."""
    frames = {stamp: index for index, stamp in enumerate(records.stamps[:, 0].tolist())}
    return [(frames[s], cloud) for s, cloud in zip(records.kept_stamps.tolist(), records.kept) if s in frames]
