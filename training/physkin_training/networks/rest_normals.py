"""Rest normals fitted to drapes: skinning then carries them closer to the normals of the draped cloth.

Cloth does not deform as the linear part of a blend of garment nodes says, for the blend itself changes from vertex to
vertex. What that does to a normal in most poses can be had for nothing: by another normal at rest.

Dimensions: `B` frames, `n` garment vertices, `m` garment nodes.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import normalize

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.rig.rig import Rig
from physkin_training.networks.draping import Drape
from physkin_training.networks.export import encode_bodies
from physkin_training.physics.area_normals import area_normals
from physkin_training.sampling.everyday_poses import EverydayPoses
from physkin_training.sampling.posed_bodies import BodySet

__all__ = ["fitted_rest_normals"]

BODIES, POSES = 8, 32
"""Training bodies, and poses of each, that rest normals are fitted to."""
RIDGE = 0.01
"""Weight of the mesh's own normal beside the mean of all frames, for vertices that cloth folds up in all of them."""


@torch.no_grad()
def fitted_rest_normals(
    drape: Drape, garment: Garment, rig: Rig, *, bodies: int = BODIES, poses: int = POSES
) -> np.ndarray:
    """Unit rest normals (n, 3) float32 of the template, least squares over drapes on adult training bodies.

    Half of the poses are everyday ones. The others are uniform in the joint limits, shrunk around the canonical pose by
    0 to 1, by little in few of them: motion is seldom far out. Raises ValueError for another rig than the body model's.
    """
    body_model = load_body_model()
    if rig.to_json() != body_model.rig.to_json():
        raise ValueError("normals are fitted on the body model's bodies; this garment has another rig")
    device = drape.node_rest.device
    body_set = BodySet(body_model, body_model.train_adults[:bodies], device)
    node_positions = drape.node_positions(body_set)
    modulations = encode_bodies(drape, body_set.vertices.cpu().numpy(), body_model.faces)
    heads = body_set.heads.cpu().numpy()
    faces = torch.as_tensor(np.array(garment.faces), dtype=torch.int64, device=device)
    own = torch.as_tensor(vertex_normals(garment.vertices, garment.faces), dtype=torch.float32, device=device)
    share = RIDGE * bodies * poses
    squares = share * torch.eye(3, device=device).repeat(len(own), 1, 1)
    products = share * own
    generator = np.random.default_rng(0)
    everyday, drawn = EverydayPoses(rig, torch.device("cpu")), torch.Generator().manual_seed(0)
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
    """What normals transform by where tangents transform by `linear` (..., 3, 3): det(A) A^-T."""
    x, y, z = linear.unbind(dim=-1)
    return torch.stack([torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)], dim=-1)
