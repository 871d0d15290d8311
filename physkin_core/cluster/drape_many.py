"""`physkin drape-many`: drape many motions on many avatars, on a Ray cluster, and write a file for each.

Rows are from a table, or from folders of avatars and motions that are crossed.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
from collections.abc import Iterable, Mapping
from functools import cache, partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

from physkin_core.avatar.loading import GLTF_SUFFIXES, MESH_SUFFIXES
from physkin_core.cluster.cluster import FolderRow, Outcome, add_address, do_folder_rows
from physkin_core.export.export import WRITERS, dressed_for
from physkin_core.file_reading import ContentError, digest_of, read_text, reading
from physkin_core.model.model_file import MODELS_PATH, split_fabric
from physkin_core.motion.clip_files import CLIP_SUFFIXES, split_clip_name
from physkin_core.motion.landmark_files import LANDMARK_SUFFIXES
from physkin_core.motion.loading import BAG_SUFFIXES, MOTIONS_DIRECTORY, bundled_motions
from physkin_core.outfit.outfit_options import (
    OPTIONS,
    add_options,
    add_outfit_options,
    as_asked,
    as_option,
    read_motion,
)

__all__ = ["JobsError", "command_parser", "crossed", "main", "read_table", "rows_of"]

PAGE = "drape-many.html"
WORN = ("avatar", "rig", "bones", "own_clothes", "garment", "tucked", "fit")
"""What a binding depends on."""
COLUMNS = ("name", "avatar", "motion", *OPTIONS)
AVATARS, MOTIONS = GLTF_SUFFIXES + MESH_SUFFIXES, (".safetensors", *CLIP_SUFFIXES, *LANDMARK_SUFFIXES, *BAG_SUFFIXES)
BESIDE = (".bones.json", ".rig.json", ".bin")
"""Endings of files that are read with one of the same name."""

Table = Iterable[tuple[str, Mapping[str, Any]]]
"""Of each row where it is, and its values by column."""
KEPT: dict[Any, Any] = {}
"""In a worker, what the last row wore, by what it shared with others."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin drape-many`."""
    parser = argparse.ArgumentParser(prog="physkin drape-many", description=__doc__.split("`: ")[1].splitlines()[0])
    said = "table of rows, .csv or .jsonl, with the columns avatar, motion, name and options of this command"
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("jobs", nargs="?", type=Path, metavar="JOBS", help=said)
    given.add_argument("--motions", type=Path, metavar="FOLDER", help="instead: all motions of a folder")
    parser.add_argument("--avatars", type=Path, metavar="FOLDER", help="with --motions: on all avatars of a folder")
    add_outfit_options(parser)
    add_options(parser, "source-rate", "rate", "separate-limbs", "sway", "wind")
    parser.set_defaults(materials=[])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for the results")
    kinds = [kind[1:] for kind in WRITERS]
    parser.add_argument("--format", choices=kinds, default="zarr", help="of results (default %(default)s: arrays)")
    add_address(parser, "the one on this machine, which is started if need be")
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0; 1 when a row failed. Raises ValueError or OSError for bad input."""
    options = command_parser().parse_args(argv)
    kind = f".{options.format}"
    if options.jobs and options.avatars:
        raise JobsError(f"--avatars {options.avatars} goes with --motions; the table {options.jobs} names its avatars")
    table = read_table(options.jobs) if options.jobs else crossed(options.avatars, options.motions)
    rows = rows_of(table, options, kind)
    return do_folder_rows(rows, partial(_drape, kind), options.output / PAGE, _frames, address=options.address)


def _frames(outcomes: Mapping[str, Outcome], refresh: int) -> str:
    return f"<p>{sum(each.result['frames'] for each in outcomes.values() if each.result):,} frames.</p>"


def _drape(kind: str, row: FolderRow, folder: Path) -> dict[str, Any]:
    """Drape a row into a folder. Raises as what reads and writes does."""
    motion = read_motion(row.order)
    if row.shares not in KEPT:
        KEPT.clear()
        KEPT[row.shares] = dressed_for(kind, row.order)
    outfit, looks = KEPT[row.shares]
    outfit.sway, outfit.wind = row.order.sway, row.order.wind
    outfit.reset()
    motion = as_asked(motion, row.order, outfit)
    lacking = WRITERS[kind](folder / f"{row.name}{kind}", outfit, motion, looks=looks)
    of_whom = {"avatar": str(row.order.avatar), "motion": row.order.motion}
    return of_whom | {"frames": motion.frame_count, "rate_hz": motion.rate_hz, "warnings": [*outfit.warnings, *lacking]}


class JobsError(ValueError):
    """A table or folder of jobs is not readable, or a row of it is not possible."""


def read_table(path: Path) -> Table:
    """Rows of a .csv with a header, or a .jsonl with an object a line. Raises JobsError for what is neither, a table
    without rows, and a row that is longer than the header."""
    if (kind := path.suffix.lower()) not in (".csv", ".jsonl"):
        raise JobsError(f"{path}: the extension {kind!r} is unknown; allowed: .csv, .jsonl")
    with reading(f"table {path}", JobsError):
        lines = read_text(path).splitlines()
        rows = list(csv.DictReader(lines) if kind == ".csv" else map(json.loads, filter(str.strip, lines)))
        for number, row in enumerate(rows, 1):
            if not isinstance(row, dict) or None in row:
                raise ContentError(f"row {number} is no object, or longer than the header")
        if not rows:
            raise ContentError(f"it has no rows; allowed columns: {', '.join(COLUMNS)}")
    return [(f"{path}, row {number}", row) for number, row in enumerate(rows, 1)]


def crossed(avatars: Path | None, motions: Path) -> Table:
    """A row for each motion in a folder and its folders, on each avatar of another. avatars: None for that of the
    command line. Raises JobsError where a folder has none."""
    bodies = _files("--avatars", avatars, AVATARS) if avatars else [("", None)]
    for (name, avatar), (clip_name, clip) in product(bodies, _files("--motions", motions, MOTIONS)):
        yield str(clip), {"name": "-".join(filter(None, (name, clip_name))), "avatar": avatar, "motion": clip}


def _files(option: str, folder: Path, suffixes: tuple[str, ...]) -> list[tuple[str, Path]]:
    """Names and paths."""
    found = (path for path in sorted(folder.rglob("*")) if path.suffix.lower() in suffixes and path.is_file())
    if not (files := [path for path in found if not path.name.endswith(BESIDE)]):
        raise JobsError(f"{option} {folder}: no such folder, or no such files in it; allowed: {', '.join(suffixes)}")
    return [(path.relative_to(folder).with_suffix("").as_posix().replace("/", "-"), path) for path in files]


def rows_of(table: Table, defaults: argparse.Namespace, kind: str) -> list[FolderRow]:
    """Rows as they are done. A value of the table goes before the command line's.

    defaults: as of `command_parser`. kind: suffix of what is written. Raises JobsError naming row and value, for an
    unknown column, a value that is not allowed, a row without motion, and a name that is taken or no folder's.
    """
    rows: dict[str, tuple[str, FolderRow]] = {}
    for place, cells in table:
        try:
            row = _row(cells, defaults, kind)
            if other := rows.get(row.name.casefold()):
                raise ValueError(f"{other[0]} is called {row.name!r}, too; give each its own in the column name")
        except ValueError as error:
            raise JobsError(f"{place}: {error}") from error
        rows[row.name.casefold()] = place, row
    return [row for _, row in rows.values()]


def _row(cells: Mapping[str, Any], defaults: argparse.Namespace, kind: str) -> FolderRow:
    options = argparse.Namespace(**{"motion": None, "name": None} | vars(defaults))
    for column, value in cells.items():
        if column not in COLUMNS:
            raise ValueError(f"unknown column {column!r}; allowed: {', '.join(COLUMNS)}")
        if value not in (None, ""):
            setattr(options, column.replace("-", "_"), as_option(column, value))
    if options.motion is None:
        raise ValueError(f"it has no motion; give a file or one of {', '.join(bundled_motions())}")
    file, clip = split_clip_name(options.motion)
    stem = "-".join(filter(None, (Path(options.avatar).stem, file.stem, re.sub(r"[^\w.]+", "_", clip))))
    if not re.fullmatch(r"[^./\\\0][^/\\\0]*", name := options.name or stem):
        raise ValueError(f"name {name!r} is no folder's; allowed: no slash, and no dot at first")
    files = [options.avatar, options.motion, *(options.garment or ()), options.rig, options.bones]
    chosen = {option: str(getattr(options, option.replace("-", "_"))) for option in OPTIONS}
    digests = [_digest(str(file)) for file in files if file]
    settings = chosen | {"kind": kind, "physkin": version("physkin"), "sha256": digests}
    return FolderRow(name, options, settings, shares=tuple(str(getattr(options, field)) for field in WORN))


@cache
def _digest(name: str) -> str:
    """Of a file, of all in a folder, or of what is shipped, and of what is read with it; empty where there is none."""
    path, _ = split_clip_name(split_fabric(name)[0])
    shipped = [folder / f"{path}.safetensors" for folder in (MODELS_PATH, MOTIONS_DIRECTORY)]
    beside = [path.with_suffix(ending) for ending in BESIDE]
    return digest_of([path, *sorted(path.rglob("*")), *beside, *shipped])
