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

    group = zarr.open_group(path, mode="w", attributes=_attributes(outfit, motion))
    joints = motion.positions_for(outfit.rig)
    for name, values in (("joint_positions", joints), ("root", motion.root), ("time", motion.times)):
        group.create_array(name, data=values, chunks=values.shape, compressors=None)
    places, chunks = [], []
    for layer in outfit.layers:
        garment, (count, shape) = group.create_group(layer.name), (motion.frame_count, (len(layer.visible), 3))
        for name, values in (("faces", layer.faces), ("vertex_ids", layer.visible)):
            garment.create_array(name, data=values, chunks=values.shape, compressors=None)
        settings = {"shape": (count, *shape), "chunks": (min(FRAMES, count), *shape), "dtype": "float32"}
        for name in ("positions", "normals"):
            places.append(garment.create_array(name, **settings, compressors=None, config={"write_empty_chunks": True}))
            chunks.append(np.empty((min(FRAMES, count), *shape), dtype=np.float32))
    clouds = [np.empty((len(layer.visible), 6), dtype=np.float32) for layer in outfit.layers]
    halves = [half for cloud in clouds for half in cloud.view(POINT).T]
    targets = [chunk.view(POINT)[..., 0] for chunk in chunks]
    outfit.reset()
    for frame, (positions, time, root) in enumerate(zip(joints, motion.times, motion.root)):
        outfit.drape(positions, time=time, root=root, outs=clouds)
        place = frame % FRAMES
        for target, half in zip(targets, halves):
            target[place] = half
        if place == FRAMES - 1 or frame == motion.frame_count - 1:
            for array, chunk in zip(places, chunks):
                array[frame - place : frame + 1] = chunk[: place + 1]
    return []


def _attributes(outfit: Outfit, motion: Motion) -> dict:
    return {
        "garments": [layer.name for layer in outfit.layers],
        "joint_names": list(outfit.joint_names),
        "motion": motion.name,
        "rate_hz": motion.rate_hz,
        "units": "m, rad, s; positions are from the root, Z up",
    }
