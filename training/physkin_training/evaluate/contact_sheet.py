"""A contact sheet of a garment model: poses x three held-out bodies, the model beside the full-space minimum.

`physkin contact-sheet MODEL -o PNG`. Half the poses are uniform in the joint limits, half are frames of the shipped
clips, turned so that gravity points down; or all are frames of clips that were named. Each cell's caption gives its
edge strain.
Dimensions: `P` pairs, `B` samples of a batch, `n` garment vertices, `V` body vertices.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.motion.motion import Motion, upright_orientation
from physkin_core.output_file import check_folder
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, contact_sheet, render, save_png
from physkin_core.progress import progress_line
from physkin_core.quality import edge_strain
from physkin_core.rig.rig import Rig
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.sampling.chosen_bodies import bodies_by_girth
from physkin_training.sampling.evaluation_pairs import Pairs, motion_pairs, uniform_pairs

__all__ = ["Drapes", "chosen_poses", "command_parser", "drape_all", "draw_sheet"]

BODIES = ("thin", "average", "heavy")
"""The held-out ones with the least, the median and the most volume for their height squared."""
MINIMUM_COLOUR = (0.45, 0.50, 0.28)
POSES_A_ROW = 2
VIEWS = {"front": 30.0, "back": 210.0}
"""Azimuth of the camera [degrees]."""
WIDTH, CLOSE_WIDTH = 170, 320
"""Of a picture [pixels], of all of the body and of the garment."""
POSES = 12
ITERATIONS = 40
"""Of Newton's method on the way to the minimum: energy hardly falls any more, and the eye sees no difference."""
PIXELS_HIGH = 1.25
"""Height of a picture, relative to its width."""
LIGHT_PATHS = 8


@dataclass(frozen=True)
class Drapes:
    """Garment vertices (P, n, 3) [m] and edge strains (P,) [%] by row, `model` and perhaps `minimum`, and the bodies
    under them (P, V, 3) [m], in the root frame."""

    garments: dict[str, np.ndarray]
    strains: dict[str, np.ndarray]
    bodies: np.ndarray


def chosen_poses(rig: Rig, *, count: int, seed: int, motions: Sequence[Motion] = ()) -> tuple[Pairs, list[str]]:
    """`count` poses of body 0 and what to call them: half uniform over the limits, half frames of the shipped clips.

    Where clips are given, all are frames of these, evenly spread.

    Raises ValueError when there are not so many, MotionError when a clip moves none of the rig's joints.
    """
    if count < 1:
        raise ValueError(f"poses must be at least 1, got {count}")
    clips = motions or [load_motion(name) for name in bundled_motions()]
    frames = [(clip, frame) for clip in clips for frame in range(clip.frame_count)]
    if motions:
        if count > len(frames):
            raise ValueError(f"poses must be at most {len(frames)}, the frames of the clips, got {count}")
        parts, names = [], []
        indices = np.floor((np.arange(count) + 0.5) * len(frames) / count).astype(int)
    else:
        uniform = count - count // 2
        parts = [uniform_pairs(rig, bodies=1, poses=uniform, seed=seed, upright=True)]
        names = [f"uniform {k}" for k in range(1, uniform + 1)]
        indices = np.sort(np.random.default_rng(seed).choice(len(frames), count - uniform, replace=False))
    for index in indices:
        clip, frame = frames[index]
        parts.append(motion_pairs(clip, rig, bodies=1)[torch.tensor([frame])])
        names.append(f"{clip.name} {frame}")
    return Pairs.joined(parts), names


def drape_all(evaluation: Evaluation, poses: Pairs, *, minimum: bool) -> Drapes:
    """Every pose on every body of the evaluation, pose by pose. minimum: beside its full-space minimum."""
    count = len(evaluation.bodies)
    pairs = poses[torch.arange(len(poses)).repeat_interleave(count)]
    pairs = replace(pairs, body=torch.arange(count).repeat(len(poses)))
    rows = ["model", "minimum"] if minimum else ["model"]
    garments: dict[str, list] = {row: [] for row in rows}
    strains: dict[str, list] = {row: [] for row in rows}
    bodies = []
    for batch in evaluation.batches(pairs):
        bodies.append(evaluation.posed_bodies.vertices[: batch.count].cpu().numpy())
        with torch.no_grad():
            drapes = {"model": evaluation.own_drape(batch)}
        if minimum:
            drapes["minimum"] = evaluation.full_space_minimum(drapes["model"], batch, iterations=ITERATIONS).vertices
        for row, vertices in drapes.items():
            garments[row].append(vertices[: batch.count].cpu().numpy())
            strains[row] += [
                float(edge_strain(evaluation.rest_garment(body), x))
                for body, x in zip(batch.body.tolist(), garments[row][-1])
            ]
    return Drapes(
        {row: np.concatenate(parts) for row, parts in garments.items()},
        {row: np.array(values) for row, values in strains.items()},
        np.concatenate(bodies),
    )


def draw_sheet(
    model: GarmentModel,
    device: torch.device,
    *,
    poses: int,
    minimum: bool = False,
    motions: Sequence[Motion] = (),
    close: bool = False,
) -> np.ndarray:
    """The sheet (H, W, 3) uint8 of so many poses on three bodies, drapes beside each other. motions: see
    `chosen_poses`. close: the garment fills the pictures, from both sides. Raises PictureError without the [view]
    extra."""
    bodies = bodies_by_girth(load_body_model(), len(BODIES))
    evaluation = Evaluation(model, device, bodies=bodies, poses=poses, seed=0)
    pairs, names = chosen_poses(model.rig, count=poses, seed=0, motions=motions)
    drapes = _stood(drape_all(evaluation, pairs, minimum=minimum), pairs.gravity.repeat_interleave(len(bodies), dim=0))
    pictures, texts = [], []
    for pair, (name, body_name) in enumerate(product(names, BODIES)):
        cloths = {row: vertices[pair] for row, vertices in drapes.garments.items()}
        shown = np.concatenate([*cloths.values()] if close else [drapes.bodies[pair], *cloths.values()])
        for view in VIEWS if close else ["front"]:
            for row, cloth in cloths.items():
                pictures.append(_picture(model, drapes.bodies[pair], cloth, shown, row=row, view=view, close=close))
                of = f"{name}, {body_name}" if row == "model" else row
                texts.append(f"{of} {drapes.strains[row][pair]:.1f} %")
    columns = len(drapes.garments) * (len(VIEWS) if close else POSES_A_ROW * len(BODIES))
    return contact_sheet(pictures, columns=columns, captions=texts, gap=4)


def _stood(drapes: Drapes, gravity: torch.Tensor) -> Drapes:
    """Turned so that gravity (P, 3) points down."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(upright_orientation(gravity.numpy())).inv().as_matrix()
    garments = {row: vertices @ turns for row, vertices in drapes.garments.items()}
    return replace(drapes, garments=garments, bodies=drapes.bodies @ turns)


def _picture(
    model: GarmentModel,
    body: np.ndarray,
    cloth: np.ndarray,
    shown: np.ndarray,
    *,
    row: str = "model",
    view: str = "front",
    close: bool,
) -> np.ndarray:
    """A drape (n, 3) on its body (V, 3), from where all points `shown` (k, 3) are in the picture."""
    colour = CLOTH_COLOUR if row == "model" else MINIMUM_COLOUR
    width = CLOSE_WIDTH if close else WIDTH
    return render(
        [Mesh(body, load_body_model().faces), Mesh(cloth, model.garment.faces, colour)],
        size=(width, round(PIXELS_HIGH * width)),
        azimuth=VIEWS[view],
        bounds=np.stack([shown.min(axis=0), shown.max(axis=0)]),
        samples=LIGHT_PATHS,
    )


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin contact-sheet`."""
    parser = argparse.ArgumentParser(prog="physkin contact-sheet", description=__doc__.splitlines()[0])
    parser.add_argument("model", help="garment model file, or the name of a shipped one")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PNG", help="picture to write")
    parser.add_argument(
        "--poses", type=int, default=POSES, help="poses on each of the three bodies (default %(default)s)"
    )
    parser.add_argument(
        "--motion",
        nargs="+",
        metavar="CLIP",
        help="shipped clips, motion files or bags to take all poses from (default: half of the poses are random)",
    )
    parser.add_argument(
        "--close", action="store_true", help="fill the pictures with the garment, from the front and the back"
    )
    parser.add_argument(
        "--minimum", action="store_true", help="draw the full-space minimum beside the model (minutes on a CPU)"
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command line: `physkin contact-sheet MODEL -o PNG`. Raises ValueError, OSError or PictureError."""
    arguments = command_parser().parse_args(argv)
    if arguments.output.suffix.lower() != ".png":
        raise ValueError(f"cannot write {arguments.output}: the name must end in .png")
    check_folder(arguments.output)
    model, device = load_garment_model(arguments.model), resolve_device(arguments.device)
    motions = [load_motion(name, watch=progress_line(f"reading {name}")) for name in arguments.motion or ()]
    given = {name: getattr(arguments, name) for name in ("poses", "minimum", "close")}
    save_png(arguments.output, draw_sheet(model, device, motions=motions, **given))
    print(f"wrote {arguments.output}")
    return 0
