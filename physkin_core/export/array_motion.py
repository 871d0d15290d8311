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

    names, count = [layer.name for layer in outfit.layers], motion.frame_count
    said = {"garments": names, "joint_names": outfit.joint_names, "motion": motion.name, "rate_hz": motion.rate_hz}
    group = zarr.open_group(path, mode="w", attributes=said)
    joints, times, root = motion.positions_for(outfit.rig), motion.times, motion.root
    small = {"joint_positions": joints, "time": times, "root": root}
    arrays, chunks, halves, clouds = [], [], [], []
    for layer in outfit.layers:
        small |= {f"{layer.name}/faces": layer.faces, f"{layer.name}/vertex_ids": layer.visible}
        clouds.append(np.empty((len(layer.visible), 6), dtype=np.float32))
        halves += list(clouds[-1].view(POINT).T)
        for name in ("positions", "normals"):
            chunk = np.empty((min(FRAMES, count), len(layer.visible), 3), dtype=np.float32)
            whole = {"shape": (count, *chunk.shape[1:]), "chunks": chunk.shape, "dtype": chunk.dtype}
            settings = {"compressors": None, "config": {"write_empty_chunks": True}}  # to look for these takes time
            arrays.append(group.create_array(f"{layer.name}/{name}", **whole, **settings))
            chunks.append(chunk)
    for name, values in small.items():
        group.create_array(name, data=values, chunks=values.shape, compressors=None)
    outfit.reset()
    for frame, (pose, time, place) in enumerate(zip(joints, times, root)):
        outfit.drape(pose, time=time, root=place, outs=clouds)
        row = frame % FRAMES
        for chunk, half in zip(chunks, halves):
            chunk[row].view(POINT)[:, 0] = half
        if row == FRAMES - 1 or frame == count - 1:
            for array, chunk in zip(arrays, chunks):
                array[frame - row : frame + 1] = chunk[: row + 1]
    return []
