"""`physkin replay`: drape every joint state of a bag, write the clouds to another bag, and measure them. Needs no ROS.

Messages are read as the ROS node reads them: the same joint maps, the latest good gravity, bad messages counted and
skipped while the last good state stays. The same bag gives the same clouds and figures; only latencies differ.

Dimensions: `T` clouds, `d` degrees of freedom, `n` garment vertices, `C` clouds measured against the body.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections import Counter
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from physkin_core import BACKENDS, BUNDLED_AVATAR, NORMALS, UPRIGHT_GRAVITY, Draper, load_avatar, load_garment_model
from physkin_core.model.skinning import plain_skinning
from physkin_core.quality import CLOSE, area_strain, edge_strain, signed_distance
from physkin_core.runtime.native_evaluator import PRECISIONS
from physkin_ros.joints.joint_naming import PRESETS, load_naming
from physkin_ros.joints.joint_states import JointStateReader
from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.replay.bags import STORAGES, BagError, BagReader, BagWriter, decode
from physkin_ros.replay.figures import describe, load_baseline, regressions, summary
from physkin_ros.replay.report import thumbnails, write_report

__all__ = ["Replay", "main", "replay"]

GARMENT_TOPIC = "/drape_node/garment"
CONTACT_CLOUDS = 24  # measured against the body, unless --contact-every says otherwise
REASON_LENGTH = 120
REASONS_KEPT = 20
WARM_UP = 20


@dataclass
class Replay:
    """What came of a bag's joint states, a row for each that was draped.

    counts: joint_states, draped, rejected, gravity_messages, gravity_rejected. reasons: why, with how often.
    times_ns, latency_ns: (T,) time of recording and evaluation time. frames: (T,) which joint state of the bag.
    edge_strain, area_strain: (T,) [%]. bend, skinning_bend: (T,) mean second difference of the vertices over this and
    the two clouds before [m], NaN for the first two, and the same of plain skinning.
    contact: (C, 4) row of the cloud, vertices inside the body [%], nearer than 3 mm [%], deepest penetration [mm].
    positions, gravity: (T, d) [rad] and (T, 3), what was draped. out_of_range: clouds with a joint beyond its limits,
    by joint. clouds_sha256: of all clouds, in order.
    """

    counts: Counter = field(default_factory=Counter)
    reasons: Counter = field(default_factory=Counter)
    times_ns: list[int] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    latency_ns: list[int] = field(default_factory=list)
    edge_strain: list[float] = field(default_factory=list)
    area_strain: list[float] = field(default_factory=list)
    bend: list[float] = field(default_factory=list)
    skinning_bend: list[float] = field(default_factory=list)
    contact: list[tuple[int, float, float, float]] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    gravity: list[np.ndarray] = field(default_factory=list)
    out_of_range: Counter = field(default_factory=Counter)
    out_of_range_clouds: int = 0
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
    gravity: np.ndarray = UPRIGHT_GRAVITY,
    contact_every: int = 0,
    topic: str = GARMENT_TOPIC,
    frame_id: str = "base_link",
) -> Replay:
    """Drape every joint state of `bag`.

    writer: where the clouds go. joint_map: a file, or a preset. gravity: (3,) direction in the root frame until the
    bag gives one. contact_every: every how many joint states a cloud is measured against the body, 0 for never.
    Raises JointMapError, and BagError when the bag cannot be read on.
    """
    rig, found = draper.model.rig, Replay()
    unknown: list[list[str]] = []
    reader = JointStateReader(rig.joint_names, rig.rest, naming=load_naming(joint_map, rig), on_unknown=unknown.append)
    measure = _Measurements(draper, found)
    points = np.zeros((draper.vertex_count, 6), dtype=np.float32)
    for _ in range(WARM_UP):  # the first evaluations pay for cold caches, which is not what a latency means here
        draper.drape(reader.positions, gravity, out=points)
    digest, gravity = hashlib.sha256(), np.array(gravity, dtype=np.float64)
    for message in bag:
        if message.kind == "gravity":
            found.counts["gravity_messages"] += 1
            try:
                vector = decode(message).vector
                gravity = gravity_direction([vector.x, vector.y, vector.z])
            except ValueError as error:
                found.reject("gravity_rejected", str(error))
            continue
        index = found.counts["joint_states"]
        found.counts["joint_states"] += 1
        try:
            state = decode(message)
            positions = reader.read(state.name, state.position)
            started = perf_counter_ns()
            draper.drape(positions, gravity, out=points)
            found.latency_ns.append(perf_counter_ns() - started)
        except ValueError as error:
            found.reject("rejected", str(error))
            continue
        reader.positions = positions
        found.counts["draped"] += 1
        found.frames.append(index)
        found.times_ns.append(message.time_ns)
        digest.update(points.tobytes())
        measure.add(positions, gravity, points, contact=contact_every > 0 and index % contact_every == 0)
        if writer is not None:
            writer.write_cloud(topic, points, state.header.stamp, frame_id, message.time_ns)
    found.counts["names_unknown"] = len({name for names in unknown for name in names})
    found.clouds_sha256 = digest.hexdigest()
    return found


class _Measurements:
    """Measures clouds as they come; only the last three are kept."""

    def __init__(self, draper: Draper, found: Replay) -> None:
        self._draper, self._found = draper, found
        self._clouds: list[np.ndarray] = []
        self._skinned: list[np.ndarray] = []

    def add(self, positions: np.ndarray, gravity: np.ndarray, points: np.ndarray, *, contact: bool) -> None:
        draper, found = self._draper, self._found
        garment, vertices = draper.rest_garment, points[:, :3].astype(np.float64)
        found.positions.append(positions)
        found.gravity.append(gravity)
        found.edge_strain.append(float(edge_strain(garment, vertices)))
        found.area_strain.append(float(area_strain(garment, vertices)))
        bones = draper.bone_transforms(positions)
        for kept, bend, latest in (
            (self._clouds, found.bend, vertices),
            (self._skinned, found.skinning_bend, plain_skinning(draper.bound, bones)),
        ):
            kept.append(latest)
            del kept[:-3]
            # what `quality.jitter` averages, of these three frames
            second = kept[0] - 2 * kept[1] + kept[2] if len(kept) == 3 else np.full((1, 3), np.nan)
            bend.append(float(np.linalg.norm(second, axis=-1).mean()))
        rig = draper.model.rig
        beyond = (positions < rig.lower - 1e-3) | (positions > rig.upper + 1e-3)
        found.out_of_range_clouds += bool(beyond.any())
        found.out_of_range.update(rig.joint_names[joint] for joint in np.flatnonzero(beyond))
        if contact:
            distance = signed_distance(vertices, draper.avatar.posed_vertices(bones), draper.avatar.faces)
            shares = 100 * (distance < 0).mean(), 100 * (distance < CLOSE).mean()
            depth = 1000 * max(0.0, -float(distance.min()))
            found.contact.append((len(found.edge_strain) - 1, *map(float, shares), depth))


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0, or 1 when something is worse than in the baseline, which is then told."""
    parser = _parser()
    options = parser.parse_args(argv)
    if options.live:
        return _play_live(parser, options)
    if options.rate is not None:
        parser.error("--rate is for --live")
    direction = gravity_direction(options.gravity)
    baseline = load_baseline(options.baseline) if options.baseline else None
    output = BagWriter(options.output, storage=options.storage) if options.output else nullcontext()
    with BagReader(options.bag, topic=options.topic, gravity_topic=options.gravity_topic) as bag:
        draper = _draper(options)
        every = options.contact_every
        if every is None:
            every = max(1, -(-bag.joint_state_count // CONTACT_CLOUDS))
        with output as writer:
            found = replay(
                draper,
                bag,
                writer,
                joint_map=options.joint_map,
                gravity=direction,
                contact_every=every,
                topic=options.garment_topic,
                frame_id=options.frame_id,
            )
            if not found.frames:
                raise BagError(
                    f"bag {bag.path}: none of the {found.counts['joint_states']} joint states on {bag.topic} could be "
                    f"draped{_most_frequent(found.reasons)}"
                )
        figures = describe(found, draper, bag, contact_every=every)
    print(summary(figures))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    worse = regressions(figures, baseline, latency_percent=options.latency_tolerance) if baseline else []
    if options.report:
        pictures, remark = thumbnails(found, draper, count=options.pictures)
        write_report(options.report, figures, pictures, remark, worse if baseline else None)
    for line in worse:
        print(f"worse than {options.baseline}: {line}", file=sys.stderr)
    if baseline and not worse:
        print(f"not worse than {options.baseline}")
    return 1 if worse else 0


def _play_live(parser: argparse.ArgumentParser, options: argparse.Namespace) -> int:
    allowed = {"bag", "topic", "gravity_topic", "live", "rate"}
    idle = [name for name, value in vars(options).items() if name not in allowed and value != parser.get_default(name)]
    if idle:
        named = ", ".join(f"--{name.replace('_', '-')}" for name in idle)
        parser.error(f"--live only plays messages; {named} belongs to draping")
    from physkin_ros.replay.live import play

    with BagReader(options.bag, topic=options.topic, gravity_topic=options.gravity_topic) as bag:
        late = play(bag, rate=1.0 if options.rate is None else options.rate)
    if not len(late):
        raise BagError(f"bag {bag.path} holds no message on {bag.topic}")
    p50, p99 = np.percentile(late, (50, 99)) * 1e3
    print(f"sent {len(late)} messages, late by p50 {p50:.3f} ms, p99 {p99:.3f} ms, at most {1e3 * late.max():.3f} ms")
    return 0


def _draper(options: argparse.Namespace) -> Draper:
    model = load_garment_model(options.model)
    avatar = load_avatar(options.avatar, model.rig, rig_file=options.rig)
    for warning in avatar.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    chosen = {"backend": options.backend, "precision": options.precision, "fit": options.fit}
    return Draper(model, avatar, push_out=options.push_out, normals=options.normals, **chosen)


def _most_frequent(reasons: Counter) -> str:
    return f"; most often: {reasons.most_common(1)[0][0]}" if reasons else ""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="physkin replay", description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    parser.add_argument("--model", default="tshirt", help="garment model: a file or a shipped name (default tshirt)")
    parser.add_argument(
        "--avatar", default=BUNDLED_AVATAR, help="body: GLB, glTF, VRM, OBJ, PLY, STL (default: bundled)"
    )
    parser.add_argument("--rig", metavar="FILE", help="rig file of a body that has no skin of its own")
    parser.add_argument(
        "--joint-map", metavar="FILE", help=f"from incoming joint names to the rig's; or {' or '.join(PRESETS)}"
    )
    parser.add_argument("--topic", help="joint states (default /joint_states, or the only one)")
    parser.add_argument("--gravity-topic", help="gravity's direction (default /gravity, if the bag has it)")
    parser.add_argument("--gravity", type=float, nargs=3, default=UPRIGHT_GRAVITY.tolist(), metavar=("X", "Y", "Z"))
    parser.add_argument("--backend", choices=BACKENDS, default="native")
    parser.add_argument(
        "--precision", choices=PRECISIONS, help="of the native backend's network weights (default bf16)"
    )
    parser.add_argument("--fit", type=float, default=0.0, help="0: one size, 1: made to measure (default 0)")
    parser.add_argument("--push-out", action="store_true", help="bring vertices out of the body, as the node can")
    parser.add_argument("--normals", choices=NORMALS, default="skinned", help="carried along, or of the draped mesh")
    parser.add_argument("-o", "--output", type=Path, metavar="BAG", help="bag to write: a folder, .mcap or .db3")
    parser.add_argument("--storage", choices=STORAGES, help="of an output folder (default mcap)")
    parser.add_argument("--garment-topic", default=GARMENT_TOPIC, help="of the clouds (default %(default)s)")
    parser.add_argument("--frame-id", default="base_link", help="of the clouds (default %(default)s)")
    parser.add_argument(
        "--contact-every",
        type=_not_negative,
        metavar="N",
        help=f"measure every Nth cloud against the body, 0: none (default: about {CONTACT_CLOUDS} clouds)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures; docs/replay.md explains the keys")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write a self-contained HTML page")
    parser.add_argument(
        "--pictures", type=_not_negative, default=6, metavar="K", help="in the report (default %(default)s)"
    )
    parser.add_argument(
        "--baseline", type=Path, metavar="FILE", help="an earlier --json of this bag; exit 1 when worse"
    )
    parser.add_argument(
        "--latency-tolerance",
        type=float,
        metavar="PERCENT",
        help="compare latencies with the baseline too (default: not, for they are the machine's)",
    )
    parser.add_argument(
        "--live", action="store_true", help="only play the joint states and gravity to their topics (needs ROS)"
    )
    parser.add_argument("--rate", type=_positive, metavar="R", help="with --live: times as fast (default 1)")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value


def _not_negative(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} must not be negative")
    return value


if __name__ == "__main__":
    sys.exit(main())
