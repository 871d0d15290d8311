"""Rest normals fitted to drapes: skinning then carries them closer to the normals of the draped cloth.

Cloth does not deform as the linear part of a blend of garment nodes says, for the blend itself changes from vertex to
vertex. What that does to a normal in most poses can be had for nothing: by another normal at rest.

`python -m physkin_training.networks.rest_normals [MODEL ...]` measures what they are worth; with `--store` it fits them
and writes them into the model files.
Dimensions: `B` frames, `n` garment vertices, `m` garment nodes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from tabulate import tabulate
from torch.nn.functional import normalize

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, save_garment_model, shipped_models
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.outfit.draper import Draper
from physkin_core.rig.rig import Rig
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.physics.area_normals import area_normals
from physkin_training.sampling.evaluation_pairs import Pairs, motion_pairs, uniform_pairs
from physkin_training.sampling.everyday_poses import EverydayPoses
from physkin_training.sampling.posed_bodies import BodySet

__all__ = ["NormalErrors", "fitted_rest_normals", "main", "normal_errors"]

BODIES, POSES = 8, 32
"""Training bodies, and poses of each, that rest normals are fitted to."""
RIDGE = 0.01
"""Weight of the mesh's own normal beside the mean of all frames, for vertices that cloth folds up in all of them."""
MEASURED_BODIES, MEASURED_FRAMES = 4, 12


@torch.no_grad()
def fitted_rest_normals(
    drape: Drape, garment: Garment, rig: Rig, *, bodies: int = BODIES, poses: int = POSES, seed: int = 0
) -> np.ndarray:
    """Unit rest normals (n, 3) float32 of the template, least squares over drapes on training bodies.

    Half of the poses are everyday ones. The others are uniform in the joint limits, shrunk around the canonical pose by
    0 to 1, by little in few of them: motion is seldom far out. Raises ValueError for another rig than the body model's,
    and when bodies or poses are below 1 or there are not so many training bodies.
    """
    body_model = load_body_model()
    if rig.to_json() != body_model.rig.to_json():
        raise ValueError("normals are fitted on the body model's bodies; this garment has another rig")
    if not (1 <= bodies <= len(body_model.train_bodies) and poses >= 1):
        allowed = f"1 to {len(body_model.train_bodies)} bodies and 1 pose or more"
        raise ValueError(f"cannot fit normals to {bodies} bodies in {poses} poses, allowed: {allowed}")
    device = drape.node_rest.device
    body_set = BodySet(body_model, body_model.train_bodies[:bodies], device)
    node_positions = drape.node_positions(body_set)
    modulations = encode_bodies(drape, body_set.vertices.cpu().numpy(), body_model.faces)
    heads = body_set.heads.cpu().numpy()
    faces = torch.as_tensor(np.array(garment.faces), dtype=torch.int64, device=device)
    own = torch.as_tensor(vertex_normals(garment.vertices, garment.faces), dtype=torch.float32, device=device)
    share = RIDGE * bodies * poses
    squares = share * torch.eye(3, device=device).repeat(len(own), 1, 1)
    products = share * own
    generator = np.random.default_rng(seed)
    everyday, drawn = EverydayPoses(rig, torch.device("cpu")), torch.Generator().manual_seed(seed)
    far = poses - poses // 2
    shrunk = np.linspace(0, 1, far)[:, None] ** 2
    for body in range(bodies):
        joints = rig.rest + shrunk * (generator.uniform(rig.lower, rig.upper, (far, len(rig.rest))) - rig.rest)
        known, downs = everyday.sample(poses // 2, generator=drawn)
        joints = np.concatenate([joints, known.numpy()])
        gravity = torch.cat([torch.tensor([[0.0, 0.0, -1.0]]).expand(far, 3), downs]).to(device)
        transforms = rig.bone_transforms(joints, heads=heads[body])
        bones, positions = (torch.as_tensor(a, dtype=torch.float32, device=device) for a in (transforms, joints))
        posed = drape.posed_nodes(bones, node_positions[body].expand(poses, -1, -1))
        nodes, detail = drape.draped(modulations[body].expand(poses, -1), positions, gravity, posed)
        normals = normalize(area_normals(drape.skin(nodes, detail=detail), faces), dim=2)
        carry = _cofactors(drape.linear_parts(nodes))
        squares += torch.einsum("bvji,bvjk->vik", carry, carry)
        products += torch.einsum("bvji,bvj->vi", carry, normals)
    fitted = torch.linalg.solve(squares, products)
    return normalize(fitted, dim=1).cpu().numpy()


def _cofactors(linear: torch.Tensor) -> torch.Tensor:
    """Twin of `physkin_core.model.skinning.cofactors`, (..., 3, 3)."""
    x, y, z = linear.unbind(dim=-1)
    return torch.stack([torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)], dim=-1)


@dataclass(frozen=True)
class NormalErrors:
    """Angles [degrees] between normals carried by skinning and those of the draped mesh: median, 99th percentile."""

    median: float
    p99: float


def normal_errors(model: GarmentModel, *, bodies: int, frames: int) -> dict[str, NormalErrors]:
    """Angles by bundled motion, and for uniform poses, on held-out adults in one size, at `frames` frames each."""
    body_model = load_body_model()
    angles: dict[str, list[np.ndarray]] = {}
    takes = _takes(model.rig, frames)
    for coefficients in body_model.held_out_bodies[:bodies]:
        avatar = avatar_from_body(body_model, coefficients)  # the vertices as points: their normals are carried along
        draper = Draper(model, avatar, fit=0.0, precision="fp32", points=model.garment.vertices)
        for name, pairs in takes.items():
            for joints, down in zip(pairs.positions.numpy(), pairs.gravity.numpy()):
                cloud = draper.drape(joints, down)
                cosine = (cloud[:, 3:] * vertex_normals(cloud[:, :3], model.garment.faces)).sum(axis=1)
                angles.setdefault(name, []).append(np.degrees(np.arccos(cosine.clip(-1, 1))))
    return {name: NormalErrors(*np.percentile(np.concatenate(each), (50, 99))) for name, each in angles.items()}


def _takes(rig: Rig, frames: int) -> dict[str, Pairs]:
    """Poses by bundled motion, evenly spread, and "uniform"."""
    motions = {name: motion_pairs(load_motion(name), rig, bodies=1).spread(frames) for name in bundled_motions()}
    return motions | {"uniform": uniform_pairs(rig, bodies=1, poses=frames, seed=0, upright=True)}


def main(argv: Sequence[str] | None = None) -> int:
    """Prints one table over the models; `--store` writes the files. Returns 0, 2 for a file that is no model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=shipped_models(), help="garment model files or shipped names")
    parser.add_argument("--store", action="store_true", help="fit first, and write what was fitted; needs files")
    options = parser.parse_args(argv)
    if options.store and not all(Path(path).is_file() for path in options.models):
        print(f"error: --store needs model files, got {', '.join(map(str, options.models))}", file=sys.stderr)
        return 2
    takes = (*bundled_motions(), "uniform")
    table: list[list[str]] = []
    for path in options.models:
        try:
            model = load_garment_model(path)
            of_mesh = vertex_normals(model.garment.vertices, model.garment.faces)
            rows = {f"{model.name}, those of the mesh": replace(model, rest_normals=of_mesh)}
            if options.store:
                fitted = fitted_rest_normals(drape_from_model(model), model.garment, model.rig)
                model = replace(model, rest_normals=fitted)
                save_garment_model(model, path)
        except ValueError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        rows[f"{model.name}, as stored"] = model
        for label, measured in rows.items():
            errors = normal_errors(measured, bodies=MEASURED_BODIES, frames=MEASURED_FRAMES)
            table.append([label, *(f"{errors[take].median:.1f}, {errors[take].p99:.0f}" for take in takes)])
    print(tabulate(table, ["degrees: median, p99", *takes], tablefmt="pipe"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
