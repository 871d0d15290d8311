"""`physkin export`: a motion draped on an avatar, in a file that other tools open."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from physkin_core.avatar.loading import load_avatar
from physkin_core.export.garment_looks import garment_looks
from physkin_core.export.gltf_motion import write_gltf_motion
from physkin_core.export.usd_motion import write_usd_motion
from physkin_core.look.avatar_look import avatar_look
from physkin_core.motion.loading import load_motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.outfit.outfit_options import add_outfit_options, add_sway_option, chosen_garments
from physkin_core.output_file import check_other_file
from physkin_core.progress import progress_line

__all__ = ["command_parser", "main"]

WRITERS = {".glb": write_gltf_motion, ".usd": write_usd_motion, ".usdc": write_usd_motion}


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin export`."""
    parser = argparse.ArgumentParser(prog="physkin export", description=__doc__.split("`: ")[1])
    parser.add_argument("motion", metavar="MOTION", help="bundled motion or a motion file")
    add_outfit_options(parser)
    add_sway_option(parser)
    parser.add_argument("--rate", type=float, metavar="HZ", help="frames a second (default: the motion's own)")
    parser.add_argument(
        "--look",
        action="append",
        default=[],
        type=Path,
        metavar="MESH",
        help="texture places and materials of a garment: its mesh (fit-garment's garment.obj); one for each garment",
    )
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        required=True,
        help="a .glb with garment nodes as joints, or .usd, .usdc with every vertex in every frame",
    )
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0; errors are raised."""
    options = command_parser().parse_args(argv)
    kind = options.output.suffix.lower()
    if kind not in WRITERS:
        raise ValueError(f"cannot write {options.output.name}: allowed are {', '.join(WRITERS)}")
    check_other_file(options.output, options.avatar, options.motion, *options.look)
    garments = chosen_garments(options.garment, options.tucked)
    if kind == ".glb":
        garments = [replace(garment, model=garment.model.for_engines()) for garment in garments]
    motion = load_motion(options.motion, watch=progress_line(f"reading {options.motion}"))
    if options.rate:
        motion = motion.resampled(options.rate)
    avatar = load_avatar(options.avatar, garments[0].model.rig, rig_file=options.rig)
    outfit = Outfit(garments, avatar, fit=options.fit)
    outfit.sway = options.sway
    for warning in outfit.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    looks = [avatar_look(outfit.body_to_draw, outfit.faces_to_draw), *garment_looks(options.look, outfit)]
    WRITERS[kind](options.output, outfit, motion, looks=looks)
    size = options.output.stat().st_size / 1e6
    print(f"wrote {options.output}: {motion.frame_count} frames at {motion.rate_hz:g} Hz, {size:.1f} MB")
    return 0
