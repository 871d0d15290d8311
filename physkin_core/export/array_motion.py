"""A draped motion as arrays in a Zarr folder, for data sets: every vertex in every frame.

Chunks of `FRAMES` frames are plain memory: to compress them takes longer than draping, and makes a fifth less of them.
Dimensions: `T` frames, `d` degrees of freedom, `v` vertices of a garment that are given, `f` faces.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from mmap import PAGESIZE, mmap
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
HEADER = "zarr.json"
DIRECT = getattr(os, "O_DIRECT", 0)
"""Past the system's cache: nobody reads soon what is written, and to copy it into memory that was not in use takes up
to two thirds of the time of draping it."""
MEMORY: WeakKeyDictionary[Outfit, list[list[np.ndarray]]] = WeakKeyDictionary()
"""Two chunks of each array of points, of outfits that are draped again: fresh memory takes a tenth of the time."""


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
    joints, times, root = motion.positions_for(rig), motion.times, motion.root
    _describe(path, garments=names, joint_names=rig.joint_names, motion=motion.name, rate_hz=motion.rate_hz)
    whole = {"joint_positions": joints, "time": times, "root": root}
    for layer in outfit.layers:
        _describe(path / layer.name)
        whole |= {f"{layer.name}/faces": layer.faces, f"{layer.name}/vertex_ids": layer.visible}
    for name, values in whole.items():
        _describe(path / name, values, len(values))
        (path / name / ".".join("c" + "0" * values.ndim)).write_bytes(np.ascontiguousarray(values))
    clouds = [np.empty((len(layer.visible), 6), dtype=np.float32) for layer in outfit.layers]
    halves = [half for cloud in clouds for half in (cloud.T[:3], cloud.T[3:])]
    if outfit not in MEMORY:
        pages = [(FRAMES * half.size * 4 // PAGESIZE + 1) * PAGESIZE for half in halves]
        MEMORY[outfit] = [[np.frombuffer(mmap(-1, size), dtype=np.float32) for size in pages] for _ in range(2)]
    length = -(-count // -(-count // FRAMES))  # chunks are all as long, so that little of the last is empty
    chunks = [
        [memory[: length * half.size].reshape(length, half.shape[1], 3) for memory, half in zip(each, halves)]
        for each in MEMORY[outfit]
    ]
    folders = [path / name / values for name in names for values in ("positions", "normals")]
    for folder, chunk in zip(folders, chunks[0]):
        _describe(folder, chunk, count)
    outfit.reset()
    written: Iterator[None] = iter(())
    with ThreadPoolExecutor(1) as writer:  # the next chunk is draped meanwhile
        for number, start in enumerate(range(0, count, length)):
            current = chunks[number % 2]
            for row, frame in enumerate(range(start, min(start + length, count))):
                outfit.drape(joints[frame], time=times[frame], root=root[frame], outs=clouds)
                for chunk, half in zip(current, halves):
                    for axis in range(3):  # thrice as fast as all three at once
                        chunk[row, :, axis] = half[axis]
            for chunk in current:
                chunk[row + 1 :] = 0
            list(written)  # raises what writing has raised
            files = (folder / f"c.{number}.0.0" for folder in folders)
            written = writer.map(_write, files, current, MEMORY[outfit][number % 2])
        list(written)
    return []


def _describe(folder: Path, chunk: np.ndarray | None = None, count: int = 0, **attributes: Any) -> None:
    """Make a group as format 3 has it, or an array of `count` rows in chunks like one."""
    folder.mkdir(parents=True)
    said = {"zarr_format": 3, "node_type": "group", "attributes": attributes}
    if chunk is not None:
        sizes = [max(1, size) for size in chunk.shape]
        said |= {"node_type": "array", "shape": (count, *chunk.shape[1:]), "data_type": chunk.dtype.name}
        said |= {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": sizes}}, "fill_value": 0}
        said |= {"chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}}}
        said |= {"codecs": [{"name": "bytes", "configuration": {"endian": sys.byteorder}}]}
    (folder / HEADER).write_text(json.dumps(said), encoding="utf-8")


def _write(file: Path, values: np.ndarray, memory: np.ndarray) -> None:
    """Write values that begin some pages of memory, directly where the file system can."""
    pages = memoryview(memory).cast("B")[: -(-values.nbytes // PAGESIZE) * PAGESIZE]
    try:
        with open(file, "wb", buffering=0, opener=lambda name, flags: os.open(name, flags | DIRECT, 0o666)) as out:
            if out.write(pages) == len(pages):
                out.truncate(values.nbytes)
                return
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    file.write_bytes(values)
