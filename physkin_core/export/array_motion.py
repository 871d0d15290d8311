"""A draped motion as arrays in a Zarr folder, for data sets: every vertex in every frame (extra `[cluster]`).

Chunks of `FRAMES` frames are not compressed: that would take longer than draping, and make a fifth less of them.
Dimensions: `T` frames, `d` degrees of freedom, `v` vertices of a garment that are given, `f` faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from physkin_core.mesh.look import Look
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit

__all__ = ["write_array_motion"]

FRAMES = 64
"""Of a chunk: 4.5 MB of a T-shirt."""
POINT = np.dtype((np.void, 12))
"""Three float32, which are copied as one."""


def write_array_motion(path: Path, outfit: Outfit, motion: Motion, *, looks: Sequence[Look | None] = ()) -> list[str]:
    """Write a motion as a Zarr group (format 3). Returns sentences on what it lacks: none. looks: are not written.

    joint_positions: (T, d) [rad]. root: (T, 7) in the world, x, y, z [m] and a quaternion x, y, z, w. time: (T,) [s].
    Of each garment a group of its name. positions: (T, v, 3) [m] in the root frame. normals: (T, v, 3), unit. faces:
    (f, 3) of these vertices. vertex_ids: (v,) of them in the garment's own mesh. Attributes: joint_names, rate_hz,
    motion, garments (from the skin outwards). The same motion gives the same bytes.
    Raises ModuleNotFoundError without zarr, OSError when it cannot be written.
    """
    import zarr

    names, count, rig = [layer.name for layer in outfit.layers], motion.frame_count, outfit.rig
    said = {"garments": names, "joint_names": rig.joint_names, "motion": motion.name, "rate_hz": motion.rate_hz}
    group = zarr.open_group(path, mode="w", attributes=said)
    length = -(-count // -(-count // FRAMES))  # chunks are all as long, so that little of the last is empty
    joints, times, root = motion.positions_for(rig), motion.times, motion.root
    whole = {"joint_positions": joints, "time": times, "root": root}
    chunks, halves, clouds = {}, [], []
    for layer in outfit.layers:
        whole |= {f"{layer.name}/faces": layer.faces, f"{layer.name}/vertex_ids": layer.visible}
        clouds.append(np.empty((len(layer.visible), 6), dtype=np.float32))
        halves += list(clouds[-1].view(POINT).T)
        for name in ("positions", "normals"):
            chunks[f"{layer.name}/{name}"] = np.zeros((length, len(layer.visible), 3), dtype=np.float32)
    for name, values in (whole | chunks).items():
        shape = (count, *values.shape[1:]) if name in chunks else values.shape
        settings = {"chunks": values.shape, "dtype": values.dtype, "compressors": None}
        group.create_array(name, shape=shape, chunk_key_encoding={"name": "default", "separator": "."}, **settings)
        if name in whole:
            _write_chunk(path / name, 0, values)
    outfit.reset()
    for frame, (pose, time, place) in enumerate(zip(joints, times, root)):
        outfit.drape(pose, time=time, root=place, outs=clouds)
        number, row = divmod(frame, length)
        for chunk, half in zip(chunks.values(), halves):
            chunk[row].view(POINT)[:, 0] = half
        if row == length - 1 or frame == count - 1:
            for name, chunk in chunks.items():
                chunk[row + 1 :] = 0
                _write_chunk(path / name, number, chunk)
    return []


def _write_chunk(array: Path, number: int, values: np.ndarray) -> None:
    """Write part of an array that is cut along its first axis, as format 3 has it where nothing is compressed. zarr
    copies it first, which takes longer than all else here but the draping."""
    file = array / ".".join(["c", str(number), *["0"] * (values.ndim - 1)])
    file.write_bytes(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")))
