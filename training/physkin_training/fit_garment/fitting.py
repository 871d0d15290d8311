"""Bring a garment mesh onto a body: from one body to another, and out of a body it overlaps.

Dimensions: `n` garment vertices, `b` bones. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_core.model.garment_nodes import node_positions_on_body
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sampling.posed_bodies import posed_avatar

__all__ = ["CLEARANCE", "clear_of", "onto_body"]

CLEARANCE = 0.0035
"""[m] a garment at rest keeps from the body, beyond the 3 mm contact offset of training."""
SOFT = 0.002
"""[m] farther out than `CLEARANCE`, contact begins to push while the garment is relaxed."""
MOULDED = Material(youngs_modulus=60.0, bending=2.5e-5, rest_angles="as_made", contact_offset=CLEARANCE + SOFT)
"""What a garment is made of while it is relaxed: it is to keep the shape of its mesh, and to stay smooth."""
NEAREST = 16
"""Body vertices from which a garment vertex takes its bones."""


def onto_body(vertices: np.ndarray, source: Avatar, target: Avatar) -> np.ndarray:
    """Vertices (n, 3) made on one body, on another: each follows the bones of the body parts nearest to it.

    By every bone as garment nodes are carried (offset from its head, scaled by the ratio of bone lengths); mixed by the
    skinning weights of the nearest skin, the nearer the more.
    """
    distance, near = cKDTree(source.vertices).query(vertices, k=NEAREST)
    share = 1 / (distance + 0.02) ** 2
    share /= share.sum(axis=1, keepdims=True)
    weights = np.zeros((len(vertices), len(source.bone_heads)))
    bones, influence = source.influence_bones[near], source.influence_weights[near] * share[..., None]
    np.add.at(weights, (np.arange(len(vertices))[:, None, None], bones), influence)
    bodies = (source.bone_heads, source.bone_tails), (target.bone_heads, target.bone_tails)
    moved = np.zeros_like(vertices, dtype=np.float64)
    for bone in np.flatnonzero(weights.any(axis=0)):
        mine = np.full(len(vertices), bone)
        moved += weights[:, bone, None] * node_positions_on_body(vertices, mine, *bodies)
    return moved / weights.sum(axis=1, keepdims=True)


def clear_of(
    garment: Garment,
    body: Avatar,
    surface: BodySurface,
    *,
    start: np.ndarray | None = None,
    iterations: int = 60,
) -> np.ndarray:
    """Vertices (n, 3) of the garment pushed out of the body and relaxed: the least energy of its own rest shape against
    contact, without gravity. start: (n, 3) where it begins, default its rest shape. iterations: Newton steps, at most.
    """
    device = torch.device("cpu")
    losses = PhysicsLosses(garment, MOULDED, 1, device)
    rig = load_body_model().rig
    posed = posed_avatar(body, rig, 1, device)
    posed.pose(torch.tensor(rig.rest[None], dtype=torch.float32))
    start = torch.as_tensor(
        surface.push_out(garment.vertices if start is None else start, CLEARANCE)[None], dtype=torch.float32
    )
    solver = FullSpaceSolver(losses)
    solution = solver.minimise(
        start, torch.zeros(1, 3), posed.mesh, posed.offset, tolerance=0.05, iterations=iterations
    )
    return surface.push_out(solution.vertices[0].double().numpy(), CLEARANCE)
