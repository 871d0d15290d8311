"""`physkin check`: say how an outfit sits on an avatar: figures, a verdict, its reason, what to do, and a picture."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_parts import bare_parts
from physkin_core.check.advice import OutfitCheck, reason_and_advice
from physkin_core.check.garment_check import check_garment
from physkin_core.check.likeness import body_overlap, likeness
from physkin_core.check.sight import hole_percent
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.outfit.outfit import Outfit
from physkin_core.outfit.outfit_options import add_options, chosen_avatar, chosen_garments, print_warnings
from physkin_core.output_file import check_folder
from physkin_core.separation.limb_separator import bind_limbs

__all__ = ["command_parser", "main"]

PICTURED = (1, 6, 11, 16)
"""Everyday poses in the picture."""
PICTURE_SIZE = (260, 440)


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin check`."""
    parser = argparse.ArgumentParser(prog="physkin check", description=__doc__.split("`: ")[1])
    parser.add_argument("avatar", metavar="AVATAR", help="body: a GLB, glTF, VRM, FBX, OBJ, PLY or STL file")
    add_options(parser, "garment", "tucked", "own-clothes", "rig", "bones", "fit", "separate-limbs")
    parser.set_defaults(separate_limbs=False)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="PNG", help="picture of four everyday poses, from the front and the back"
    )
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0, 1 for the verdict "bad"; errors are raised."""
    options = command_parser().parse_args(argv)
    for file in (options.json, options.output):
        if file is not None:
            check_folder(file)
    garments = chosen_garments(options.garment, options.tucked)
    rig = garments[0].model.rig
    avatar = chosen_avatar(options, rig)
    outfit = Outfit(garments, avatar, fit=options.fit, own_clothes=options.own_clothes)
    poses, downs = everyday_poses(rig)
    if options.separate_limbs:
        separator = bind_limbs(rig, avatar)
        poses = np.array([separator.separate(positions)[0] for positions in poses])
    found = OutfitCheck(
        {layer.name: check_garment(layer, avatar, poses=poses) for layer in outfit.layers},
        likeness(avatar, rig),
        hole_percent=hole_percent(outfit),
        overlap_percent=body_overlap(avatar, rig, poses),
        measured=all(layer.fit == 1 for layer in outfit.layers),
        limbs_apart=options.separate_limbs,
        height=float(np.ptp(outfit.avatar.vertices[:, 2])),
        bare=bare_parts(outfit.avatar, rig),
        undressed=len(outfit.avatar.clothes) < len(avatar.clothes),
    )
    report = _report(outfit, found)
    _print(report)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1))
    if options.output:
        _draw(options.output, outfit, poses, downs)
        print(f"wrote {options.output}")
    return 1 if report["verdict"] == "bad" else 0


def _report(outfit: Outfit, found: OutfitCheck) -> dict:
    """Of several garments the worst figures, and each by name."""
    garments = {name: check.as_plain_data() for name, check in found.garments.items()}
    first = next(iter(garments.values()))

    def worst(when: str) -> dict[str, float]:
        return {key: max(each[when][key] for each in garments.values()) for key in first[when]}

    reason, advice = reason_and_advice(found)
    return {
        "avatar": outfit.avatar.source,
        "warnings": list(outfit.warnings),
        "rest": worst("rest"),
        "everyday": worst("everyday"),
        "skin_shows_percent": max(each["skin_shows_percent"] for each in garments.values()),
        "stands_off_mm": max(each["stands_off_mm"] for each in garments.values()),
        "hole_percent": found.hole_percent,
        "verdict": found.verdict,
        "reason": reason,
        "advice": advice,
        "height_m": found.height,
        "likeness": asdict(found.known),
        "body_overlap_percent": found.overlap_percent,
        "garments": garments,
    }


def _print(report: dict) -> None:
    print_warnings(report["warnings"])
    for name, found in report["garments"].items():
        rest, everyday = found["rest"], found["everyday"]
        print(f"{name}: {found['verdict']}")
        print(
            f"  at rest   {rest['inside_percent']:.2f} % of the cloth inside the body, {rest['deepest_mm']:.0f} mm deep"
        )
        print(
            f"            skin is seen in {found['skin_shows_percent']:.2f} % of where cloth should be seen; collar or "
            f"waistband {found['stands_off_mm']:.0f} mm from the skin"
        )
        print(
            f"  everyday  {everyday['inside_percent']:.2f} % inside, {everyday['deepest_mm']:.0f} mm deep, "
            f"{everyday['edge_strain_percent']:.1f} % strain"
        )
    known = report["likeness"]
    print(
        f"body: {report['height_m']:.2f} m tall, {known['shape_deviation']:.1f} standard deviations from the average "
        "of that stature (about 1 is usual)\n"
        f"      most similar body that training knows: its skin is {known['skin_distance_mm']:.0f} mm away, joint "
        f"{known['pivot_bone']} {known['pivot_distance_mm']:.0f} mm, bone {known['longest_bone']} is "
        f"{known['longest_ratio']:.2f} times as long here\n"
        f"      {report['body_overlap_percent']:.1f} % of the skin lies inside the body; its inside is seen through "
        f"holes in {report['hole_percent']:.2f} % of the pixels"
    )
    print(" ".join(filter(None, (f"{report['verdict']}:", report["reason"], report["advice"]))))


def _draw(path: Path, outfit: Outfit, poses: np.ndarray, downs: Sequence[np.ndarray]) -> None:
    """The outfit in four everyday poses, upright, in the avatar's own colours."""
    from physkin_core.pictures.picture import save_png
    from physkin_core.render.filming import draw_figures, dressed_meshes

    figures = []
    for pose in PICTURED:
        upright = Rotation.align_vectors([[0.0, 0.0, -1.0]], [downs[pose]])[0]
        clouds = outfit.drape(poses[pose], downs[pose])
        body, *cloth = (upright.apply(points[:, :3]) for points in (outfit.posed_body(poses[pose]), *clouds))
        figures.append(dressed_meshes(outfit, body, cloth))
    save_png(path, draw_figures(figures, size=PICTURE_SIZE))
