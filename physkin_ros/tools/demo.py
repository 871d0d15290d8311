"""`physkin demo`: run the ROS node between a motion player and a listener; measure it and draw a picture.

A node process drapes an outfit, a player process sends a bundled motion as gravity and joint states at 60 Hz, a
listener process receives the clouds. Every cloud is matched to its joint state by its stamp, and some are compared
with the core's.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import tempfile
from pathlib import Path

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_motion
from physkin_core.outfit.outfit_options import add_options, chosen_garments
from physkin_core.progress import progress_line
from physkin_ros.arguments import file_to_write, positive
from physkin_ros.middleware.transport import private_environment
from physkin_ros.tools.children import ChildFailedError, Children
from physkin_ros.tools.demo_report import complete, draw, largest_error, table
from physkin_ros.tools.listener import KEPT_CLOUDS
from physkin_ros.tools.trial import Records, finish, start_node, start_playing

__all__ = ["command_parser", "main"]

RATE_HZ = 60.0
WORN = ("trousers", "tshirt")
"""By default, from the skin outwards."""
ERROR_ALLOWED = 3e-3
"""[m] A cloud with the gravity of the frame before or after passes, one with an upright body's fails; layers over each
other in folds differ by a millimetre where they were put in order in another frame."""


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a cloud was lost, was not finite or was wrong, or a process failed."""
    options = command_parser().parse_args(argv)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    options.garment = options.garment or list(WORN)
    garments = chosen_garments(options.garment, options.tucked)
    avatar = load_avatar(options.avatar or BUNDLED_AVATAR, garments[0].model.rig)
    clip = load_motion(options.motion, watch=progress_line(f"reading {options.motion}")).resampled(RATE_HZ)
    motion = clip.looped(options.seconds)
    outfit = Outfit(garments, avatar, fit=options.fit)
    keep_every = math.ceil(min(clip.frame_count, motion.frame_count) / KEPT_CLOUDS)
    try:
        with tempfile.TemporaryDirectory(prefix="physkin-demo-") as folder:
            records = _play(options, keep_every, Path(folder))
    except ChildFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        _say("interrupted")
        return 130
    error = largest_error(records, outfit, motion)
    print(table(records, outfit, motion, error), flush=True)
    if len(records.kept):
        _say(f"drawing {options.output}")
        draw(options.output, records, outfit, motion)
    return 0 if complete(records, len(garments)) and error <= ERROR_ALLOWED else 1


def _play(options: argparse.Namespace, keep_every: int, folder: Path) -> Records:
    with Children(private_environment(), folder) as children:
        _say(f"starting the drape node with {' and '.join(options.garment)}")
        worn = [{"model": name, "tucked": name in options.tucked} for name in options.garment]
        asked = {"avatar": {"body_mesh": options.avatar}, "garment": {"fit": options.fit}, "outfit": worn}
        start_node(children, folder, 1, **asked, queue=None)
        played = (options.motion, RATE_HZ, options.seconds, "--gravity")
        start_playing(children, folder, 1, *played, garments=len(worn), keep_every=keep_every)
        _say(f"playing {options.motion} at {RATE_HZ:.0f} Hz, {options.seconds:g} s")
        return finish(children, folder, options.seconds)


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin demo`."""
    parser = argparse.ArgumentParser(prog="physkin demo", description=__doc__.split("`: ", 1)[1].splitlines()[0])
    parser.add_argument("--seconds", type=positive, default=10.0, help="how long to play (default %(default)g)")
    parser.add_argument(
        *("-o", "--output"), type=file_to_write, default=Path("demo.png"), help="picture (default %(default)s)"
    )
    add_options(parser, "garment", "tucked", "fit", worn=", ".join(WORN))
    parser.add_argument("--avatar", default="", help="avatar file (default: the bundled avatar)")
    parser.add_argument("--motion", default="dance", help="bundled motion or a motion file (default %(default)s)")
    return parser


def _say(line: str) -> None:
    print(f"physkin demo: {line}", flush=True)
