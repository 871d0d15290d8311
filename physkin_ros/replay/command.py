"""`physkin replay`: drape every joint state of a bag, write the clouds to another bag, measure them. Needs no ROS."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import nullcontext
from pathlib import Path

from physkin_core import Draper, load_garment_model
from physkin_core.cluster.cluster import add_address
from physkin_core.motion.bag_reader import ORIENTATIONS, BagError, BagReader
from physkin_core.outfit.outfit_options import (
    add_avatar_options,
    add_options,
    chosen_avatar,
    print_warnings,
    the_garment,
)
from physkin_core.runtime.frame_input import checked_sway
from physkin_core.separation.limb_separator import bind_limbs
from physkin_ros.arguments import file_to_write
from physkin_ros.joints.joint_naming import PRESETS
from physkin_ros.replay.bags import BagWriter
from physkin_ros.replay.figures import describe, load_baseline, regressions, summary
from physkin_ros.replay.many_bags import holds_bags, replay_all
from physkin_ros.replay.recorded_root import RecordedRoot
from physkin_ros.replay.replay import replay
from physkin_ros.replay.report import thumbnails, write_report

__all__ = ["command_parser", "main", "replay_one"]

CONTACT_CLOUDS = 24
"""About so many are measured against the body."""
LIVE = (
    "With --live it only plays joint states and gravity to their topics, which needs ROS: physkin replay --live --help."
)


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0, or 1 when something is worse than in the baseline or a bag of many was not replayed."""
    argv = sys.argv[1:] if argv is None else argv
    if "--live" in argv:
        from physkin_ros.tools.live import main as play_live

        return play_live(argv)
    options = command_parser().parse_args(argv)
    return replay_all(options, replay_one) if holds_bags(options.bag) else replay_one(options)


def replay_one(options: argparse.Namespace) -> int:
    """Drape one bag, write and print what the options of `command_parser` ask for. Returns as `main` does."""
    frames = {"frame_id": options.frame_id, "world_frame": options.world_frame}
    root = RecordedRoot(options.orientation, sway=checked_sway(options.sway), **frames)
    baseline = load_baseline(options.baseline) if options.baseline else None
    of_root = {"orientation": options.orientation, "orientation_topic": options.orientation_topic}
    output = BagWriter(options.output) if options.output else nullcontext()
    with output as writer, BagReader(options.bag, topic=options.topic, root=["transforms"], **of_root) as bag:
        draper, every = _draper(options), max(1, -(-bag.joint_state_count // CONTACT_CLOUDS))
        separator = bind_limbs(draper.model.rig, draper.avatar) if options.separate_limbs else None
        names = {"joint_map": options.joint_map, "joint_prefix": options.joint_prefix}
        settings = {**names, "root": root, "separator": separator, "contact_every": every}
        found = replay(draper, bag, writer, frame_id=options.frame_id, **settings)
        if not found.times_ns:
            why = f"; most often: {found.reasons.most_common(1)[0][0]}" if found.reasons else ""
            count = found.counts["joint_states"]
            raise BagError(f"bag {bag.path}: none of the {count} joint states on {bag.topic} could be draped{why}")
    figures = describe(found, draper, bag, contact_every=every)
    print(summary(figures))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    worse = regressions(figures, baseline) if baseline else None
    if options.report:
        write_report(options.report, figures, *thumbnails(found, draper), worse)
    for line in worse or ():
        print(f"worse than {options.baseline}: {line}", file=sys.stderr)
    if worse == []:
        print(f"not worse than {options.baseline}")
    return 1 if worse else 0


def _draper(options: argparse.Namespace) -> Draper:
    model = load_garment_model(the_garment(options.garment, "replay drapes"))
    draper = Draper(model, chosen_avatar(options, model.rig), fit=options.fit)
    print_warnings(draper.avatar.warnings)
    return draper


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin replay`."""
    parser = argparse.ArgumentParser(
        prog="physkin replay", description=__doc__.split("`: ", 1)[1].splitlines()[0], epilog=LIVE
    )
    parser.add_argument(
        "bag", type=Path, help="folder with metadata.yaml, or a .mcap or .db3 file; or a folder of such bags"
    )
    add_avatar_options(parser)
    add_options(parser, "garment")
    parser.add_argument(
        "--joint-map", metavar="FILE", help=f"from incoming joint names to the rig's; or {' or '.join(PRESETS)}"
    )
    parser.add_argument(
        "--joint-prefix", metavar="TEXT", default="", help="what joint names begin with besides, such as robot1_"
    )
    parser.add_argument("--topic", help="topic of joint states (default /joint_states, or the only one)")
    parser.add_argument(
        "--orientation",
        choices=tuple(ORIENTATIONS),
        default="gravity",
        help="what says which way is down and how the root moves (default %(default)s: a direction only)",
    )
    usual = ", ".join(topic for name, topic in ORIENTATIONS.items() if name != "tf")
    parser.add_argument("--orientation-topic", metavar="TOPIC", help=f"its topic (default {usual}, or the only one)")
    parser.add_argument(
        "--frame-id", default="base_link", help="frame of the clouds and of the root (default %(default)s)"
    )
    parser.add_argument(
        "--world-frame", metavar="FRAME", default="world", help="upright frame of TF (default %(default)s)"
    )
    add_options(parser, "sway", "fit", "separate-limbs")
    parser.set_defaults(separate_limbs=False)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="BAG", help="bag to write: a folder, .mcap or .db3; of many bags, a folder"
    )
    parser.add_argument(
        "--json", type=file_to_write, metavar="FILE", help="write the figures; docs/replay.md explains the keys"
    )
    parser.add_argument("--report", type=file_to_write, metavar="FILE", help="write a self-contained HTML page")
    add_address(parser, "none: the bags of a folder are replayed here, one after the other")
    parser.add_argument(
        "--baseline",
        type=Path,
        metavar="FILE",
        help="compare with an earlier --json of this bag; exit status 1 if worse",
    )
    return parser
