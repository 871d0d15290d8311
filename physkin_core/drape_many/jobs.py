"""Rows of `physkin drape-many`: from a table, or from folders of avatars and motions that are crossed."""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from physkin_core.avatar.loading import BUNDLED_AVATAR, GLTF_SUFFIXES, MESH_SUFFIXES
from physkin_core.cluster.rows import FolderRow
from physkin_core.file_reading import ContentError, read_text, reading
from physkin_core.model.model_file import MODELS_PATH, split_fabric
from physkin_core.motion.clip_files import CLIP_SUFFIXES, split_clip_name
from physkin_core.motion.landmark_files import LANDMARK_SUFFIXES
from physkin_core.motion.loading import BAG_SUFFIXES, bundled_motions
from physkin_core.outfit.outfit_options import ROW_OPTIONS, as_option

__all__ = ["JobsError", "crossed", "read_table", "rows_of"]

WORN = ("avatar", "rig", "bones", "own_clothes", "garment", "tucked", "fit")
"""What a binding depends on."""
COLUMNS = ("name", "avatar", "motion", *ROW_OPTIONS)
MOTIONS = (".safetensors", *CLIP_SUFFIXES, *LANDMARK_SUFFIXES, *BAG_SUFFIXES)
BESIDE = (".bones.json", ".rig.json", ".bin")
"""Endings of files that are read with one of the same name."""

Cells = Mapping[str, Any]
"""A row as it is given: column -> value."""


class JobsError(ValueError):
    """A table or folder of jobs is not readable."""


def read_table(path: Path) -> Iterator[tuple[str, Cells]]:
    """Where each row is, and its cells, of a .csv with a header or a .jsonl with an object a line; empty ones left out.

    Raises JobsError for what is neither, a table without rows, an unknown column and a value too many.
    """
    kind, count = path.suffix.lower(), 0
    if kind not in (".csv", ".jsonl"):
        raise JobsError(f"{path}: the extension {path.suffix!r} is unknown; allowed: .csv, .jsonl")
    with reading(f"table {path}", JobsError):
        lines = read_text(path).splitlines()
        table = csv.DictReader(lines) if kind == ".csv" else map(json.loads, filter(str.strip, lines))
        for count, cells in enumerate(table, 1):
            place = f"{path}, row {count}"
            if not isinstance(cells, dict) or None in cells:
                raise ContentError(f"row {count} is not {'as long as the header' * (kind == '.csv') or 'an object'}")
            if unknown := cells.keys() - set(COLUMNS):
                raise ContentError(f"row {count}: unknown column {min(unknown)!r}; allowed: {', '.join(COLUMNS)}")
            yield place, {name: value for name, value in cells.items() if value not in (None, "")}
        if not count:
            raise ContentError(f"it has no rows; give one for each motion: {', '.join(COLUMNS[1:3])}, ...")


def crossed(avatars: Path | None, motions: Path) -> Iterator[tuple[str, Cells]]:
    """A row for each motion in a folder and its folders, on each avatar; those of an avatar come together. avatars: the
    same, None for that of the command line. Raises JobsError where a folder has none."""
    wearers = _files(avatars, (*GLTF_SUFFIXES, *MESH_SUFFIXES), "--avatars") if avatars else [None]
    clips = _files(motions, MOTIONS, "--motions")
    for avatar in wearers:
        for clip in clips:
            name = clip.relative_to(motions).with_suffix("").as_posix()
            whose = {"avatar": str(avatar.resolve())} if avatar else {}
            if avatar:
                name = f"{avatar.relative_to(avatars).with_suffix('').as_posix()}/{name}"
            yield str(clip), {"name": name, "motion": str(clip.resolve()), **whose}


def rows_of(table: Iterable[tuple[str, Cells]], defaults: argparse.Namespace, base: Path, kind: str) -> list[FolderRow]:
    """Rows as they are done: a cell goes before the command line, and paths are from the folder `base`.

    defaults: as of `command_parser`. kind: suffix of what is written. Raises JobsError naming row and value, for a
    value of the wrong type, a row without motion, and names that are taken or do not stay within the output folder.
    """
    rows, taken = [], {}
    for place, cells in table:
        options = argparse.Namespace(**vars(defaults), place=place)
        for column, value in cells.items():
            try:
                setattr(options, column.replace("-", "_"), as_option(column, value))
            except ValueError as error:
                raise JobsError(f"{place}: {error}") from error
        if getattr(options, "motion", None) is None:
            raise JobsError(f"{place}: it has no motion; give a bundled one ({', '.join(bundled_motions())}) or a file")
        for column in {"avatar", "rig", "bones", "motion"} & cells.keys():
            setattr(options, column, _from(base, getattr(options, column)))
        if "garment" in cells:
            options.garment = [_from(base, name) for name in options.garment]
        name = cells.get("name") or "/".join(map(_stem, (options.avatar, options.motion)))
        parts = [part.casefold() for part in name.split("/")]
        if not all(re.fullmatch(r"[^./\\\0][^/\\\0]*", part) for part in parts):
            raise JobsError(
                f"{place}: name {name!r} is no folder in the output; allowed: a/b, no part begins with a dot"
            )
        settings = _settings(options, kind)
        rows.append(
            FolderRow(name, options, settings, json.dumps([getattr(options, field) for field in WORN], default=str))
        )
        if tuple(parts) in taken:
            raise JobsError(
                f"{place}: {taken[tuple(parts)]} is called {name!r}, too; give each its own in the column name"
            )
        taken[tuple(parts)] = place
    for parts, place in taken.items():
        for length in range(1, len(parts)):
            if parts[:length] in taken:
                raise JobsError(
                    f"{place}: {'/'.join(parts)!r} would be in the folder of {taken[parts[:length]]}; rename it"
                )
    return rows


def _files(folder: Path, suffixes: tuple[str, ...], option: str) -> list[Path]:
    found = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in suffixes and not path.name.lower().endswith(BESIDE) and path.is_file()
    )
    if not found:
        raise JobsError(f"{option} {folder}: no such folder, or nothing in it; allowed: files {', '.join(suffixes)}")
    return found


def _from(base: Path, name: str) -> str:
    """A file named in a table, from its folder on; a shipped name as it is."""
    if name in bundled_motions() or (MODELS_PATH / f"{split_fabric(name)[0]}.safetensors").exists():
        return name
    return str(base / name)


def _stem(name: str) -> str:
    """A file's name, and that of the clip in it."""
    file, clip = split_clip_name(name)
    return re.sub(r"[^\w.-]+", "_", f"{file.stem}-{clip}" if clip else file.stem)


def _settings(options: argparse.Namespace, kind: str) -> dict[str, Any]:
    """What a result depends on; files by their names and contents, wherever they are."""
    chosen = {name: getattr(options, name.replace("-", "_")) for name in ROW_OPTIONS}
    named = {"avatar": options.avatar, "motion": options.motion, "rig": options.rig, "bones": options.bones}
    garments = [split_fabric(name)[0] for name in options.garment or ()]
    files = [split_clip_name(value)[0] for value in named.values() if value] + [Path(name) for name in garments]
    shown = {name: Path(value).name if value else None for name, value in named.items()}
    digest = hashlib.sha256("".join(map(_digest, files)).encode()).hexdigest()
    settings = {"physkin": version("physkin"), "kind": kind, **chosen, **shown, "sha256": digest}
    return json.loads(json.dumps(settings))  # as it is read again


@cache
def _digest(path: Path) -> str:
    """Of a file, a folder or a shipped garment, and of what lies beside it; empty for what is not there."""
    shipped = MODELS_PATH / f"{path}.safetensors"
    beside = [path.with_suffix(ending) for ending in BESIDE] if path != BUNDLED_AVATAR else []
    inside = sorted(path.rglob("*")) if path.is_dir() else [path]
    files = [file for file in (*inside, *beside, shipped) if file.is_file()]
    return "".join(hashlib.file_digest(file.open("rb"), "sha256").hexdigest() for file in files)
