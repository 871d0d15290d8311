"""Reference sequences: what a simulated garment did in one scene on some bodies, in a file that needs no other.

Positions are rounded to a tenth of a millimetre.
Dimensions: `S` bodies, `T` frames, `n` garment vertices. Metres, root frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.motion.motion import Motion

__all__ = ["Reference", "load_reference", "rounded", "save_reference"]

LENGTH = 1e-4


@dataclass(frozen=True)
class Reference:
    """One garment in one scene.

    garment: its name. motion: the scene. bodies: (S, c) shape coefficients. vertices: (S, T, n, 3) int16 in tenths of a
    millimetre; only the first `frames` (S,) of a body count, then the simulation lost it.
    """

    garment: str
    motion: Motion
    bodies: np.ndarray
    vertices: np.ndarray
    frames: np.ndarray

    def simulated(self, body: int) -> np.ndarray:
        """Vertices (t, n, 3) float32 [m] of a body in the frames that count."""
        return self.vertices[body, : self.frames[body]] * np.float32(LENGTH)


def rounded(vertices: np.ndarray) -> np.ndarray:
    """Vertices [m], at most 3 m from the root, as `Reference` holds them; others as zero."""
    units = vertices / LENGTH
    return np.where(np.abs(units) <= np.iinfo(np.int16).max, np.round(units), 0).astype(np.int16)


def save_reference(reference: Reference, path: Path) -> None:
    """Write a reference (.npz)."""
    motion = reference.motion
    np.savez_compressed(
        path,
        garment=reference.garment,
        scene=motion.name,
        rate_hz=motion.rate_hz,
        joint_names=motion.joint_names,
        positions=motion.positions,
        root_orientation=motion.root_orientation,
        root_position=motion.root_position,
        bodies=reference.bodies,
        vertices=reference.vertices,
        frames=reference.frames,
    )


def load_reference(path: Path) -> Reference:
    """Read what `save_reference` wrote. Raises ValueError for another file."""
    try:
        with np.load(path) as file:
            motion = Motion(
                tuple(file["joint_names"].tolist()),
                *(file[name] for name in ("positions", "root_orientation", "root_position")),
                float(file["rate_hz"]),
                str(file["scene"]),
            )
            return Reference(str(file["garment"]), motion, *(file[name] for name in ("bodies", "vertices", "frames")))
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path} is no reference of simulated cloth: {error}") from error
