"""Every joint state of a bag draped, the clouds written to another bag and measured. Needs no ROS.

Messages are read as the ROS node reads them: the same joint maps, the root by its stamps, bad messages counted and
skipped while the last good state stays. The same bag gives the same clouds and figures; only latencies differ.

Dimensions: `T` clouds, `d` degrees of freedom, `n` garment vertices, `C` clouds measured against the body.
"""

from __future__ import annotations

import hashlib
import struct
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from physkin_core import Draper, LimbSeparator
from physkin_core.motion.bag_reader import TRANSFORMS, BagReader, decode
from physkin_core.quality import area_strain, contact_figures, edge_strain, signed_distance
from physkin_core.runtime.bound_garment import plain_skinning
from physkin_ros.joints.joint_naming import load_naming
from physkin_ros.joints.joint_states import JointStateReader, NoPositionsError
from physkin_ros.replay.bags import BagWriter
from physkin_ros.replay.recorded_root import RecordedRoot

__all__ = ["GARMENT_TOPIC", "Replay", "replay"]

GARMENT_TOPIC = "/drape_node/garment"
REASON_LENGTH = 120
REASONS_KEPT = 20
WARM_UP = 20


@dataclass
class Replay:
    """What came of a bag's joint states.

    orientation, sway: as of the `RecordedRoot` that it was replayed with.
    counts: joint_states, draped, not_finite (draped, but for some joints), without_positions, rejected,
    gravity_messages, gravity_rejected (of whatever tells where the root is), root_unknown, names_unknown,
    out_of_range_clouds.
    reasons: why messages were rejected, with how often. out_of_range: clouds with a joint beyond its limits, by joint.
    times_ns: (T,) when the joint state of each cloud was recorded.
    positions: (T, d) [rad] that were draped. down: (T, 3) gravity's unit direction.
    measured: by name as in `--json`, (T,) each: edge_strain_percent, area_strain_percent, latency_us; jitter_mm, mean
    second difference of the vertices over this and the two clouds before, NaN for the first two, jitter_skinning_mm,
    the same of plain skinning; and of C clouds inside_percent, within_3mm_percent, max_depth_mm.
    kept: of each of these C its index among all, and its points (n, 6).
    bag_sha256: of all messages and their times: whether two bags are the same recording. clouds_sha256: of all clouds.
    """

    orientation: str
    sway: float
    counts: Counter = field(default_factory=Counter)
    reasons: Counter = field(default_factory=Counter)
    out_of_range: Counter = field(default_factory=Counter)
    times_ns: list[int] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    down: list[np.ndarray] = field(default_factory=list)
    measured: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    kept: dict[int, np.ndarray] = field(default_factory=dict)
    bag_sha256: str = ""
    clouds_sha256: str = ""

    def reject(self, what: str, reason: str) -> None:
        """Count a message that was not used, and why; of the reasons, the first `REASONS_KEPT` are kept apart."""
        self.counts[what] += 1
        reason = reason[:REASON_LENGTH]
        self.reasons[reason if reason in self.reasons or len(self.reasons) < REASONS_KEPT else "other"] += 1


def replay(
    draper: Draper,
    bag: BagReader,
    writer: BagWriter | None = None,
    *,
    joint_map: str | Path | None = None,
    joint_prefix: str = "",
    separator: LimbSeparator | None = None,
    root: RecordedRoot | None = None,
    contact_every: int = 0,
    frame_id: str = "base_link",
) -> Replay:
    """Drape every joint state of `bag`.

    writer: where the clouds go, and the bag's transforms, if it is read with them, so that clouds hang in the world.
    joint_map: a file, or a preset. joint_prefix: what joint names begin with besides. separator: what poses go through
    before they are draped. root: how it moves by the messages that the bag is read with; default upright until the bag
    says otherwise. contact_every: every how many joint states a cloud is measured against the body, 0 for never.
    Raises JointMapError, and BagError when the bag cannot be read on.
    """
    root = root or RecordedRoot()
    rig, found, unknown = draper.model.rig, Replay(root.orientation, root.sway), set()
    reader = JointStateReader(
        rig.joint_names,
        rig.rest,
        naming=load_naming(joint_map, rig),
        prefix=joint_prefix,
        on_unknown=unknown.update,
        on_not_finite=lambda names: found.counts.update(["not_finite"]),
    )
    recent = _Recent(draper, found)
    pose, points = reader.positions.astype(np.float32), np.zeros((draper.vertex_count, 6), dtype=np.float32)
    draped = pose.copy()
    step = draper.bind_frame(draped, root.rows, points)
    for _ in range(WARM_UP):  # the first evaluations pay for cold caches, which is not what a latency means here
        step()
    messages, clouds = hashlib.sha256(), hashlib.sha256()
    for message in bag:
        if message.kind == "transforms":
            if writer is not None:
                writer.write_bytes(message.topic, TRANSFORMS, message.data, message.time_ns)
            if root.orientation != "tf":
                continue
        messages.update(struct.pack("<?qQ", message.kind != "joint_state", message.time_ns, len(message.data)))
        messages.update(message.data)
        if message.kind != "joint_state":
            found.counts["gravity_messages"] += 1
            try:
                root.take(message)
            except ValueError as error:
                found.reject("gravity_rejected", str(error))
            continue
        index = found.counts["joint_states"]
        found.counts["joint_states"] += 1
        try:
            state = decode(message)
            pose[:] = reader.read(state.name, state.position)
            root.begin_frame(state, message.time_ns)
            started = perf_counter_ns()
            if separator is None:
                draped[:] = pose
            else:
                separator.separate(pose, out=draped)
            step()
            latency_us = (perf_counter_ns() - started) / 1e3
        except NoPositionsError:
            found.counts["without_positions"] += 1
            continue
        except ValueError as error:
            found.reject("rejected", str(error))
            continue
        reader.positions = pose
        found.counts["root_unknown"] += bool(root.fault)
        found.counts["draped"] += 1
        found.times_ns.append(message.time_ns)
        found.positions.append(draped.copy())
        found.down.append(root.down)
        found.measured["latency_us"].append(latency_us)
        recent.measure(points, contact=contact_every > 0 and index % contact_every == 0)
        clouds.update(points.tobytes())
        if writer is not None:
            writer.write_cloud(GARMENT_TOPIC, points, state.header.stamp, frame_id, message.time_ns)
    found.counts["names_unknown"] = len(unknown)
    found.bag_sha256, found.clouds_sha256 = messages.hexdigest(), clouds.hexdigest()
    return found


class _Recent:
    """The last three clouds, which are measured as they come."""

    def __init__(self, draper: Draper, found: Replay) -> None:
        self._draper, self._found = draper, found
        self._kept: dict[str, list[np.ndarray]] = {"jitter_mm": [], "jitter_skinning_mm": []}

    def measure(self, points: np.ndarray, *, contact: bool) -> None:
        """Measure the cloud (n, 6) of the positions that `found` holds last. contact: against the body, too."""
        draper, found, measured = self._draper, self._found, self._found.measured
        rig, positions = draper.model.rig, found.positions[-1]
        vertices, bones = points[:, :3].astype(np.float64), draper.bone_transforms(positions)
        measured["edge_strain_percent"].append(float(edge_strain(draper.rest_garment, vertices)))
        measured["area_strain_percent"].append(float(area_strain(draper.rest_garment, vertices)))
        for name, latest in (("jitter_mm", vertices), ("jitter_skinning_mm", plain_skinning(draper.bound, bones))):
            kept = self._kept[name] = [*self._kept[name][-2:], latest]
            # what `quality.jitter` averages, of these three frames
            second = kept[0] - 2 * kept[1] + kept[2] if len(kept) == 3 else np.full((1, 3), np.nan)
            measured[name].append(1000 * float(np.linalg.norm(second, axis=-1).mean()))
        beyond = (positions < rig.lower - 1e-3) | (positions > rig.upper + 1e-3)
        found.counts["out_of_range_clouds"] += bool(beyond.any())
        found.out_of_range.update(rig.joint_names[joint] for joint in np.flatnonzero(beyond))
        if contact:
            body = draper.avatar
            distances = signed_distance(vertices, body.posed_vertices(bones), body.faces)
            found.kept[len(found.times_ns) - 1] = points.copy()
            for name, value in contact_figures(distances).items():
                measured[name].append(value)
