"""`physkin convert`: write a motion as a bag of joint states, for replay or `ros2 bag play`. Needs no ROS."""

from __future__ import annotations

import argparse
from pathlib import Path

from physkin_core import Motion, load_body_model, load_motion
from physkin_core.motion.clip_files import is_clip, load_clip
from physkin_core.outfit.outfit_options import add_options, motion_settings
from physkin_core.progress import progress_line
from physkin_ros.replay.bags import BagWriter, write_motion

__all__ = ["command_parser", "main"]


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin convert`."""
    parser = argparse.ArgumentParser(prog="physkin convert", description=__doc__.split("`: ", 1)[1].splitlines()[0])
    parser.add_argument("motion", help="bundled motion or a motion file")
    parser.add_argument("output", type=Path, metavar="BAG", help="bag to write: a folder, .mcap or .db3")
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="joint states a second (default: the clip's; 60 for motion capture)"
    )
    parser.add_argument("--skeleton", metavar="ASF", help="skeleton of an .amc (default: 02.asf for 02_02.amc)")
    add_options(parser, "bones", "source-rate")
    parser.add_argument("--seconds", type=float, help="repeat or cut the clip to this length (default: once)")
    parser.add_argument("--frame-id", default="base_link", help="TF frame of the root (default %(default)s)")
    parser.add_argument(
        "--world-frame",
        default="world",
        help="TF frame of the world, for /tf and /odom (default %(default)s; '' writes neither topic)",
    )
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns the exit status."""
    options = command_parser().parse_args(argv)
    with BagWriter(options.output) as writer:  # first: a motion may take a while to read
        motion = _motion(options)
        if options.rate is not None:
            motion = motion.resampled(options.rate)
        if options.seconds is not None:
            motion = motion.looped(options.seconds)
        write_motion(writer, motion, frame_id=options.frame_id, world_frame=options.world_frame)
    print(f"wrote {options.output}: {motion.frame_count} joint states at {motion.rate_hz:g} Hz")
    return 0


def _motion(options: argparse.Namespace) -> Motion:
    settings = motion_settings(options)
    if not is_clip(options.motion):
        return load_motion(options.motion, **settings)
    settings["skeleton"] = options.skeleton
    watch = progress_line(f"reading {options.motion}")
    motion, missed = load_clip(options.motion, load_body_model().rig, watch=watch, **settings)
    bone = max(missed, key=missed.get)
    print(
        f"retargeted: bones miss their direction by {sum(missed.values()) / len(missed):.1f} degrees on average, "
        f"{bone} by {missed[bone]:.1f}"
    )
    return motion
