"""`physkin demo`: the drape node at work between two other processes, measured and drawn.

A node process drapes, a player process sends a bundled motion as gravity and joint states at 60 Hz, a listener process
receives the clouds. Every cloud is matched to its joint state by its stamp, and some are compared with the core's.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import tempfile
from pathlib import Path

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model, load_motion
from physkin_ros.middleware.transport import private_environment
from physkin_ros.tools.children import ChildFailedError, Children
from physkin_ros.tools.demo_listener import KEPT_CLOUDS, READY
from physkin_ros.tools.demo_player import RATE_HZ
from physkin_ros.tools.demo_report import DemoReport, draw

__all__ = ["main"]

START_SECONDS = 90.0
ERROR_ALLOWED = (
    1e-3  # [m] a cloud with the gravity of the frame before or after passes, one with an upright body's fails
)
QUEUE_PARAMETERS = [f"qos_overrides./{topic}.subscription.depth" for topic in ("joint_states", "gravity")]
QUEUE = 120  # messages the node may queue: two seconds, so that a busy machine makes clouds late but not lost


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a cloud was lost, was not finite or was wrong, or a process failed."""
    options = _parser().parse_args(argv)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    model = load_garment_model(options.garment)
    avatar = load_avatar(options.body or BUNDLED_AVATAR, model.rig)
    clip = load_motion(options.motion).resampled(RATE_HZ)
    motion = clip.looped(options.seconds)
    keep_every = math.ceil(min(clip.frame_count, motion.frame_count) / KEPT_CLOUDS)
    try:
        with tempfile.TemporaryDirectory(prefix="physkin-demo-") as folder:
            sent, received = _play(options, motion.frame_count, keep_every, Path(folder))
            report = DemoReport.from_files(sent, received)
    except ChildFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        _say("interrupted")
        return 130
    error = report.largest_error(Draper(model, avatar), motion)
    print(report.table(model, error), flush=True)
    if report.lost < motion.frame_count:
        _say(f"drawing {options.output}")
        draw(options.output, report, model, avatar, motion)
    return 0 if report.complete and error <= ERROR_ALLOWED else 1


def _play(options: argparse.Namespace, count: int, keep_every: int, folder: Path) -> tuple[Path, Path]:
    """Run the three processes for `count` joint states; returns the files of the player and of the listener."""
    sent, received = folder / "sent.npz", folder / "received.npz"
    parameters = {
        "model": options.garment,
        "backend": options.backend,
        **dict.fromkeys(QUEUE_PARAMETERS, QUEUE),
    }
    if options.body:
        parameters["body_mesh"] = options.body
    node_arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with Children(private_environment(), folder) as children:
        _say(f"starting the drape node with {options.garment}")
        children.start("node", "physkin_core.cli", "node", "--ros-args", *node_arguments)
        children.start("listener", "physkin_ros.tools.demo_listener", count, keep_every, received)
        children.wait(lambda: READY in children.log("listener").splitlines(), "the garment's topic", START_SECONDS)
        _say(f"playing {options.motion}: {count} joint states at {RATE_HZ:.0f} Hz, {options.seconds:g} s")
        children.start("player", "physkin_ros.tools.demo_player", options.motion, options.seconds, sent)
        children.wait(lambda: children.finished("player"), "the motion", options.seconds + START_SECONDS)
        children.wait(lambda: children.finished("listener"), "the last cloud", START_SECONDS)
    return sent, received


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="physkin demo", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=_positive, default=10.0, help="how long to play (default %(default)g)")
    parser.add_argument("--output", type=Path, default=Path("demo.png"), help="picture (default %(default)s)")
    parser.add_argument("--garment", default="tshirt", help="shipped garment or model file (default %(default)s)")
    parser.add_argument("--body", default="", help="avatar file (default: the bundled avatar)")
    parser.add_argument("--motion", default="dance", help="bundled motion or a motion file (default %(default)s)")
    parser.add_argument("--backend", default="native", choices=("native", "numpy"), help="default %(default)s")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value


def _say(line: str) -> None:
    print(f"physkin demo: {line}", flush=True)
