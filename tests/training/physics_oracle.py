"""Slow, clean float64 oracle of the physics losses in torch, differentiated by autograd.

Written from the formulas, face by face and hinge by hinge.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from scipy.linalg import polar

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material


def stretch_energy(x: torch.Tensor, garment: Garment, material: Material, cut: Garment | None = None) -> torch.Tensor:
    """StVK membrane energy of x (n, 3): mu tr(E^2) + lambda / 2 tr(E)^2, E = (F^T F - I) / 2, plane stress. cut: whose
    panels are at rest, graded as from its mesh to the garment's; None: the garment's mesh is."""
    young, poisson = material.youngs_modulus, material.poisson_ratio
    mu, lam = young / (2 * (1 + poisson)), young * poisson / (1 - poisson**2)
    total = torch.zeros((), dtype=torch.float64)
    for (a, b, c), rest in zip(garment.faces.tolist(), rest_matrices(garment, cut)):
        deformation = torch.stack([x[b] - x[a], x[c] - x[a]], dim=1) @ torch.linalg.inv(rest)
        strain = (deformation.T @ deformation - torch.eye(2, dtype=torch.float64)) / 2
        density = mu * (strain @ strain).trace() + lam / 2 * strain.trace() ** 2
        total = total + density * torch.linalg.det(rest) / 2
    return total


def rest_matrices(garment: Garment, cut: Garment | None) -> list[torch.Tensor]:
    """Edges of each face at rest, (2, 2), in the frame of the mesh's first edge; flat cloth as it fits best on it."""

    def matrix(points: np.ndarray, corners: np.ndarray) -> torch.Tensor:
        a, b, c = torch.as_tensor(points[corners].copy())
        first = (b - a) / (b - a).norm()
        away = c - a - first * (first @ (c - a))
        edges = torch.stack([b - a, c - a], dim=1)
        return torch.stack([first, away / away.norm()]) @ edges

    found = [matrix(garment.vertices, face) for face in garment.faces]
    if cut is not None:
        made = [matrix(cut.vertices, face) for face in cut.faces]
        flat = [matrix(cut.panel_places, face) for face in cut.panel_faces]
        turns = [torch.as_tensor(polar((base @ torch.linalg.inv(panel)).numpy())[0]) for base, panel in zip(made, flat)]
        found = [
            shape @ torch.linalg.inv(base) @ turn @ panel for shape, base, turn, panel in zip(found, made, turns, flat)
        ]
    return found


def bend_energy(x: torch.Tensor, garment: Garment, material: Material, cut: Garment | None = None) -> torch.Tensor:
    """k sum 3 |e|^2 / (A1 + A2) (theta - rest)^2 of x (n, 3), theta signed about the shared edge; see `Material`.
    Lengths and areas are those at rest, as of `stretch_energy`."""
    as_made = torch.as_tensor(garment.vertices)
    sides: dict[frozenset, list[torch.Tensor]] = {}
    for (a, b, c), matrix in zip(garment.faces.tolist(), rest_matrices(garment, cut)):
        first, second, area = matrix[:, 0], matrix[:, 1], torch.linalg.det(matrix) / 2
        for ends, side in (((a, b), first), ((b, c), second - first), ((c, a), second)):
            sides.setdefault(frozenset(ends), []).append(torch.stack([side.norm(), area]))
    total = torch.zeros((), dtype=torch.float64)
    for hinge, creased in zip(garment.hinges.tolist(), garment.creased):
        one, other = sides[frozenset(hinge[:2])]
        length, areas = (one[0] + other[0]) / 2, one[1] + other[1]
        rest_angle = _angle(as_made, hinge) if creased or material.rest_angles == "as_made" else 0.0
        difference = _angle(x, hinge) - rest_angle
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


def _angle(x: torch.Tensor, hinge: list[int]) -> torch.Tensor:
    x0, x1, x2, x3 = (x[i] for i in hinge)
    edge = x1 - x0
    na, nb = torch.linalg.cross(edge, x2 - x0), torch.linalg.cross(x3 - x0, edge)
    unit_a, unit_b = na / na.norm(), nb / nb.norm()
    sine = torch.linalg.cross(unit_a, unit_b) @ (edge / edge.norm())
    return torch.atan2(sine, unit_a @ unit_b)
