"""Is a mesh fit to be trained as a garment? Every check says so in plain words, and repairs what is safe to repair.

Dimensions: `n` vertices, `f` faces. Metres, root frame, the body in its canonical pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import MeshFile, write_obj
from physkin_core.model.garment import Garment, garment_of_mesh
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.fit_garment import mesh_checks, wear_checks
from physkin_training.fit_garment.file_objects import objects_at
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.rest_shape import check_rest_shape, check_threads, edges_along
from physkin_training.fit_garment.verdicts import Checks, Verdict

__all__ = ["CheckedGarment", "check_garment", "write_garment"]


@dataclass(frozen=True)
class CheckedGarment:
    """A garment mesh after the checks, vertices (n, 3) [m] on the training template's body, and all verdicts.

    lying: (n, 3) [m], the same vertices on the body it was made on, before they were moved anywhere; in_own_pose:
    that body is held as in its file, otherwise as in the canonical pose. look: what else the file had, its texture
    places being the flat panels where there are any. line_elements: (k, 2) creases and threads.
    """

    vertices: np.ndarray
    faces: np.ndarray
    verdicts: tuple[Verdict, ...]
    lying: np.ndarray
    in_own_pose: bool
    look: Look
    line_elements: np.ndarray

    @property
    def refused(self) -> bool:
        """Whether some check found what cannot be repaired."""
        return self.first("refused") is not None

    @property
    def garment(self) -> Garment:
        """Exactly what `load_garment` reads from the file that `write_garment` writes."""
        order = np.lexsort([self.look.material, self.look.part])
        uv = np.round(self.look.uv[order], 6)
        return garment_of_mesh(self.vertices, self.faces[order], line_elements=self.line_elements, uv=uv)

    def moved(self, vertices: np.ndarray) -> CheckedGarment:
        """With its vertices (n, 3) [m] elsewhere on the training template."""
        return replace(self, vertices=_as_written(vertices))

    def first(self, outcome: str) -> Verdict | None:
        """The first verdict of an outcome, if there is one."""
        return next((verdict for verdict in self.verdicts if verdict.outcome == outcome), None)


def check_garment(
    mesh: MeshFile,
    avatar: Avatar,
    template: Avatar,
    *,
    own: OwnPose | None = None,
    accept_placement: bool = True,
    chosen: bool = False,
    sewn: bool = False,
) -> CheckedGarment:
    """Check a garment mesh and repair it.

    avatar: the body it was made on, in the canonical pose; own: in that of its file, where it is looked for first.
    template: the training template's garment body; a garment made on another body is moved over to it.
    accept_placement: do so although its place is in doubt, which may take minutes; otherwise the checks end there, and
    the garment stays where it lies. chosen: the user wants all of the mesh, whatever it is. sewn: of
    a pattern, so that what is open is meant to be.

    Checks stop at the first refusal after which the others would mean nothing.
    """
    vertices, look = np.array(mesh.vertices, dtype=np.float64), mesh.look
    checks = Checks(vertices, np.array(mesh.faces, dtype=np.int64), vertices[mesh.line_elements])
    canonical = surface = BodySurface(avatar.vertices, avatar.faces)
    _run(checks, [partial(mesh_checks.check_triangles, polygons=mesh.polygons)])
    in_own_pose = False
    if own is not None and not checks.refused:
        surface = BodySurface(own.vertices, own.faces)
        in_own_pose = wear_checks.check_lying(checks, own, surface, canonical)
        surface = surface if in_own_pose else canonical
    else:
        _run(checks, [partial(wear_checks.check_placement, surface=canonical)])
    source = checks.vertices, checks.faces
    sewn_on = np.zeros((0, 2, 3))
    if not checks.refused:
        on_edges = edges_along(*source, checks.lines)[1]
        checks.lines, sewn_on = checks.lines[on_edges], checks.lines[~on_edges]
    named = None if chosen or sewn or checks.refused else objects_at(mesh, checks.vertices[checks.faces].mean(axis=1))
    _run(
        checks,
        [
            mesh_checks.check_duplicates,
            partial(mesh_checks.check_layers, surface=surface),
            *([] if sewn else [mesh_checks.check_seams]),
            mesh_checks.check_manifold,
            partial(mesh_checks.check_pieces, surface=surface, named=named),
            partial(wear_checks.check_winding, surface=surface),
            mesh_checks.check_openings,
            partial(wear_checks.check_upright, surface=surface),
            partial(wear_checks.check_scale, surface=surface),
            mesh_checks.check_edges,
        ],
    )
    lying, lines = checks.vertices, np.zeros((0, 2), dtype=int)
    if checks.refused or (checks.unsure and not accept_placement):
        return CheckedGarment(lying, checks.faces, tuple(checks.verdicts), lying, in_own_pose, look, lines)
    _run(
        checks,
        [
            partial(wear_checks.check_pose, avatar=avatar, surface=canonical, own=own if in_own_pose else None),
            partial(wear_checks.check_overlap, avatar=avatar, surface=canonical),
        ],
    )
    made = checks.vertices
    _run(
        checks,
        [
            partial(wear_checks.check_body, avatar=avatar, template=template),
            mesh_checks.check_self_intersection,
        ],
    )
    if not checks.refused:
        look = check_rest_shape(checks, look.on(source, lying, checks.faces), lying, made)
        creases, _ = edges_along(lying, checks.faces, checks.lines)
        lines = np.concatenate([creases, check_threads(checks, lying, sewn_on)])
    vertices = _as_written(checks.vertices)
    return CheckedGarment(vertices, checks.faces, tuple(checks.verdicts), lying, in_own_pose, look, lines)


def _as_written(vertices: np.ndarray) -> np.ndarray:
    """Vertices (n, 3) [m] to as many digits as `write_obj` writes: a run that goes on with the file is the same."""
    return np.round(vertices, 7)


def _run(checks: Checks, steps: list[Callable[[Checks], None]]) -> None:
    """One after the other, as long as none has refused."""
    for step in steps:
        if not checks.refused:
            step(checks)


def write_garment(path: Path, checked: CheckedGarment) -> None:
    """Write the repaired mesh as OBJ: metres, root frame of the template, outward winding, with its look,
    creases and threads."""
    header = "root frame: X forward, Y left, Z up, metres, origin at the head of the root bone"
    write_obj(path, checked.vertices, checked.faces, checked.look, header=header, line_elements=checked.line_elements)
