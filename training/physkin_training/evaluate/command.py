"""`physkin evaluate`: measure a garment model, or outfits, on bodies that training has not seen."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.motion.motion import Motion
from physkin_core.output_file import check_folder
from physkin_core.progress import progress_line
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.evaluate.evaluate import evaluate_model
from physkin_training.evaluate.outfit_evaluation import evaluate_outfits, parse_outfit
from physkin_training.evaluate.score_table import dynamics_table, outfit_table, table

__all__ = ["command_parser", "main"]

OF_A_MODEL = {"bodies": 16, "poses": 256, "minimum": 0, "save_model": None}
OF_OUTFITS = {"bodies": 3}
"""Options and their defaults."""


def main(argv: list[str] | None = None) -> int:
    """Command line: `physkin evaluate MODEL`, `physkin evaluate --outfit GARMENT,GARMENT`. Raises ValueError or OSError
    for bad input."""
    arguments = command_parser().parse_args(argv)
    score = _score_dynamics if arguments.dynamic else _score_outfits if arguments.outfit else _score_model
    if arguments.json:
        check_folder(arguments.json)
    scores = score(arguments)
    if arguments.json:
        arguments.json.write_text(json.dumps(scores, indent=1))
    return 0


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin evaluate`."""
    parser = argparse.ArgumentParser(prog="physkin evaluate", description=__doc__.split("`: ", 1)[1])
    parser.add_argument("model", nargs="?", help="garment model file, or the name of a shipped one")
    parser.add_argument(
        "--outfit",
        action="append",
        metavar="GARMENT,GARMENT",
        help="outfit to measure instead of a model, from the skin outwards: trousers,tshirt or tshirt:tucked,trousers. "
        "Repeat it for several",
    )
    parser.add_argument(
        "--bodies", type=int, help="held-out bodies to measure on (default 16; for outfits 3, from lean to stout)"
    )
    parser.add_argument("--poses", type=int, help="random poses of each body (default 256)")
    parser.add_argument(
        "--motion",
        nargs="*",
        default=bundled_motions(),
        metavar="CLIP",
        help="shipped clips, motion files or bags to measure on as well (default: all shipped clips; no CLIP: none)",
    )
    parser.add_argument(
        "--minimum",
        type=int,
        metavar="PAIRS",
        help="also minimise the energy of that many pairs of a body and a pose, for comparison",
    )
    parser.add_argument(
        "--dynamic",
        type=Path,
        metavar="REFERENCES",
        help="instead compare cloth in motion with what `physkin simulate GARMENT --dynamic` wrote to this folder",
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--save-model", type=Path, metavar="FILE", help="write the model with its scores there")
    return parser


def _options(arguments: argparse.Namespace) -> dict:
    """Options of what is measured, by name. Raises ValueError where they do not go together."""
    if bool(arguments.model) == bool(arguments.outfit):
        raise ValueError("give one of MODEL and --outfit GARMENT,GARMENT")
    known = OF_OUTFITS if arguments.outfit else OF_A_MODEL
    for name in OF_A_MODEL.keys() - known.keys():
        if getattr(arguments, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} is an option of MODEL, not of --outfit")
    given = {name: getattr(arguments, name) for name in known}
    return {name: known[name] if value is None else value for name, value in given.items()}


def _motions(arguments: argparse.Namespace) -> list[Motion]:
    return [load_motion(clip, watch=progress_line(f"reading {clip}")) for clip in arguments.motion]


def _score_dynamics(arguments: argparse.Namespace) -> dict:
    from physkin_training.evaluate.dynamic_evaluation import evaluate_dynamics, references_of

    if not arguments.model or arguments.outfit:
        raise ValueError("cloth in motion is measured of one garment: physkin evaluate GARMENT --dynamic FOLDER")
    model = load_garment_model(arguments.model)
    scores = evaluate_dynamics(model, references_of(model.name, arguments.dynamic))
    print(dynamics_table(scores))
    return scores


def _score_model(arguments: argparse.Namespace) -> dict:
    options, motions = _options(arguments), _motions(arguments)
    model, store = load_garment_model(arguments.model), options.pop("save_model")
    scores = evaluate_model(model, resolve_device(arguments.device), **options, motions=motions)
    print(table(scores))
    if store:
        save_garment_model(replace(model, scores=scores), store)
    return scores


def _score_outfits(arguments: argparse.Namespace) -> dict:
    options, motions = _options(arguments), _motions(arguments)
    outfits = {}
    for text in arguments.outfit:
        if text in outfits:
            raise ValueError(f"--outfit {text} is given twice")
        outfits[text] = parse_outfit(text)
    scores = evaluate_outfits(outfits, motions, **options)
    print(outfit_table(scores))
    return scores
