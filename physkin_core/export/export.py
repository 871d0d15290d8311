"""`physkin export`: write a motion draped on an avatar to a file that other tools open."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, GLTF_SUFFIXES
from physkin_core.export.array_motion import write_array_motion
from physkin_core.export.dressed_file import write_dressed_file
from physkin_core.export.gltf_motion import write_gltf_motion
from physkin_core.export.usd_motion import write_usd_motion
from physkin_core.export.web_page import write_web_page
from physkin_core.file_reading import reading
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.look.avatar_look import avatar_look
from physkin_core.look.cloth_look import cloth_colours, cloth_look
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.mesh.surfaces import surfaces_of
from physkin_core.motion.clip_files import split_clip_name
from physkin_core.motion.motion import MotionError
from physkin_core.motion.source_clip import RATE_HZ
from physkin_core.outfit.outfit import Outfit
from physkin_core.outfit.outfit_options import (
    add_options,
    add_outfit_options,
    as_asked,
    chosen_avatar,
    dressed,
    print_warnings,
    read_motion,
)
from physkin_core.output_file import check_other_file
from physkin_core.quality import closest_points

__all__ = ["WRITERS", "command_parser", "dressed_for", "garment_looks", "main"]

WRITERS = {".glb": write_gltf_motion, ".usd": write_usd_motion, ".usdc": write_usd_motion, ".zarr": write_array_motion}
LIES_ON = 0.002
"""[m] on average: so close to a garment lies a mesh of it. A finer or repaired one does, another size does not."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin export`."""
    parser = argparse.ArgumentParser(prog="physkin export", description=__doc__.split("`: ")[1])
    said = "bundled motion or a motion file; without --avatar, a glTF or VRM file with a skin is itself dressed"
    parser.add_argument("motion", metavar="MOTION", help=said)
    add_outfit_options(parser)
    parser.set_defaults(avatar=None)
    add_options(parser, "source-rate", "separate-limbs", "sway", "wind", "rate")
    parser.add_argument(
        "--materials",
        action="append",
        default=[],
        type=Path,
        metavar="MESH",
        help="mesh with texture coordinates and materials for a garment (fit-garment's garment.obj); once for each",
    )
    wanted = parser.add_mutually_exclusive_group(required=True)
    wanted.add_argument(
        *("-o", "--output"),
        type=Path,
        help="a .glb with garment nodes as joints, .usd, .usdc with every vertex in every frame, or .zarr of arrays",
    )
    wanted.add_argument(
        "--web",
        type=Path,
        metavar="FOLDER",
        help="instead: a page for any web server; its cloth is computed in the browser (docs/browser.md)",
    )
    said = "with --web: a button makes the avatar follow the visitor's camera; a file without clips walks until then"
    parser.add_argument("--camera", action="store_true", help=said)
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0; errors are raised."""
    options = command_parser().parse_args(argv)
    source, clip = split_clip_name(options.motion)
    own = _skinned_file(source) if options.avatar is None else None
    options.avatar = options.avatar or (BUNDLED_AVATAR if own is None else source)
    if options.web is not None:
        if options.camera and own is not None and not own.document.count("animations"):
            options.motion = "walk"
        return _write_page(options)
    if options.camera:
        raise ValueError("--camera is for pages: give --web FOLDER in place of --output")
    kind = options.output.suffix.lower()
    if own is not None and (kind == ".glb" or kind == source.suffix.lower() == ".vrm"):
        return _write_dressed(options, own, clip)
    if kind not in WRITERS:
        raise ValueError(f"cannot write {options.output.name}: allowed are {', '.join(WRITERS)}")
    check_other_file(options.output, options.avatar, source, *options.materials)
    motion = read_motion(options)
    outfit, looks = dressed_for(kind, options)
    motion = as_asked(motion, options, outfit)
    not_shown = WRITERS[kind](options.output, outfit, motion, looks=looks)
    size = sum(path.stat().st_size for path in (options.output, *options.output.rglob("*"))) / 1e6
    print(f"wrote {options.output}: {motion.frame_count} frames at {motion.rate_hz:g} Hz, {size:.1f} MB")
    print_warnings(not_shown)
    return 0


def dressed_for(kind: str, options: argparse.Namespace) -> tuple[Outfit, list[Look | None]]:
    """The outfit that the writer of a kind takes, and looks of its body and garments: none for arrays. Raises as
    `dressed` and `garment_looks`."""
    outfit = dressed(options, for_engines=kind == ".glb")
    if kind == ".zarr":
        return outfit, []
    body = slice(None) if kind == ".glb" else outfit.faces_to_draw  # a .glb leaves out by its own frames
    return outfit, [avatar_look(outfit.body_to_draw, body), *garment_looks(options.materials, outfit)]


def _skinned_file(source: Path) -> GltfFile | None:
    """The file itself if it can be dressed."""
    if source.suffix.lower() not in GLTF_SUFFIXES or not source.is_file():
        return None
    with reading(f"motion file {source}", MotionError):
        file = GltfFile(source, lenient=True)
        return file if file.document.count("skins") and file.document.count("meshes") else None


def _write_dressed(options: argparse.Namespace, file: GltfFile, clip: str) -> int:
    check_other_file(options.output, file.path, *options.materials)
    if options.source_rate is not None or not 0 < (rate_hz := options.rate or RATE_HZ) < np.inf:
        raise ValueError("clips keep their own times: no --source-rate, and a positive --rate")
    avatar = chosen_avatar(options, load_body_model().rig)
    outfit = dressed(options, for_engines=True, avatar=avatar)
    looks = garment_looks(options.materials, outfit)
    with reading(f"motion file {options.motion}", MotionError):
        said, lacking = write_dressed_file(options.output, file, outfit, avatar, looks, clip, rate_hz)
    print(f"wrote {options.output}: {file.path.name} {said}; {options.output.stat().st_size / 1e6:.1f} MB")
    print_warnings(lacking)
    return 0


def _write_page(options: argparse.Namespace) -> int:
    if options.web.exists() and not options.web.is_dir():
        raise ValueError(f"cannot write {options.web}: it is a file; name a folder")
    motion, outfit = read_motion(options), dressed(options, whole=True)
    motion = as_asked(motion, options, outfit)
    size = write_web_page(options.web, outfit, motion, garment_looks(options.materials, outfit), camera=options.camera)
    print(f"wrote {options.web}: {size / 1e6:.1f} MB; to see it: python3 -m http.server -d {options.web}")
    return 0


def garment_looks(paths: Sequence[Path], outfit: Outfit) -> list[Look | None]:
    """The looks of an outfit's garments on the faces that are given of them; None for those without.

    A garment that was cut flat has the look of its fabric, and where its own material is given still its texture
    places, in metres. paths: meshes that lie where the
    garments' own do, as `physkin fit-garment` writes them. Which is whose is told by that. Raises GarmentError for what
    is no readable mesh, and ValueError for a mesh of no garment, a second one of the same garment, one without texture
    places and materials, colours that are not three numbers from 0 to 1, and pictures that are missing or not PNG or
    JPEG.
    """
    looks = [
        cloth_look(layer.model.garment, layer.model.fabric, layer.face_visible, colour)
        for layer, colour in zip(outfit.layers, cloth_colours(outfit.garments))
    ]
    seen: set[int] = set()
    for path in paths:
        mesh = read_mesh(path)
        if not str(mesh.look):
            raise ValueError(f"{path} has neither texture coordinates nor materials: nothing to give a garment")
        templates = [layer.model.garment.vertices for layer in outfit.layers]
        apart = [closest_points(points, mesh.vertices, mesh.faces)[0].mean() for points in templates]
        k = int(np.argmin(apart))
        layer, name = outfit.layers[k], outfit.layers[k].name
        if apart[k] > LIES_ON:
            raise ValueError(
                f"{path} lies on no garment that is worn: {name} is the closest, {1000 * apart[k]:.0f} mm off on "
                f"average; allowed are {1000 * LIES_ON:.0f} mm; give the garment.obj that fit-garment wrote"
            )
        if k in seen:
            raise ValueError(f"{path} is a second mesh of materials for {name}; a garment has one")
        given = layer.model.garment.vertices[layer.visible]
        seen.add(k)
        look, flat = mesh.look.on((mesh.vertices, mesh.faces), given, layer.faces), looks[k]
        looks[k] = look if flat is None or np.isfinite(look.uv).any() else replace(look, uv=flat.uv)
        try:  # what is wrong is told before hours of work
            surfaces_of(looks[k], name, (1.0, 1.0, 1.0), len(layer.faces))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    return looks
