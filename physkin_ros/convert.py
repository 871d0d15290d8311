"""`physkin convert`: a motion clip as a bag of joint states, for replay or `ros2 bag play`. Needs no ROS."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from physkin_core import load_motion
from physkin_ros.bags import STORAGES, BagWriter, write_motion

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="physkin convert", description=__doc__.splitlines()[0])
    parser.add_argument("motion", help="shipped clip (walk, dance, ...) or a motion file (.safetensors)")
    parser.add_argument("output", type=Path, metavar="BAG", help="bag to write: a folder, .mcap or .db3")
    parser.add_argument("--storage", choices=STORAGES, help="of an output folder (default mcap)")
    parser.add_argument("--rate", type=float, metavar="HZ", help="joint states a second (default: the clip's)")
    parser.add_argument("--seconds", type=float, help="repeat or cut the clip to this length (default: once)")
    parser.add_argument("--topic", default="/joint_states", help="default %(default)s")
    parser.add_argument("--gravity-topic", default="/gravity", help="default %(default)s")
    parser.add_argument("--frame-id", default="base_link", help="default %(default)s")
    options = parser.parse_args(argv)
    motion = load_motion(options.motion)
    if options.rate is not None:
        motion = motion.resampled(options.rate)
    if options.seconds is not None:
        motion = motion.looped(options.seconds)
    with BagWriter(options.output, storage=options.storage) as writer:
        topics = {"topic": options.topic, "gravity_topic": options.gravity_topic, "frame_id": options.frame_id}
        write_motion(writer, motion, **topics)
    print(f"wrote {options.output}: {motion.frame_count} joint states at {motion.rate_hz:g} Hz")
    return 0


if __name__ == "__main__":
    sys.exit(main())
