"""`physkin check`: how garments sit on an avatar, in figures, a verdict, one sentence of advice and a picture."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.loading import load_avatar
from physkin_core.check.garment_check import GarmentCheck, check_garment
from physkin_core.check.likeness import Likeness, body_overlap, likeness
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit_options import add_fit_option, add_limbs_option, add_rig_option, print_warnings
from physkin_core.output_file import check_folder
from physkin_core.separation.limb_separator import bind_limbs
from physkin_core.sway.frame_input import UPRIGHT_GRAVITY

__all__ = ["advice", "command_parser", "main"]

VERDICTS = ("good", "usable", "bad")
"""From best to worst."""
FAR_PIVOT_MM, FAR_SKIN_MM, FAR_SHAPE, FAR_LENGTH = 40.0, 10.0, 2.0, 1.25
MUCH_OVERLAP = 5.0
"""From here on a figure is what the advice is about."""
TURNS = (0.0, 90.0, 180.0, 270.0)
PICTURE_SIZE = (300, 600)


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin check`."""
    parser = argparse.ArgumentParser(prog="physkin check", description=__doc__.split("`: ")[1])
    parser.add_argument("avatar", metavar="AVATAR", help="body: a GLB, glTF, VRM, OBJ, PLY or STL file")
    parser.add_argument(
        *("-g", "--garment"),
        action="append",
        metavar="MODEL",
        help="a file or a shipped name (default tshirt), of another fabric as in skirt:denim; repeatable",
    )
    add_rig_option(parser)
    add_fit_option(parser)
    add_limbs_option(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("-o", "--output", type=Path, metavar="PNG", help="picture from four sides, garments in turn")
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0, 1 for the verdict "bad"; errors are raised."""
    options = command_parser().parse_args(argv)
    for file in (options.json, options.output):
        if file is not None:
            check_folder(file)
    models = [load_garment_model(name) for name in options.garment or ["tshirt"]]
    rig = models[0].rig
    avatar = load_avatar(options.avatar, rig, rig_file=options.rig)
    drapers = {model.name: Draper(model, avatar, fit=options.fit) for model in models}
    poses, _ = everyday_poses(rig)
    if options.separate_limbs:
        separator = bind_limbs(rig, avatar)
        poses = np.array([separator.separate(positions)[0] for positions in poses])
    checks = {name: check_garment(draper, poses=poses) for name, draper in drapers.items()}
    known, overlap = likeness(avatar, rig), body_overlap(avatar, rig, poses)
    report = _report(avatar, checks, known, overlap)
    _print(report, avatar)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1))
    if options.output:
        _draw(options.output, list(drapers.values()))
        print(f"wrote {options.output}")
    return 1 if report["verdict"] == "bad" else 0


def advice(checks: dict[str, GarmentCheck], known: Likeness, overlap_percent: float) -> str:
    """One sentence: what to do, by what stands out most."""
    worst = max(checks.values(), key=lambda check: VERDICTS.index(check.verdict))
    if worst.verdict == "good":
        return "Wear it."
    if known.pivot_distance_mm > FAR_PIVOT_MM:
        where = f"the joint {known.pivot_bone} lies {known.pivot_distance_mm:.0f} mm from where bodies have it"
        return f"Look at the rig: {where}; cloth turns about it."
    if not 1 / FAR_LENGTH < known.longest_ratio < FAR_LENGTH:
        return (
            f"Expect creases at {known.longest_bone}: it is {known.longest_ratio:.2f} times as long as on known bodies."
        )
    if known.shape_deviation > FAR_SHAPE or known.skin_distance_mm > FAR_SKIN_MM:
        return (
            f"Train the garment on this body, or take an avatar of more usual shape: it is {known.shape_deviation:.1f} "
            f"standard deviations and {known.skin_distance_mm:.0f} mm from known bodies."
        )
    if overlap_percent > MUCH_OVERLAP:
        return (
            f"Widen the arms in your motion, or separate limbs: {overlap_percent:.0f} % of the skin is inside the body "
            "in everyday poses."
        )
    if not worst.rest.sits_well:
        return "Hide the skin that the garment covers, as engines can: some cloth is under it."
    return "Wear it: cloth is under the skin in some poses only."


def _report(avatar: Avatar, checks: dict[str, GarmentCheck], known: Likeness, overlap: float) -> dict:
    """Of several garments the worst figures, and each by name."""
    garments = {name: check.as_plain_data() for name, check in checks.items()}
    first = next(iter(garments.values()))

    def worst(when: str) -> dict[str, float]:
        return {key: max(each[when][key] for each in garments.values()) for key in first[when]}

    return {
        "avatar": avatar.source,
        "warnings": list(avatar.warnings),
        "rest": worst("rest"),
        "everyday": worst("everyday"),
        "skin_shows_percent": max(each["skin_shows_percent"] for each in garments.values()),
        "verdict": max((check.verdict for check in checks.values()), key=VERDICTS.index),
        "advice": advice(checks, known, overlap),
        "likeness": asdict(known),
        "body_overlap_percent": overlap,
        "garments": garments,
    }


def _print(report: dict, avatar: Avatar) -> None:
    print_warnings(avatar.warnings)  # how garments sit is in the report
    for name, found in report["garments"].items():
        rest, everyday = found["rest"], found["everyday"]
        print(f"{name}: {found['verdict']}")
        print(
            f"  at rest   {rest['inside_percent']:.2f} % of the cloth inside the body, {rest['deepest_mm']:.0f} mm deep"
        )
        print(f"            {found['skin_shows_percent']:.2f} % of the skin shows")
        print(
            f"  everyday  {everyday['inside_percent']:.2f} % inside, {everyday['deepest_mm']:.0f} mm deep, "
            f"{everyday['edge_strain_percent']:.1f} % strain"
        )
    known = report["likeness"]
    print(
        f"body: {known['shape_deviation']:.1f} standard deviations and {known['skin_distance_mm']:.0f} mm of skin from "
        f"known bodies; {known['longest_bone']} {known['longest_ratio']:.2f} times as long; {known['pivot_bone']} "
        f"{known['pivot_distance_mm']:.0f} mm away; {report['body_overlap_percent']:.1f} % of the skin inside the body"
    )
    print(f"{report['verdict']}: {report['advice']}")


def _draw(path: Path, drapers: list[Draper]) -> None:
    """All garments at rest, from four sides: a row each."""
    from physkin_core.picture import CLOTH_COLOUR, Mesh, render, save_png

    rows = []
    for draper in drapers:
        cloth = draper.drape(draper.model.rig.rest, UPRIGHT_GRAVITY)[:, :3]
        meshes = [Mesh(draper.avatar.vertices, draper.avatar.faces), Mesh(cloth, draper.faces, CLOTH_COLOUR)]
        rows.append(np.concatenate([render(meshes, size=PICTURE_SIZE, azimuth=turn) for turn in TURNS], axis=1))
    save_png(path, np.concatenate(rows, axis=0))
