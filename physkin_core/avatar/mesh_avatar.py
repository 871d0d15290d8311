"""Avatars from plain meshes (OBJ, PLY, STL), with a rig file beside them or with a fitted skeleton.

Rig file, JSON; every key may be left out:
    bones: [{"name", "parent" (index or name, -1 or null for the root), "head": [x, y, z], "tail": [x, y, z]}, ...],
        in the mesh's own frame and unit; a rig saved by `Rig.to_json` fits.
    influence_bones, influence_weights: one list a vertex, in the order of the mesh file; indices into `bones`.
    up, forward: axes of the mesh, such as "Y" and "Z" or "-Y"; default Z up, X forward. scale: metres per unit.
Without skinning weights these come from the template body by closest point; without bones the rig is fitted.

Dimensions: `V` vertices, `f` faces, `j` bones of the file, `b` bones of the garment model's rig.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.retargeting import SkinnedMesh, check_size, clean_surface, place_bones, retarget, turn_upright
from physkin_core.avatar.rig_fitting import carry_influences, fit_body, template_on_skeleton
from physkin_core.rig.bone_naming import match_bones
from physkin_core.rig.rig import Rig

__all__ = ["load_mesh", "retarget_plain_mesh"]

RIG_FILE_KEYS = ("bones", "dofs", "influence_bones", "influence_weights", "up", "forward", "scale")
AXES = {sign + axis: (-1 if sign else 1) * np.eye(3)["XYZ".index(axis)] for axis in "XYZ" for sign in ("", "-")}
LARGEST_RESIDUAL = 0.015
"""Mean distance between mesh and fitted body, as a share of the height, beyond which the fit is refused."""


@dataclass(frozen=True)
class RigFile:
    """A checked rig file. bones: (name, parent index, head (3,), tail (3,)) each; influences: (V, K) twice, or None."""

    path: Path
    bones: tuple[tuple[str, int, np.ndarray, np.ndarray], ...]
    influences: tuple[np.ndarray, np.ndarray] | None
    axes: tuple[str, str]
    scale: float


def load_mesh(path: Path, rig: Rig, *, rig_file: str | Path | None = None) -> Avatar:
    """Read an OBJ, PLY or STL file. Raises AvatarError (see `physkin_core.load_avatar`)."""
    vertices, faces = _read_surface(path)
    return retarget_plain_mesh(vertices, faces, rig, path=path, rig_file=rig_file, up="Z", forward="X")


def retarget_plain_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    rig: Rig,
    *,
    path: Path,
    rig_file: str | Path | None,
    up: str,
    forward: str,
) -> Avatar:
    """Bind a mesh (V, 3), (f, 3) without a skin. up, forward: its axes unless the rig file names others."""
    beside = path.with_name(f"{path.stem}.rig.json")
    chosen = Path(rig_file) if rig_file is not None else beside if beside.is_file() else None
    description = _read_rig_file(chosen, (up, forward)) if chosen else RigFile(beside, (), None, (up, forward), 1.0)
    to_root = description.scale * _frame(description)
    attributes = description.influences or ()
    if attributes and len(attributes[0]) != len(vertices):
        raise AvatarError(
            f"rig file {chosen} has skinning weights for {len(attributes[0])} vertices, {path} has {len(vertices)}"
        )
    vertices, faces, attributes = clean_surface(vertices @ to_root.T, faces, attributes, str(path))
    check_size(vertices, str(path))
    if not description.bones:
        return retarget(_fitted(vertices, faces, rig, str(path)), rig)
    bones, weights = attributes or (np.zeros((len(vertices), 1), dtype=np.int64), np.ones((len(vertices), 1)))
    names, parents, heads, tails = zip(*description.bones)
    joints = (names, np.array(parents), np.array(heads) @ to_root.T, np.array(tails) @ to_root.T)
    mesh = SkinnedMesh(vertices, faces, *joints, bones, weights, str(path))
    return retarget(mesh if attributes else _with_template_weights(mesh, rig), rig)


def _fitted(vertices: np.ndarray, faces: np.ndarray, rig: Rig, source: str) -> SkinnedMesh:
    body = _template(rig, source)
    fit = fit_body(vertices, faces, body)
    height = float(np.ptp(vertices[:, 2]))
    if fit.residual > LARGEST_RESIDUAL * height:
        raise AvatarError(
            f"avatar {source} has no skeleton and the body model does not fit it: {fit.residual * 1000:.0f} mm mean "
            f"distance, allowed {LARGEST_RESIDUAL * height * 1000:.0f} mm. It must be a person in A- or T-pose, Z up; "
            'else bring a rig file with bones, or one that says what is up: "up": "Y", "forward": "Z"'
        )
    bones, weights = carry_influences(vertices, faces, fit.vertices, body)
    warning = (
        f"no skeleton in the file: the garment model's rig was fitted to the mesh (from {fit.pose}-pose, mean distance "
        f"{fit.residual * 1000:.1f} mm); a rig file beside the mesh is more exact"
    )
    joints = (rig.bone_names, rig.parents, fit.heads, fit.tails)
    return SkinnedMesh(vertices, faces, *joints, bones, weights, source, warnings=(warning,))


def _with_template_weights(mesh: SkinnedMesh, rig: Rig) -> SkinnedMesh:
    """The mesh on the rig's own bones, skinned like the template body posed and stretched onto them."""
    body = _template(rig, mesh.source)
    bone_joint, _ = match_bones(mesh.joint_names, rig, source=mesh.source)
    mesh = turn_upright(mesh, bone_joint)
    heads, tails, _ = place_bones(mesh, bone_joint, rig, root_joint=bone_joint.get(rig.bone_names[0]))
    bones, weights = carry_influences(mesh.vertices, mesh.faces, template_on_skeleton(body, heads), body)
    warning = "the rig file has no skinning weights: they come from the template body by closest point"
    joints = (rig.bone_names, rig.parents, heads, tails)
    warnings = (*mesh.warnings, warning)
    return SkinnedMesh(mesh.vertices, mesh.faces, *joints, bones, weights, mesh.source, warnings=warnings)


def _template(rig: Rig, source: str) -> BodyModel:
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        unknown = [name for name in rig.bone_names if name not in body.rig.bone_names]
        raise AvatarError(
            f"avatar {source} has no skinning weights, and the template body cannot give them: the garment model's rig "
            f"differs from its own ({', '.join(unknown) or 'fewer bones, or another order'}). Bring bones and weights"
        )
    return body


def _read_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in the order of the file and faces (f, 3)."""
    import trimesh

    try:
        if path.suffix.lower() == ".obj":
            mesh = _read_obj(path)
        else:
            mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(getattr(mesh, "faces", ()))
    except Exception as error:  # whatever the parser trips over, the file is not a readable mesh
        raise AvatarError(f"avatar {path} is not a readable mesh: {type(error).__name__}: {error}") from error
    return vertices, faces


def _read_obj(path: Path):
    """Geometry alone: texture seams, materials and groups would split the mesh and reorder its vertices."""
    import io

    import trimesh

    kept = []
    for line in path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ").splitlines():
        kind, *entries = line.split() or [""]
        if kind == "v":
            kept.append(" ".join(["v", *entries[:3]]))
        elif kind == "f":
            kept.append(" ".join(["f", *(entry.split("/")[0] for entry in entries)]))
    return trimesh.load_mesh(io.BytesIO("\n".join(kept).encode()), file_type="obj", process=False, maintain_order=True)


def _read_rig_file(path: Path, axes: tuple[str, str]) -> RigFile:
    if not path.is_file():
        raise AvatarError(f"rig file {path}: no such file")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise AvatarError(f"rig file {path} is not JSON: {error}") from error
    unknown = sorted(set(data) - set(RIG_FILE_KEYS)) if isinstance(data, dict) else ["(not an object)"]
    if unknown:
        raise AvatarError(f"rig file {path} has unknown keys {', '.join(unknown)}; allowed: {', '.join(RIG_FILE_KEYS)}")
    try:
        bones = _bones(data.get("bones", []), path)
        influences = _influences(data, len(bones), path)
        scale = float(data.get("scale", 1.0))
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, AvatarError):
            raise
        raise AvatarError(f"rig file {path} is malformed: {type(error).__name__}: {error}") from error
    if not (np.isfinite(scale) and scale > 0):
        raise AvatarError(f"rig file {path}: scale is {scale}, allowed are positive numbers")
    named = tuple(str(data.get(key, default)).upper() for key, default in zip(("up", "forward"), axes))
    if any(axis not in AXES for axis in named) or named[0][-1] == named[1][-1]:
        raise AvatarError(
            f"rig file {path}: up {named[0]!r} and forward {named[1]!r}; allowed are two different axes of "
            f"{', '.join(AXES)}"
        )
    return RigFile(path, bones, influences, named, scale)


def _bones(entries: list, path: Path) -> tuple:
    names, bones = [str(entry["name"]) for entry in entries], []
    for index, entry in enumerate(entries):
        parent = entry["parent"]
        parent = names.index(parent) if isinstance(parent, str) else -1 if parent is None else int(parent)
        head, tail = (np.array(entry[key], dtype=np.float64) for key in ("head", "tail"))
        if not -1 <= parent < index:
            raise AvatarError(f"rig file {path}: bone {names[index]!r} has parent {parent}; a parent must come first")
        if head.shape != (3,) or tail.shape != (3,) or not (np.isfinite(head).all() and np.isfinite(tail).all()):
            raise AvatarError(f"rig file {path}: head and tail of bone {names[index]!r} must be 3 finite numbers")
        bones.append((names[index], parent, head, tail))
    return tuple(bones)


def _influences(data: dict, bone_count: int, path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    given = [data.get(key) for key in ("influence_bones", "influence_weights")]
    if given == [None, None]:
        return None
    if None in given or bone_count == 0:
        raise AvatarError(f"rig file {path}: bones, influence_bones and influence_weights come together or not at all")
    width = max((len(row) for row in given[0]), default=0)
    if width == 0 or [len(row) for row in given[0]] != [len(row) for row in given[1]]:
        raise AvatarError(f"rig file {path}: influence_bones and influence_weights must have rows of equal length")
    bones = np.array([[*row, *[0] * (width - len(row))] for row in given[0]], dtype=np.int64)
    weights = np.array([[*row, *[0.0] * (width - len(row))] for row in given[1]], dtype=np.float64)
    if bones.min() < 0 or bones.max() >= bone_count:
        raise AvatarError(
            f"rig file {path}: influence_bones span {bones.min()} to {bones.max()}, allowed 0 to {bone_count - 1}"
        )
    total = weights.sum(axis=1, keepdims=True)
    if not np.isfinite(weights).all() or weights.min() < 0 or total.min() <= 0:
        raise AvatarError(f"rig file {path}: skinning weights must be finite, not negative, not all zero for a vertex")
    return bones, weights / total


def _frame(description: RigFile) -> np.ndarray:
    """(3, 3) from the mesh's axes to the root frame."""
    up, forward = (AXES[axis] for axis in description.axes)
    return np.stack([forward, np.cross(up, forward), up])
