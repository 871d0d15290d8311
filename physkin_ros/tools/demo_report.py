"""What the demo found: which clouds came, how late, and how they look.

Dimensions: `T` joint states sent, `R` clouds received, `k` kept clouds, `n` garment vertices. Times in ns.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Avatar, Draper, GarmentModel, Motion
from physkin_core.picture import CLOTH_COLOUR, Mesh, contact_sheet, render, save_png
from physkin_ros.joints.joint_states import JointStateReader
from physkin_ros.tools.machine import machine_line, versions_line

__all__ = ["DemoReport", "draw"]

COLUMNS = 4
PICTURE_SIZE = (420, 440)


@dataclass(frozen=True)
class DemoReport:
    """The player's and the listener's records.

    stamps, sent: (T,) stamp and sending time. received_stamps, received: (R,) stamp and receipt time, on the clock of
    `sent`. finite: (R,) whether all values of a cloud were. kept_stamps: (k,); kept: (k, n, 6) clouds, root frame.
    reports: the node's diagnostics, one a second, values by name as text.
    """

    stamps: np.ndarray
    sent: np.ndarray
    received_stamps: np.ndarray
    received: np.ndarray
    finite: np.ndarray
    kept_stamps: np.ndarray
    kept: np.ndarray
    reports: list[dict[str, str]]

    @classmethod
    def from_files(cls, sent: Path, received: Path) -> DemoReport:
        """Read what the player and the listener wrote."""
        with np.load(sent) as player, np.load(received) as listener:
            return cls(
                **player,
                received_stamps=listener["stamps"],
                **{name: listener[name] for name in ("received", "finite", "kept_stamps", "kept")},
                reports=json.loads(str(listener["reports"])),
            )

    @property
    def lost(self) -> int:
        """Joint states without exactly one cloud of their stamp."""
        stamps, counts = np.unique(self.received_stamps, return_counts=True)
        return int(len(self.stamps) - np.isin(self.stamps, stamps[counts == 1]).sum())

    @property
    def complete(self) -> bool:
        """Whether every joint state came back as a cloud of finite values, and nothing else did."""
        return self.lost == 0 and len(self.received) == len(self.stamps) and bool(self.finite.all())

    def latencies_ms(self) -> np.ndarray:
        """Time from sending a joint state to receiving its cloud [ms], in order of receipt."""
        order = np.argsort(self.stamps)
        position = np.searchsorted(self.stamps[order], self.received_stamps).clip(max=len(order) - 1)
        matched = self.stamps[order][position] == self.received_stamps
        return (self.received - self.sent[order][position])[matched] / 1e6

    def kept_frames(self) -> list[tuple[int, np.ndarray]]:
        """The kept clouds (n, 6) that answer a joint state, each with the index of its joint state."""
        frames = {int(stamp): index for index, stamp in enumerate(self.stamps)}
        return [(frames[s], cloud) for s, cloud in zip(self.kept_stamps.tolist(), self.kept) if s in frames]

    def largest_error(self, draper: Draper, motion: Motion) -> float:
        """Largest distance [m] of a point of the kept clouds from where the core puts it; 0 if there are none."""
        reader = JointStateReader(draper.joint_names, draper.model.rig.rest)
        largest = 0.0
        for frame, cloud in self.kept_frames():
            positions = reader.read(motion.joint_names, motion.positions[frame])
            expected = draper.drape(positions, motion.gravity[frame])
            distances = np.linalg.norm(cloud[:, :3].astype(np.float64) - expected[:, :3], axis=1)
            largest = max(largest, float(np.nan_to_num(distances, nan=np.inf).max()))
        return largest

    def table(self, model: GarmentModel, error: float) -> str:
        """The figures, a line each. error: of the kept clouds [m], from `largest_error`."""
        evaluations = [report for report in self.reports if report["evaluation p50 [us]"] != "none"]
        medians = [float(report["evaluation p50 [us]"]) for report in evaluations]
        tails = [float(report["evaluation p99 [us]"]) for report in evaluations]
        latencies = self.latencies_ms()
        latest = self.reports[-1] if self.reports else {}
        rows = {
            "garment": f"{model.name}, {len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes",
            "joint states sent": f"{len(self.stamps)}",
            "clouds received": f"{len(self.received)}",
            "clouds lost": f"{self.lost}",
            "clouds with values not finite": f"{int((~self.finite).sum())}",
            "largest error [mm]": f"{1e3 * error:.3f} in {len(self.kept_frames())} clouds compared with the core's",
            "evaluator [us]": _by_second(medians, tails),
            "end to end [ms]": _spread(*np.percentile(latencies, (50, 99)), 2) if len(latencies) else "none received",
            "backend": f"{latest.get('backend', '?')}, instruction set {latest.get('instruction set', '?')}",
            "machine": machine_line(),
            "versions": versions_line(),
        }
        width = max(map(len, rows))
        return "\n".join(["", *(f"  {name:<{width}}  {value}" for name, value in rows.items()), ""])


def draw(path: Path, report: DemoReport, model: GarmentModel, avatar: Avatar, motion: Motion) -> None:
    """Write a contact sheet of the kept clouds to `path` (PNG): the garment as it was received, the body in its pose.

    Raises PictureError when the extra `[view]` is not installed.
    """
    reader = JointStateReader(model.rig.joint_names, model.rig.rest)
    rotations = Rotation.from_quat(motion.root_orientation)
    frames, captions = [], []
    for frame, cloud in report.kept_frames():
        positions = reader.read(motion.joint_names, motion.positions[frame])
        body = avatar.posed_vertices(model.rig.bone_transforms(positions, heads=avatar.bone_heads))
        frames.append([rotations[frame].apply(points) for points in (body, cloud[:, :3])])
        captions.append(f"{frame / motion.rate_hz:.2f} s")
    drawn = np.concatenate([points for frame in frames for points in frame])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = []
    for body, cloth in frames:
        meshes = [Mesh(body, avatar.faces), Mesh(cloth, model.garment.faces, CLOTH_COLOUR)]
        pictures.append(render(meshes, bounds=bounds, size=PICTURE_SIZE))
    save_png(path, contact_sheet(pictures, columns=COLUMNS, captions=captions))


def _by_second(medians: list[float], tails: list[float]) -> str:
    """What the node's reports, one a second, say together; the percentiles of all evaluations are not known here."""
    if not medians:
        return "not reported"
    return f"median of each second's p50 {np.median(medians):.1f}, worst of each second's p99 {max(tails):.1f}"


def _spread(median: float, tail: float, decimals: int) -> str:
    return f"p50 {median:.{decimals}f}, p99 {tail:.{decimals}f}"
