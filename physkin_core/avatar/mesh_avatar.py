"""Avatars from plain meshes (OBJ, PLY, STL), with a rig file beside them (`rig_file`) or with a fitted skeleton.

Without skinning weights these come from the template body by closest point; without bones the rig is fitted.

Dimensions: `V` vertices, `f` faces, `b` bones of the garment model's rig.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.body_parts import without_accessories
from physkin_core.avatar.joint_identification import identify_bones
from physkin_core.avatar.retargeting import place_bones, retarget
from physkin_core.avatar.rig_file import RigFile, axes_to_root_frame, read_rig_file
from physkin_core.avatar.rig_fitting import carry_influences, fit_body, template_on_skeleton
from physkin_core.avatar.skinned_mesh import (
    SkinnedMesh,
    Surface,
    check_size,
    clean_surface,
    turn_upright,
    unit_scale,
)
from physkin_core.file_reading import file_beside, listed
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.surface_file import read_surface
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.rig.rig import Rig

__all__ = ["load_mesh", "retarget_plain_mesh"]

LARGEST_RESIDUAL = 0.015
"""Mean distance between mesh and fitted body, as a share of the height, beyond which the fit is refused."""
SYMMETRY_SAMPLES = 2000
LARGEST_ASYMMETRY = 0.03
"""Mean distance between a surface and its mirror image, as a share of the size, of what has a left and a right."""


def load_mesh(path: Path, rig: Rig, *, rig_file: str | Path | None = None, bones: str | Path | None = None) -> Avatar:
    """Read an OBJ, PLY or STL file. Raises AvatarError (see `physkin_core.load_avatar`)."""
    return retarget_plain_mesh(_read_surface(path), rig, path=path, rig_file=rig_file, bones=bones, up="Z")


def retarget_plain_mesh(
    surface: Surface, rig: Rig, *, path: Path, rig_file: str | Path | None, bones: str | Path | None, up: str
) -> Avatar:
    """Bind a mesh without a skin. up: its usual axis; a warning says when another is assumed."""
    source, beside = str(path), f"{path.stem}.rig.json"
    chosen = Path(rig_file) if rig_file is not None else None
    if chosen is None and path.with_name(beside).is_file():
        chosen = file_beside(path, beside)
    description = read_rig_file(chosen) if chosen else RigFile()
    attributes = description.influences or ()
    if attributes and len(attributes[0]) != len(surface.vertices):
        raise AvatarError(
            f"rig file {chosen} has skinning weights for {len(attributes[0])} vertices, the mesh has "
            f"{len(surface.vertices)}; they go with the vertices one by one, in the order of the mesh file"
        )
    corners = np.arange(surface.faces.size).reshape(-1, 3)
    surface, attributes, kept = clean_surface(surface, attributes, source)
    vertices, faces = surface.vertices, surface.faces
    scale, warnings = unit_scale(vertices) if description.scale is None else (description.scale, ())
    axis = description.up
    if axis is None:
        axis = up if description.bones else _upright_axis(vertices, faces, up)
        warnings += () if axis == up else (f"{axis} is taken to be up, not {up}: it is symmetric and tallest so",)
    to_root = scale * axes_to_root_frame(axis, description.forward)
    parts = {name: getattr(surface, name) for name in ("part_names", "face_parts", "clear_parts", "seen")}
    parts["warnings"] = warnings
    origin = {"file_vertices": vertices, "file_corners": corners[kept]}
    vertices = vertices @ to_root.T
    if not description.bones:
        check_size(vertices, source)
        fitted = _fitted(vertices, faces, rig, source, **parts)
        return retarget(replace(fitted, **origin), rig, bones=bones)
    influences = attributes or (np.zeros((len(vertices), 1), dtype=np.int64), np.ones((len(vertices), 1)))
    names, parents, heads, tails = zip(*description.bones)
    joints = (names, np.array(parents), np.array(heads) @ to_root.T, np.array(tails) @ to_root.T)
    _check_bones_lie_in_mesh(vertices, joints[2], chosen)
    mesh = SkinnedMesh(vertices, faces, *joints, *influences, source, **parts, **origin)
    return retarget(mesh if attributes else _with_template_weights(mesh, rig), rig, bones=bones)


def _check_bones_lie_in_mesh(vertices: np.ndarray, heads: np.ndarray, rig_file: Path | None) -> None:
    """Heads (j, 3) of a rig file in another unit, axes or place than the mesh (V, 3) lie outside of it."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    margin = 0.1 * float((high - low).max())
    outside = ((heads < low - margin) | (heads > high + margin)).any(axis=1)
    if outside.mean() > 0.5:
        raise AvatarError(
            f"rig file {rig_file} does not fit: {outside.sum()} of {len(heads)} bones lie outside of the mesh; bones "
            f"span {np.round(np.ptp(heads, axis=0), 3).tolist()} m, the mesh {np.round(high - low, 3).tolist()} m, "
            "both must share frame, unit and place"
        )


def _upright_axis(vertices: np.ndarray, faces: np.ndarray, usual: str) -> str:
    """Up axis of a standing person: left and right mirror each other, and of the other two extents height is larger.

    It is `usual` where no two sides mirror each other.
    """
    from scipy.spatial import cKDTree

    points, _ = sample_surface(vertices, faces, SYMMETRY_SAMPLES)
    centre, extent = (vertices.min(axis=0) + vertices.max(axis=0)) / 2, np.ptp(vertices, axis=0)
    tree, mirrors = cKDTree(points), 1 - 2 * np.eye(3)
    asymmetry = [tree.query(centre + (points - centre) * mirror)[0].mean() for mirror in mirrors]
    across = int(np.argmin(asymmetry))
    if asymmetry[across] > LARGEST_ASYMMETRY * extent.max():
        return usual
    return "XYZ"[max({0, 1, 2} - {across}, key=lambda axis: extent[axis])]


def _fitted(vertices: np.ndarray, faces: np.ndarray, rig: Rig, source: str, *, warnings, **parts) -> SkinnedMesh:
    body = _template(rig, source)
    named = {name: parts[name] for name in ("part_names", "face_parts")}
    fit = fit_body(*without_accessories(vertices, faces, **named), body)
    height = float(np.ptp(vertices[:, 2]))
    if fit.residual > LARGEST_RESIDUAL * height:
        raise AvatarError(
            f"avatar {source} is no person in A- or T-pose that the body model fits: {fit.residual * 1000:.0f} mm mean "
            f"distance, allowed {LARGEST_RESIDUAL * height * 1000:.0f} mm; bring a rig file with bones, or with "
            '"up": "Y", "forward": "Z"; a garment goes behind -g, not here'
        )
    bones, weights = carry_influences(vertices, faces, fit.vertices, body)
    warning = (
        f"no skeleton in the file: the garment model's rig was fitted to the mesh (from {fit.pose}-pose, mean distance "
        f"{fit.residual * 1000:.1f} mm); a rig file beside the mesh is more exact"
    )
    joints = (rig.bone_names, rig.parents, fit.heads, fit.tails)
    return SkinnedMesh(vertices, faces, *joints, bones, weights, source, warnings=(*warnings, warning), **parts)


def _with_template_weights(mesh: SkinnedMesh, rig: Rig) -> SkinnedMesh:
    """The mesh on the rig's own bones, skinned like the template body posed and stretched onto them."""
    body = _template(rig, mesh.source)
    mesh, skeleton = identify_bones(mesh, rig)
    bone_joint = skeleton.joints
    mesh = turn_upright(mesh, bone_joint, rig)
    heads, tails, _ = place_bones(mesh, bone_joint, rig, root_joint=bone_joint.get(rig.bone_names[0]))
    bones, weights = carry_influences(mesh.vertices, mesh.faces, template_on_skeleton(body, heads), body)
    warning = "the rig file has no skinning weights: they come from the template body by closest point"
    return replace(
        mesh,
        joint_names=rig.bone_names,
        joint_parents=rig.parents,
        joint_heads=heads,
        joint_tails=tails,
        influence_joints=bones,
        influence_weights=weights,
        warnings=(*mesh.warnings, warning),
    )


def _template(rig: Rig, source: str) -> BodyModel:
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        unknown = [name for name in rig.bone_names if name not in body.rig.bone_names]
        raise AvatarError(
            f"avatar {source} has no skinning weights, and the template body's rig differs from the garment model's "
            f"({listed(unknown) or 'fewer bones, or another order'}); bring bones and weights"
        )
    return body


def _read_surface(path: Path) -> Surface:
    """Vertices in the order of the file."""
    if path.suffix.lower() != ".obj":
        return Surface(*read_surface(path))
    file = read_obj(path)
    called = [(names.material, names.group, names.object) for names in file.names]
    number = {part: index for index, part in enumerate(dict.fromkeys(called))}
    part_names = tuple(tuple(filter(None, part)) for part in number)
    face_parts = np.array([number[part] for part in called], dtype=int)[file.face_names]
    return Surface(file.vertices, file.faces, part_names, face_parts)
