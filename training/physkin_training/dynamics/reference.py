"""Reference sequences: what a simulated garment did in one scene on some bodies, in a small file that needs no other.

Points are a spread choice of the garment's vertices that swing, every frame; whole garments are kept now and then.
Positions are rounded to a tenth of a millimetre, angles to a ten-thousandth of a radian, and stored as changes of
changes from frame to frame.

Dimensions: `S` bodies, `T` frames, `k` points, `n` garment vertices, `d` degrees of freedom. Metres, root frames.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.motion.motion import Motion
from physkin_core.rig.rig import Rig

__all__ = ["Reference", "load_reference", "save_reference", "spread", "swinging_vertices"]

LENGTH = 1e-4
ANGLE = 1e-4


@dataclass(frozen=True)
class Reference:
    """One garment in one scene.

    garment: its name. motion: the scene. bodies: (S, c) shape coefficients. vertices: (k,) which the points are.
    points: (S, T, k, 3) float32; only the first `frames` (S,) of a body count, then the simulation lost it. energies:
    (S, T) float32 [J] by term, see `Frame`. whole_frames: (w,) of which whole garments (w, n, 3) float32 are kept, of
    body `whole_body`. described: step, air drag, relaxation and the like.
    """

    garment: str
    motion: Motion
    bodies: np.ndarray
    vertices: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    energies: dict[str, np.ndarray]
    whole_body: int
    whole_frames: np.ndarray
    whole: np.ndarray
    described: dict


def swinging_vertices(garment: Garment, rig: Rig) -> np.ndarray:
    """Vertices below the hips at rest, (k,); all where there are none."""
    hips = [k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")]
    below = np.flatnonzero(garment.vertices[:, 2] < rig.heads[hips, 2].min()) if hips else np.empty(0, dtype=int)
    return below if len(below) else np.arange(len(garment.vertices))


def spread(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most `count` of points (k, 3), each the farthest from those before it, the first the lowest."""
    chosen = [int(points[:, 2].argmin())]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(chosen)


def save_reference(reference: Reference, path: Path) -> None:
    """Write a reference (.npz)."""
    motion = reference.motion
    described = reference.described | {
        "garment": reference.garment,
        "scene": motion.name,
        "rate_hz": motion.rate_hz,
        "joint_names": motion.joint_names,
        "whole_body": reference.whole_body,
    }
    np.savez_compressed(
        path,
        described=np.frombuffer(json.dumps(described).encode(), dtype=np.uint8),
        positions=_packed(motion.positions, ANGLE, axis=0),
        root_orientation=motion.root_orientation,
        root_position=motion.root_position,
        bodies=reference.bodies.astype(np.float32),
        vertices=reference.vertices.astype(np.int32),
        points=_packed(reference.points, LENGTH, axis=1),
        frames=reference.frames.astype(np.int32),
        whole_frames=reference.whole_frames.astype(np.int32),
        whole=_packed(reference.whole, LENGTH, axis=0),
        **{f"energy.{name}": values.astype(np.float32) for name, values in reference.energies.items()},
    )


def load_reference(path: Path) -> Reference:
    """Read what `save_reference` wrote. Raises ValueError for another file."""
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        described = json.loads(arrays["described"].tobytes())
        motion = Motion(
            tuple(described["joint_names"]),
            _unpacked(arrays["positions"], ANGLE, axis=0),
            arrays["root_orientation"],
            arrays["root_position"],
            described["rate_hz"],
            described["scene"],
        )
        energies = {name.partition(".")[2]: array for name, array in arrays.items() if name.startswith("energy.")}
        return Reference(
            described["garment"],
            motion,
            arrays["bodies"],
            arrays["vertices"],
            points := _unpacked(arrays["points"], LENGTH, axis=1),
            arrays.get("frames", np.full(len(points), points.shape[1])),
            energies,
            described["whole_body"],
            arrays["whole_frames"],
            _unpacked(arrays["whole"], LENGTH, axis=0),
            described,
        )
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path} is no reference of simulated cloth: {error}") from error


def _packed(values: np.ndarray, unit: float, *, axis: int) -> np.ndarray:
    """Second differences in units, as bytes of 16-bit numbers apart: those that are nearly all zero compress well."""
    rounded = np.round(values / unit).astype(np.int64)
    if np.abs(rounded).max(initial=0) > np.iinfo(np.int16).max:
        raise ValueError(f"values up to {np.abs(values).max():g} do not fit 16 bits in units of {unit:g}")
    change = rounded.astype(np.int16)
    for _ in range(2):
        change = np.diff(change, axis=axis, prepend=np.zeros_like(np.take(change, [0], axis=axis)))
    folded = (change.view(np.uint16) << 1) ^ (change >> 15).view(np.uint16)  # small of either sign: small numbers
    return np.stack([folded & 255, folded >> 8]).astype(np.uint8)


def _unpacked(packed: np.ndarray, unit: float, *, axis: int) -> np.ndarray:
    folded = packed[0].astype(np.uint16) | packed[1].astype(np.uint16) << 8
    values = ((folded >> 1) ^ -(folded & 1)).astype(np.uint16).view(np.int16)
    for _ in range(2):
        values = np.cumsum(values, axis=axis, dtype=np.int16)
    return values.astype(np.float32) * np.float32(unit)
