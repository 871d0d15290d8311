"""Slow, clean float64 oracle of the physics losses in torch, differentiated by autograd.

Written from the formulas, face by face and hinge by hinge.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material


def stretch_energy(x: torch.Tensor, garment: Garment, material: Material) -> torch.Tensor:
    """StVK membrane energy of x (n, 3): mu tr(E^2) + lambda / 2 tr(E)^2, E = (F^T F - I) / 2, plane stress."""
    young, poisson = material.youngs_modulus, material.poisson_ratio
    mu, lam = young / (2 * (1 + poisson)), young * poisson / (1 - poisson**2)
    rest = torch.as_tensor(garment.vertices)
    total = torch.zeros((), dtype=torch.float64)
    for a, b, c in garment.faces.tolist():
        edges = torch.stack([rest[b] - rest[a], rest[c] - rest[a]], dim=1)
        first = edges[:, 0] / edges[:, 0].norm()
        normal = torch.linalg.cross(edges[:, 0], edges[:, 1])
        second = torch.linalg.cross(normal / normal.norm(), first)
        flat = torch.stack([first, second]) @ edges
        deformation = torch.stack([x[b] - x[a], x[c] - x[a]], dim=1) @ torch.linalg.inv(flat)
        strain = (deformation.T @ deformation - torch.eye(2, dtype=torch.float64)) / 2
        density = mu * (strain @ strain).trace() + lam / 2 * strain.trace() ** 2
        total = total + density * normal.norm() / 2
    return total


def bend_energy(x: torch.Tensor, garment: Garment, material: Material) -> torch.Tensor:
    """k sum 3 |e|^2 / (A1 + A2) (theta - rest)^2 of x (n, 3), theta signed about the shared edge; see `Material`."""
    rest = torch.as_tensor(garment.vertices)
    total = torch.zeros((), dtype=torch.float64)
    for hinge, creased in zip(garment.hinges.tolist(), garment.creased):
        angle, _, _ = _hinge(x, hinge)
        made, length, areas = _hinge(rest, hinge)
        rest_angle = made if creased or material.rest_angles == "as_made" else 0.0
        difference = angle - rest_angle
        difference = difference - 2 * np.pi * torch.round(difference.detach() / (2 * np.pi))
        total = total + material.bending * 3 * length**2 / areas * difference**2
    return total


def collision_energy(
    x: torch.Tensor, garment: Garment, material: Material, body_vertices: np.ndarray, body_faces: np.ndarray
) -> torch.Tensor:
    """Contact energy of x (n, 3) against a closed convex body; trimesh finds the closest points."""
    body = trimesh.Trimesh(body_vertices, body_faces, process=False)
    places = x.detach().numpy()
    closest, _, face = trimesh.proximity.closest_point(body, places)
    sign = np.sign(((places - closest) * body.face_normals[face]).sum(axis=1))
    distance = torch.as_tensor(sign) * (x - torch.as_tensor(closest)).norm(dim=1)
    depth = torch.clamp(material.contact_offset - distance, min=0)
    return (material.contact_stiffness * torch.as_tensor(garment.vertex_areas) * depth**2).sum()


def gravity_energy(x: torch.Tensor, garment: Garment, material: Material, direction: torch.Tensor) -> torch.Tensor:
    """Potential energy of x (n, 3): -sum m g (x . direction)."""
    mass = torch.as_tensor(garment.vertex_areas) * material.density
    return -(mass * 9.81 * (x @ direction)).sum()


def _hinge(x: torch.Tensor, hinge: list[int]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    x0, x1, x2, x3 = (x[i] for i in hinge)
    edge = x1 - x0
    na, nb = torch.linalg.cross(edge, x2 - x0), torch.linalg.cross(x3 - x0, edge)
    unit_a, unit_b = na / na.norm(), nb / nb.norm()
    sine = torch.linalg.cross(unit_a, unit_b) @ (edge / edge.norm())
    return torch.atan2(sine, unit_a @ unit_b), edge.norm(), (na.norm() + nb.norm()) / 2
