"""A draped motion as arrays in a Zarr folder, for data sets: every vertex in every frame.

Chunks of `FRAMES` frames are plain memory: to compress them takes longer than draping, and makes a fifth less of them.
Dimensions: `T` frames, `d` degrees of freedom, `v` vertices of a garment that are given, `f` faces.
"""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from physkin_core.mesh.look import Look
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit

__all__ = ["write_array_motion"]

FRAMES = 64
"""Of a chunk: 4.5 MB of a T-shirt."""
PAGE = 4096
"""[bytes] Disks take whole pages directly from memory."""
HEADER = "zarr.json"
KEPT: WeakKeyDictionary[Outfit, list[list[np.ndarray]]] = WeakKeyDictionary()
"""Memory for chunks, of outfits that are draped again."""


def write_array_motion(path: Path, outfit: Outfit, motion: Motion, *, looks: Sequence[Look | None] = ()) -> list[str]:
    """Write a motion as a Zarr group (format 3). Returns sentences on what it lacks: none. looks: are not written.

    joint_positions: (T, d) [rad]. root: (T, 7) in the world, x, y, z [m] and a quaternion x, y, z, w. time: (T,) [s].
    Of each garment a group of its name. positions: (T, v, 3) [m] in the root frame. normals: (T, v, 3), unit. faces:
    (f, 3) of these vertices. vertex_ids: (v,) of them in the garment's own mesh. Attributes: joint_names, rate_hz,
    motion, garments (from the skin outwards). The same motion gives the same bytes.
    Raises OSError when it cannot be written, FileExistsError where the path is anything but such a group.
    """
    if path.exists() and not (path / HEADER).is_file():
        raise FileExistsError(f"cannot write {path}: it is there, and no Zarr folder; give another name")
    shutil.rmtree(path, ignore_errors=True)
    names, count, rig = [layer.name for layer in outfit.layers], motion.frame_count, outfit.rig
    length = -(-count // -(-count // FRAMES))  # chunks are all as long, so that little of the last is empty
    said = {"garments": names, "joint_names": rig.joint_names, "motion": motion.name, "rate_hz": motion.rate_hz}
    joints, times, root = motion.positions_for(rig), motion.times, motion.root
    _describe(path, "group", attributes=said)
    whole = {"joint_positions": joints, "time": times, "root": root}
    clouds, parts, files, chunks = [], [], [], []
    for layer in outfit.layers:
        _describe(path / layer.name, "group")
        whole |= {f"{layer.name}/faces": layer.faces, f"{layer.name}/vertex_ids": layer.visible}
        clouds.append(np.empty((len(layer.visible), 6), dtype=np.float32))
        for name, axes in (("positions", clouds[-1].T[:3]), ("normals", clouds[-1].T[3:])):
            parts.append(axes)
            chunk = (length, len(layer.visible), 3)
            files.append(_add_array(path / layer.name / name, (count, *chunk[1:]), np.float32, chunk))
            chunks.append(chunk)
    for name, values in whole.items():
        _add_array(path / name, values.shape, values.dtype, values.shape).write_bytes(np.ascontiguousarray(values))
    outfit.reset()
    written, memory = iter(()), _memory(outfit)
    with ThreadPoolExecutor(1) as writer:  # the next chunk is draped meanwhile
        for number, start in enumerate(range(0, count, length)):
            filled = [pages[: 4 * math.prod(chunk)] for pages, chunk in zip(memory[number % 2], chunks)]
            points = [each.view(np.float32).reshape(chunk) for each, chunk in zip(filled, chunks)]
            for row, frame in enumerate(range(start, min(start + length, count))):
                outfit.drape(joints[frame], time=times[frame], root=root[frame], outs=clouds)
                for chunk, axes in zip(points, parts):
                    for out, axis in zip(chunk[row].T, axes):
                        out[:] = axis
            for chunk in points:
                chunk[row + 1 :] = 0
            list(written)  # raises what writing has raised
            to = [file.with_name(f"c.{number}.0.0") for file in files]
            written = writer.map(_write, to, memory[number % 2], map(len, filled))
        list(written)
    return []


def _memory(outfit: Outfit) -> list[list[np.ndarray]]:
    """Whole pages for a chunk of each array of points, twice. They are kept, as fresh memory takes a tenth of the time
    of draping."""
    if outfit not in KEPT:
        sizes = [12 * FRAMES * len(layer.visible) + 2 * PAGE for layer in outfit.layers for _ in range(2)]
        blocks = [[np.empty(size, dtype=np.uint8) for size in sizes] for _ in range(2)]
        KEPT[outfit] = [[block[-block.ctypes.data % PAGE :] for block in half] for half in blocks]
    return KEPT[outfit]


def _describe(folder: Path, kind: str, **said: Any) -> None:
    """Make a group or an array as format 3 has it."""
    folder.mkdir(parents=True)
    text = json.dumps({"zarr_format": 3, "node_type": kind, "attributes": {}} | said)
    (folder / HEADER).write_text(text, encoding="utf-8")


def _add_array(folder: Path, shape: tuple[int, ...], dtype: np.dtype, chunk: tuple[int, ...]) -> Path:
    """Make an array without its values. Returns the file of its first chunk."""
    parts = {
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
        "codecs": [{"name": "bytes", "configuration": {"endian": sys.byteorder}}],
    }
    _describe(folder, "array", shape=shape, data_type=np.dtype(dtype).name, fill_value=0, **parts)
    return folder / ".".join(["c", *["0"] * len(shape)])


def _write(file: Path, pages: np.ndarray, size: int) -> None:
    """Write bytes that begin a page, past the system's cache where the file system can. Nobody reads them soon, and to
    copy them into memory that was not in use takes up to two thirds of the time of draping."""
    direct = getattr(os, "O_DIRECT", 0)
    try:
        with open(file, "wb", buffering=0, opener=lambda path, flags: os.open(path, flags | direct, 0o666)) as out:
            whole = -(-size // PAGE) * PAGE
            if direct and out.write(pages[:whole]) == whole:
                out.truncate(size)
                return
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    file.write_bytes(pages[:size])
