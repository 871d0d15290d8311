"""`physkin demo`: play a motion to the ROS node, tell how late its clouds come and what they cost, and draw them.

A player process sends joint states, a node process drapes, and this one receives the clouds. All avatars wear the same;
their joint states are evenly spread in time. Lateness runs from just before a joint state is sent to when the bytes of
its last cloud are here.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Motion, Outfit
from physkin_core.machine import machine_line
from physkin_core.outfit.outfit_options import add_options, chosen_avatar, chosen_garments, read_motion
from physkin_core.pictures.picture import contact_sheet, render, save_png
from physkin_core.render.filming import dressed_meshes
from physkin_ros.arguments import file_to_write, positive, whole_number
from physkin_ros.middleware.transport import private_environment
from physkin_ros.tools.trial import (
    NodeProcess,
    Records,
    TrialError,
    node_parameters,
    play_to_node,
    processor_time,
)

__all__ = ["command_parser", "delivered_percent", "main"]

WORN = ("trousers", "tshirt")
"""By default, from the skin outwards."""
PICTURES, COLUMNS = 8, 4
PICTURE_SIZE = (420, 440)


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a cloud was lost or was not finite, or the node failed."""
    options = command_parser().parse_args(argv)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    options.garment = options.garment or list(WORN)
    garments = chosen_garments(options.garment, [])
    avatar = chosen_avatar(options, garments[0].model.rig)
    clip = read_motion(options).resampled(options.rate)
    motion, outfit = clip.looped(options.seconds), Outfit(garments, avatar)
    os.environ.update(private_environment())
    try:
        records = _play(options, motion)
    except TrialError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        _say("interrupted")
        return 130
    print(report(records, outfit), flush=True)
    if records.kept:
        _say(f"drawing {options.output}")
        draw(options.output, records, outfit, motion)
    return 0 if complete(records) else 1


def _play(options: argparse.Namespace, motion: Motion) -> Records:
    _say(f"starting the drape node with {' and '.join(options.garment)}")
    garments = [{"model": name} for name in options.garment]
    parameters = node_parameters(options.avatars, garments, body_mesh=options.avatar)
    asked = {"avatars": options.avatars, "garments": len(garments), "gravity": True}
    if not options.no_picture:
        asked["keep_every"] = math.ceil(motion.frame_count / PICTURES)
    with tempfile.TemporaryDirectory(prefix="physkin-demo-") as folder, NodeProcess(parameters, Path(folder)) as node:
        _say(f"playing {options.motion} at {options.rate:g} Hz, {options.seconds:g} s")
        return play_to_node(motion, check=node.check, measure=partial(processor_time, node.pid), **asked)


def complete(records: Records) -> bool:
    """Whether every joint state came back as one cloud a garment, of finite values, and nothing else did."""
    return bool((records.counts == 1).all()) and not records.strangers and not records.not_finite


def delivered_percent(records: Records) -> float:
    """Of the joint states those of which all clouds came, once."""
    return float(100 * (records.counts == 1).all(axis=2).mean())


def report(records: Records, outfit: Outfit) -> str:
    """What came back, how late and at what cost, a line each."""
    delays = records.delays.max(axis=2)  # until the last garment's cloud
    delays = delays[np.isfinite(delays)]
    median, p99, worst = np.percentile(delays, (50, 99, 100)) if len(delays) else [math.nan] * 3
    late = f"median {median:.2f} ms, 99 % within {p99:.2f} ms, worst {worst:.2f} ms" if len(delays) else "none came"
    sent, avatars, _ = records.counts.shape
    rows = {
        "garments": ", ".join(f"{layer.name} ({layer.vertex_count} vertices)" for layer in outfit.layers),
        "avatars": f"{avatars}",
        "joint states sent": f"{sent * avatars}, {delivered_percent(records):.2f} % of them draped",
        "clouds received": f"{records.counts.sum() + records.strangers:.0f} of {records.counts.size}",
        "clouds lost": f"{(records.counts == 0).sum()}",
        "clouds with values not finite": f"{records.not_finite}",
        "joint state to cloud": late,
    }
    said = [report for report in records.reports if report["evaluation p50 [us]"] != "none"]
    if said:  # of every second and garment, the outfit as a whole
        p50, p99 = (np.median([float(each[f"evaluation {of} [us]"]) for each in said]) for of in ("p50", "p99"))
        rows["evaluation"] = f"median {p50:.0f} µs, 99 % within {p99:.0f} µs, as the node says"
    if records.measured:
        first, whole = 1e6 * np.subtract(*records.measured[::-1]) / max(1, (records.counts == 1).all(axis=2).sum())
        rows["processor time a joint state"] = f"{first:.0f} µs of the thread that drapes, {whole:.0f} of all"
    rows["machine"] = f"{machine_line()}, load {os.getloadavg()[0]:.1f}"
    width = max(map(len, rows))
    return "\n".join(["", *(f"  {name:<{width}}  {value}" for name, value in rows.items()), ""])


def draw(path: Path, records: Records, outfit: Outfit, motion: Motion) -> None:
    """Write a contact sheet of the kept clouds to `path` (PNG): garments as they were received, the body in its pose.

    Raises PictureError when the extra `[view]` is not installed.
    """
    positions, rotations = motion.positions_for(outfit.rig), Rotation.from_quat(motion.root_orientation)
    scenes = {}
    for frame, clouds in sorted(records.kept.items()):
        points = [outfit.posed_body(positions[frame]), *(cloud[:, :3] for cloud in clouds)]
        scenes[f"{frame / motion.rate_hz:.2f} s"] = [rotations[frame].apply(each) for each in points]
    drawn = np.concatenate([points for scene in scenes.values() for points in scene])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = [
        render(dressed_meshes(outfit, body, cloth), bounds=bounds, size=PICTURE_SIZE)
        for body, *cloth in scenes.values()
    ]
    save_png(path, contact_sheet(pictures, columns=COLUMNS, captions=list(scenes)))


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin demo`."""
    parser = argparse.ArgumentParser(prog="physkin demo", description=__doc__.split("`: ", 1)[1].splitlines()[0])
    parser.add_argument("--seconds", type=positive, default=10.0, help="how long to play (default %(default)g)")
    parser.add_argument(
        *("-o", "--output"), type=file_to_write, default=Path("demo.png"), help="picture (default %(default)s)"
    )
    parser.add_argument(
        "--no-picture", action="store_true", help="only measure: draw nothing, and look at no value of the clouds"
    )
    parser.add_argument(
        "--avatars", type=whole_number(1), default=1, metavar="N", help="dressed at once (default %(default)s)"
    )
    parser.add_argument(
        "--rate", type=positive, default=60.0, metavar="HZ", help="joint states a second of each (default %(default)g)"
    )
    add_options(parser, "garment", "rig", "bones", "source-rate", worn=", ".join(WORN))
    parser.add_argument("--avatar", default="", help="avatar file (default: the bundled avatar)")
    parser.add_argument("--motion", default="dance", help="bundled motion or a motion file (default %(default)s)")
    return parser


def _say(line: str) -> None:
    print(f"physkin demo: {line}", flush=True)
