"""`physkin render`: film a motion draped on an avatar, or write numbered pictures."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from physkin_core.outfit.outfit_options import add_options, add_outfit_options, dressed, read_motion
from physkin_core.progress import progress_line
from physkin_core.render.film_files import FILM_KINDS, check_film, write_film
from physkin_core.render.filming import Camera, film
from physkin_core.separation.limb_separator import separated_motion

__all__ = ["command_parser", "main"]

USUAL_RATE = 30.0  # [Hz] of a film, where the motion has more
MOST_PIXELS = 4096  # a side


def main(argv: list[str]) -> int:
    """Command line. Returns 0; errors are raised."""
    options = command_parser().parse_args(argv)
    camera = Camera(
        azimuth=_finite("--azimuth", options.azimuth),
        follow=options.follow,
        size=_size(options.size),
        samples=int(_finite("--samples", options.samples, low=1, high=1024)),
    )
    motion = read_motion(options)
    if options.rate is None and motion.rate_hz > USUAL_RATE:
        motion = motion.resampled(USUAL_RATE)
    check_film(options.output, size=camera.size, rate_hz=motion.rate_hz)
    outfit = dressed(options)
    if options.separate_limbs:
        motion = separated_motion(motion, outfit.rig, outfit.avatar)
    pictures = film(outfit, motion, camera, watch=progress_line(f"drawing {motion.frame_count} frames"))
    files = write_film(options.output, pictures, motion.rate_hz)
    written = str(files[0]) if len(files) == 1 else f"{files[0]} to {files[-1].name}"
    size = sum(file.stat().st_size for file in files) / 1e6
    print(f"wrote {written}: {motion.frame_count} frames at {motion.rate_hz:g} Hz, {size:.1f} MB")
    return 0


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin render`."""
    parser = argparse.ArgumentParser(prog="physkin render", description=__doc__.split("`: ")[1])
    parser.add_argument("motion", metavar="MOTION", help="bundled motion or a motion file")
    add_outfit_options(parser)
    add_options(parser, "source-rate", "separate-limbs", "sway", "wind")
    usual = Camera()
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="frames a second (default: the motion's own, at most 30)"
    )
    parser.add_argument(
        "--size", default="{}x{}".format(*usual.size), metavar="WxH", help="width and height (default %(default)s)"
    )
    parser.add_argument(
        "--azimuth",
        type=float,
        default=usual.azimuth,
        metavar="DEG",
        help="where the camera stands: 0 in front, 90 on the body's left, 180 behind (default %(default)s)",
    )
    parser.add_argument(
        "--follow",
        action=argparse.BooleanOptionalAction,
        default=usual.follow,
        help="the camera goes with the body over the floor (default), or stands still",
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=usual.samples,
        metavar="N",
        help="light paths for each pixel: more is smoother and slower (default %(default)s)",
    )
    parser.add_argument(
        *("-o", "--output"), type=Path, required=True, help=f"{', '.join(FILM_KINDS)}; x.png becomes x_0000.png, ..."
    )
    return parser


def _finite(name: str, value: float, *, low: float = -math.inf, high: float = math.inf) -> float:
    if not (math.isfinite(value) and low <= value <= high):
        allowed = "a finite number" if high == math.inf else f"{low:g} to {high:g}"
        raise ValueError(f"{name} is {value}; allowed: {allowed}")
    return value


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 1 <= min(int(width), int(height))):
        raise ValueError(f"--size is {text!r}; allowed: width and height in pixels, as 480x600")
    if max(int(width), int(height)) > MOST_PIXELS:
        raise ValueError(f"--size is {text!r}; allowed: at most {MOST_PIXELS} pixels a side")
    return int(width), int(height)
