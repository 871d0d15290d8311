"""Is a mesh fit to be trained as a garment? Every check says so in plain words, and repairs what is safe to repair.

Dimensions: `n` vertices, `f` faces. Metres, root frame, the body in its canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import GarmentError
from physkin_training.fit_garment import mesh_checks, wear_checks
from physkin_training.fit_garment.verdicts import Checks, Verdict
from physkin_training.physics.surface_queries import BodySurface

__all__ = ["CheckedGarment", "check_garment", "check_mesh", "write_garment"]

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


@dataclass(frozen=True)
class CheckedGarment:
    """A garment mesh after the checks, vertices (n, 3) [m] on the training template's body, and all verdicts."""

    vertices: np.ndarray
    faces: np.ndarray
    verdicts: tuple[Verdict, ...]

    @property
    def refused(self) -> bool:
        """Whether some check found what cannot be repaired."""
        return any(verdict.outcome == "refused" for verdict in self.verdicts)


def check_garment(path: str | Path, avatar: Avatar, template: Avatar) -> CheckedGarment:
    """Check the garment mesh of a file and repair it.

    avatar: the body it was made on, in the canonical pose. template: the training template's garment body; a garment
    made on another body is carried over to it. Raises GarmentError when the file holds no mesh at all.
    """
    vertices, faces, quads = _read(Path(path))
    return check_mesh(vertices, faces, avatar, template, polygons=quads)


def check_mesh(
    vertices: np.ndarray, faces: np.ndarray, avatar: Avatar, template: Avatar, *, polygons: int = 0
) -> CheckedGarment:
    """Check vertices (n, 3), in any unit and axes, and faces (f, 3); see `check_garment`.

    polygons: how many faces of more than three corners the triangles came from. Checks stop at the first refusal after
    which the others would mean nothing.
    """
    checks = Checks(np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64))
    surface = BodySurface(avatar.vertices, avatar.faces)
    for check in (
        partial(mesh_checks.check_triangles, polygons=polygons),
        partial(wear_checks.check_placement, surface=surface),
        mesh_checks.check_duplicates,
        mesh_checks.check_manifold,
        mesh_checks.check_pieces,
        partial(wear_checks.check_winding, surface=surface),
        mesh_checks.check_openings,
        partial(wear_checks.check_scale, surface=surface),
        mesh_checks.check_edges,
        mesh_checks.check_layers,
        partial(wear_checks.check_overlap, avatar=avatar, surface=surface),
        partial(wear_checks.check_body, avatar=avatar, template=template),
        mesh_checks.check_self_intersection,
    ):
        check(checks)
        if checks.verdicts[-1].outcome == "refused":
            break
    return CheckedGarment(checks.vertices, checks.faces, tuple(checks.verdicts))


def write_garment(path: Path, checked: CheckedGarment) -> None:
    """Write the repaired mesh as OBJ: metres, root frame of the template, outward winding."""
    header = "root frame: X forward, Y left, Z up, metres, origin at the head of the root bone"
    trimesh.Trimesh(checked.vertices, checked.faces, process=False).export(path, digits=7, header=header)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    if path.suffix.lower() not in MESH_SUFFIXES:
        allowed = ", ".join(MESH_SUFFIXES)
        raise GarmentError(f"garment {path} has the unknown extension {path.suffix!r}; allowed: {allowed}")
    if not path.is_file():
        raise GarmentError(f"garment {path}: no such file")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    except Exception as error:
        raise GarmentError(f"cannot read garment mesh {path}: {error}") from error
    if len(faces) == 0:
        raise GarmentError(f"garment {path} holds no faces")
    polygons = 0
    if path.suffix.lower() == ".obj":
        with open(path, errors="replace") as file:
            polygons = sum(line.startswith("f ") and len(line.split("#")[0].split()) > 4 for line in file)
    return vertices, faces, polygons
