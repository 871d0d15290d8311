"""`physkin bind-points`: drape a finer mesh, a point cloud or Gaussian splats with a trained garment."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.rig_file import AXES, axes_to_root_frame
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit_options import (
    add_avatar_options,
    add_options,
    chosen_avatar,
    print_warnings,
    read_motion,
)
from physkin_core.output_file import check_other_file
from physkin_core.points.point_files import POINT_FILES, PointFile, read_points
from physkin_core.points.splat_draper import SplatDraper
from physkin_core.progress import progress_line

__all__ = ["command_parser", "main"]


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin bind-points`."""
    parser = argparse.ArgumentParser(prog="physkin bind-points", description=__doc__.split("`: ")[1])
    text = "garment model: a file or a shipped name, of another fabric as in skirt:denim"
    parser.add_argument("garment", metavar="GARMENT", help=text)
    kinds = ", ".join(POINT_FILES)
    parser.add_argument("points", metavar="POINTS", type=Path, help=f"points that lie on the garment's mesh: {kinds}")
    add_avatar_options(parser)
    add_options(parser, "fit", "source-rate")
    parser.add_argument("--motion", default="walk", help="bundled motion or a motion file (default %(default)s)")
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument("--frame", type=int, default=0, metavar="K", help="frame of the motion (default %(default)s)")
    frames.add_argument("--all", action="store_true", help="every frame: x.ply becomes x_0000.ply, ...")
    parser.add_argument("--rate", type=float, metavar="HZ", help="frames a second (default: the motion's own)")
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="S", help="size of a unit of POINTS in metres (default 1)"
    )
    parser.add_argument("--up", metavar="AXIS", help="axis of POINTS that is up (default: Z; Y for .glb)")
    parser.add_argument(
        "--forward",
        metavar="AXIS",
        help="axis of POINTS that is forward, as --forward=-Y (default: X where Z is up, Z where Y is)",
    )
    parser.add_argument(*("-o", "--output"), type=Path, required=True, help="file to write, of the kind of POINTS")
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0; errors are raised."""
    options = command_parser().parse_args(argv)
    if options.output.suffix.lower() != options.points.suffix.lower():
        raise ValueError(f"cannot write {options.output}: the name must end in {options.points.suffix}, as POINTS does")
    file = read_points(options.points)
    to_root = _to_root(options, file)
    model = load_garment_model(options.garment)
    motion, path = read_motion(options), options.output
    outputs = {options.frame: path}
    if options.all:
        outputs = {frame: path.with_stem(f"{path.stem}_{frame:04d}") for frame in range(motion.frame_count)}
    for output in outputs.values():
        check_other_file(output, options.points, options.avatar)
    avatar = chosen_avatar(options, model.rig)
    try:
        draper, write = _bound(model, avatar, options.fit, file, to_root)
    except ValueError as error:
        raise ValueError(f"{options.points}: {error}") from error
    print_warnings(draper.avatar.warnings)
    positions = motion.positions_for(model.rig)
    watch = progress_line(f"writing {len(outputs)} files")
    for done, (frame, output) in enumerate(outputs.items(), 1):
        write(output, positions[frame], motion.gravity[frame])
        watch(done / len(outputs))
    first, *others = outputs.values()
    kind = "splats" if file.splats else "points"
    print(f"wrote {first}{f' to {others[-1].name}' if others else ''}: {len(file.points)} {kind}")
    return 0


def _to_root(options: argparse.Namespace, file: PointFile) -> np.ndarray:
    """(3, 3) from the file's axes and unit to the root frame's."""
    if not (math.isfinite(options.scale) and options.scale > 0):
        raise ValueError(f"--scale is {options.scale}; allowed: a number above 0")
    up, forward = options.up or file.up, options.forward
    if up not in AXES or forward not in (None, *AXES) or (forward and up[-1] == forward[-1]):
        said = f"--up {up}" + (f" --forward {forward}" if forward else "")
        raise ValueError(f"{said}: allowed are two different axes of {', '.join(AXES)}")
    return options.scale * axes_to_root_frame(up, forward)


def _bound(model: GarmentModel, avatar: Avatar, fit: float | None, file: PointFile, to_root: np.ndarray):
    """What drapes the file's splats or points, and what writes a pose of them: a path, joint positions, gravity."""
    to_file = np.linalg.inv(to_root)
    if file.splats:
        splats = SplatDraper(model, avatar, file.splats.transformed(to_root), fit=fit)
        return splats, lambda path, *pose: file.write_splats(path, splats.drape(*pose).transformed(to_file))
    points, normals = file.points @ to_root.T, None if file.normals is None else file.normals @ to_root.T
    draper = Draper(model, avatar, fit=fit, points=points, point_normals=normals)
    turn_back = to_root.T / np.cbrt(np.linalg.det(to_root))

    def write(path: Path, *pose: np.ndarray) -> None:
        cloud = draper.drape(*pose).astype(np.float64)
        turned = None if normals is None else cloud[:, 3:] @ turn_back.T
        file.write(path, cloud[:, :3] @ to_file.T, turned)

    return draper, write
