"""Physics losses as Warp kernels with gradients written by hand (paper: Training): stretch, bend, collision, gravity,
and a band that holds the garment up.

Each kernel writes the energy [J] of its elements and adds dE/dx [N] to a shared gradient array in one pass; torch sees
one differentiable operation per energy, whose backward pass is a product. Nothing allocates or waits for the host, so a
training step can be captured as a CUDA graph.

Dimensions: `B` samples, `n` garment vertices, `f` faces, `q` hinges, `V` body vertices, `k` band vertices. Metres,
root frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from physkin_core.garment import Garment
from physkin_core.garment_model import Material
from physkin_training.rest_data import RestData
from physkin_training.wearing import Wearing

__all__ = ["TERMS", "Energies", "PhysicsLosses"]

TERMS = ("stretch", "bend", "collision", "gravity", "band")
"""The energies, in the order of `Energies`."""

DEEP = 0.01
"""Beyond this depth [m] below the contact offset a hit counts only if the vertex is worn on that part of the body, and
body and cloth face the same way: else it is another limb, or the wrong side of this one."""

LED_BACK_BEYOND = 0.001
"""Depth [m] behind its own place on the body up to which the force grows that leads a lost vertex back."""

BAND_STIFFNESS = 1.0e5
"""What holds a garment up [J/m4]: energy = stiffness * vertex area * (distance beyond the slack)^2."""

BAND_SLACK = 0.015
"""How far [m] a vertex of the band may move from its place on the body before it is held."""


@wp.kernel
def stretch_kernel(
    x: wp.array2d(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    faces: wp.array2d(dtype=wp.int32),
    rest_inverse: wp.array2d(dtype=wp.mat22),
    rest_area: wp.array2d(dtype=wp.float32),
    mu: wp.float32,
    lam: wp.float32,
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
):
    """StVK membrane of one face of one sample (Barbic and James 2005); also adds the face normal to its corners."""
    s, t = wp.tid()
    a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
    x0 = x[s, a]
    d1 = x[s, b] - x0
    d2 = x[s, c] - x0
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    f1 = d1 * inverse[0, 0] + d2 * inverse[1, 0]
    f2 = d1 * inverse[0, 1] + d2 * inverse[1, 1]
    e11 = 0.5 * (wp.dot(f1, f1) - 1.0)
    e22 = 0.5 * (wp.dot(f2, f2) - 1.0)
    e12 = 0.5 * wp.dot(f1, f2)
    trace = e11 + e22
    energy[s, t] = area * (mu * (e11 * e11 + e22 * e22 + 2.0 * e12 * e12) + 0.5 * lam * trace * trace)
    s11 = 2.0 * mu * e11 + lam * trace
    s22 = 2.0 * mu * e22 + lam * trace
    s12 = 2.0 * mu * e12
    p1 = (f1 * s11 + f2 * s12) * area
    p2 = (f1 * s12 + f2 * s22) * area
    g1 = p1 * inverse[0, 0] + p2 * inverse[0, 1]
    g2 = p1 * inverse[1, 0] + p2 * inverse[1, 1]
    wp.atomic_add(gradient, s, b, g1)
    wp.atomic_add(gradient, s, c, g2)
    wp.atomic_add(gradient, s, a, -g1 - g2)
    normal = wp.cross(d1, d2)
    wp.atomic_add(normals, s, a, normal)
    wp.atomic_add(normals, s, b, normal)
    wp.atomic_add(normals, s, c, normal)


@wp.kernel
def bend_kernel(
    x: wp.array2d(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    hinges: wp.array2d(dtype=wp.int32),
    rest_angle: wp.array2d(dtype=wp.float32),
    stiffness: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Dihedral bending of one hinge of one sample: k (theta - rest)^2 (Grinspun et al. 2003)."""
    s, t = wp.tid()
    i0, i1, i2, i3 = hinges[t, 0], hinges[t, 1], hinges[t, 2], hinges[t, 3]
    x0, x1, x2, x3 = x[s, i0], x[s, i1], x[s, i2], x[s, i3]
    edge = x1 - x0
    length = wp.max(wp.length(edge), 1.0e-9)
    na = wp.cross(edge, x2 - x0)
    nb = wp.cross(x3 - x0, edge)
    na2 = wp.max(wp.dot(na, na), 1.0e-16)
    nb2 = wp.max(wp.dot(nb, nb), 1.0e-16)
    angle = wp.atan2(wp.dot(wp.cross(na, nb), edge) / length, wp.dot(na, nb)) - rest_angle[rest_row[s], t]
    angle = angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))
    k = stiffness[rest_row[s], t]
    energy[s, t] = k * angle * angle
    slope = 2.0 * k * angle
    ga = na * (slope / na2)
    gb = nb * (slope / nb2)
    wp.atomic_add(gradient, s, i2, ga * -length)
    wp.atomic_add(gradient, s, i3, gb * -length)
    wp.atomic_add(gradient, s, i0, (ga * wp.dot(x2 - x1, edge) + gb * wp.dot(x3 - x1, edge)) / -length)
    wp.atomic_add(gradient, s, i1, (ga * wp.dot(x2 - x0, edge) + gb * wp.dot(x3 - x0, edge)) / length)


@wp.kernel
def collision_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body: wp.uint64,
    body_offset: wp.array(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    stiffness: wp.array(dtype=wp.float32),
    contact_offset: wp.float32,
    linear_beyond: wp.float32,
    reach: wp.float32,
    face_bone: wp.array(dtype=wp.int32),
    worn: wp.array2d(dtype=wp.bool),
    own_face: wp.array(dtype=wp.int32),
    normals: wp.array2d(dtype=wp.vec3),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
    signed_distance: wp.array2d(dtype=wp.float32),
    at_worn_part: wp.array2d(dtype=wp.bool),
):
    """Squared depth below the contact offset, to the exact closest point of the posed body; linear when deeper.

    own_face: face of the body that each vertex lies on, which leads back a vertex lost inside the body; or empty.
    """
    s, v = wp.tid()
    point = x[s, v] + body_offset[s]
    hit = wp.mesh_query_point_sign_normal(body, point, reach)
    energy[s, v] = 0.0
    signed_distance[s, v] = reach
    at_worn_part[s, v] = False
    if hit.result:
        closest = wp.mesh_eval_position(body, hit.face, hit.u, hit.v)
        away = point - closest
        gap = wp.length(away)
        distance = hit.sign * gap
        signed_distance[s, v] = distance
        mine = worn[v, face_bone[hit.face % face_bone.shape[0]]]
        at_worn_part[s, v] = mine
        depth = contact_offset - distance
        if depth > 0.0:
            outward = wp.mesh_eval_face_normal(body, hit.face)
            if depth < DEEP or (mine and wp.dot(outward, normals[s, v]) >= 0.0):
                if gap > 1.0e-6:
                    outward = away * (hit.sign / gap)
                k = stiffness[0] * vertex_area[rest_row[s], v]
                bounded = wp.min(depth, linear_beyond)
                energy[s, v] = k * bounded * (2.0 * depth - bounded)
                wp.atomic_add(gradient, s, v, outward * (-2.0 * k * bounded))
            elif own_face.shape[0] > 0:
                face = s * face_bone.shape[0] + own_face[v]
                outward = wp.mesh_eval_face_normal(body, face)
                centre = wp.mesh_eval_position(body, face, 1.0 / 3.0, 1.0 / 3.0)
                behind = contact_offset - wp.dot(point - centre, outward)
                if behind > 0.0:
                    k = stiffness[0] * vertex_area[rest_row[s], v]
                    bounded = wp.min(behind, LED_BACK_BEYOND)
                    energy[s, v] = k * bounded * (2.0 * behind - bounded)
                    wp.atomic_add(gradient, s, v, outward * (-2.0 * k * bounded))


@wp.kernel
def band_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body_points: wp.array(dtype=wp.vec3),
    body_offset: wp.array(dtype=wp.vec3),
    vertices_per_body: wp.int32,
    band: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Squared distance of a band vertex beyond its limit from the body vertex where it is worn."""
    s, k = wp.tid()
    v = band[k]
    away = x[s, v] + body_offset[s] - body_points[s * vertices_per_body + place[k]]
    distance = wp.length(away)
    beyond = distance - limit[k]
    energy[s, k] = 0.0
    if beyond > 0.0:
        stiffness = BAND_STIFFNESS * vertex_area[rest_row[s], v]
        energy[s, k] = stiffness * beyond * beyond
        wp.atomic_add(gradient, s, v, away * (2.0 * stiffness * beyond / distance))


@wp.kernel
def gravity_kernel(
    x: wp.array2d(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    weight: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Potential energy, height measured against the gravity direction from the root."""
    s, v = wp.tid()
    pull = weight[rest_row[s], v]
    energy[s, v] = -pull * wp.dot(x[s, v], direction[s])
    wp.atomic_add(gradient, s, v, direction[s] * -pull)


@dataclass(frozen=True)
class Energies:
    """Energies of each sample (B,) [J] by term, signed distance to the body (B, n) [m], capped at the reach, and
    whether the closest part of the body is one that the vertex is worn on (B, n) bool."""

    stretch: torch.Tensor
    bend: torch.Tensor
    collision: torch.Tensor
    gravity: torch.Tensor
    band: torch.Tensor
    signed_distance: torch.Tensor
    at_worn_part: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """Sum of the terms (B,)."""
        return self.stretch + self.bend + self.collision + self.gravity + self.band


class PhysicsLosses:
    """Physics losses of one garment for a fixed number of samples on one device.

    contact_stiffness is a tensor (1,) [J/m4] that a schedule may change between steps. reach: farthest distance [m] at
    which the body is looked for, read at every call. wearing: what of the body counts as contact, and the band; without
    it all of the body counts and nothing holds the garment up. For training only, and by default none of them acts:
    contact force grows no more from a depth of `linear_beyond` [m]; with `leads_back`, a vertex deep in the body whose
    hit does not count, as it is in another limb or on the wrong side, is pushed before the plane of the body face it is
    worn on; a sample's gradient is weighted by 1 / sqrt(1 + E / heavy_energy) of its energy E [J] without gravity, so
    that the few heaviest poses do not outweigh all others.
    rest: the garment's rest shapes, default its own alone; `rest_row` (B,) int32 says which of them each sample has,
    the first one until it is changed in place.
    """

    def __init__(
        self,
        garment: Garment,
        material: Material,
        samples: int,
        device: torch.device,
        *,
        wearing: Wearing | None = None,
        reach: float = 0.1,
        linear_beyond: float = math.inf,
        leads_back: bool = False,
        heavy_energy: float = math.inf,
        rest: RestData | None = None,
    ) -> None:
        self.material = material
        self.reach = reach
        self.linear_beyond = linear_beyond
        self.heavy_energy = heavy_energy
        self.device = wp.device_from_torch(device)
        young, poisson = material.youngs_modulus, material.poisson_ratio
        self._mu = young / (2 * (1 + poisson))
        self._lam = young * poisson / (1 - poisson**2)  # plane stress
        self.contact_stiffness = torch.full((1,), material.contact_stiffness, device=device)
        n, f, q = len(garment.vertices), len(garment.faces), len(garment.hinges)
        self._faces = self._array(garment.faces, wp.int32)
        self._hinges = self._array(garment.hinges, wp.int32)
        self.rest = rest or RestData(garment, material, device)
        self.rest_row = torch.zeros(samples, dtype=torch.int32, device=device)

        def buffer(count: int) -> torch.Tensor:
            return torch.zeros(samples, count, device=device)

        self._element = {
            "stretch": buffer(f),
            "bend": buffer(q),
            "collision": buffer(n),
            "gravity": buffer(n),
            "band": buffer(0 if wearing is None else len(wearing.band)),
        }
        face_bone = np.zeros(1) if wearing is None else wearing.face_bone
        worn = np.ones((n, 1), dtype=bool) if wearing is None else wearing.worn
        own_face = wearing.own_face if leads_back and wearing is not None else np.zeros(0)
        self._face_bone = self._array(face_bone, wp.int32)
        self._own_face = self._array(own_face, wp.int32)
        self._worn = wp.array(worn, dtype=wp.bool, device=self.device)
        self._band: list[wp.array] = []
        if wearing is not None:
            limit = wearing.band_distance + BAND_SLACK
            self._band = [
                self._array(wearing.band, wp.int32),
                self._array(wearing.band_place, wp.int32),
                self._array(limit, wp.float32),
            ]
        self._normals = torch.zeros(samples, n, 3, device=device)
        self.signed_distance = buffer(n)
        self.at_worn_part = torch.zeros(samples, n, dtype=torch.bool, device=device)

    def __call__(
        self, x: torch.Tensor, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor
    ) -> tuple[torch.Tensor, Energies]:
        """Energies of garment vertices x (B, n, 3) under gravity (B, 3) against the posed bodies.

        body: one Warp mesh of all samples' posed bodies, sample s displaced by body_offset[s] (B, 3).
        Returns the differentiable mean total energy [J] and the (detached) energies.
        """
        total, *parts = _PhysicsEnergy.apply(x, self, gravity, body, body_offset)
        return total, Energies(*parts, signed_distance=self.signed_distance, at_worn_part=self.at_worn_part)

    def evaluate(
        self, x: torch.Tensor, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Energies (B,) by term and their summed gradient dE/dx (B, n, 3), without autograd."""
        samples, n, _ = x.shape
        x = x.detach().contiguous()
        gradient = torch.zeros_like(x)
        self._normals.zero_()
        points, forces = _vec3(x), _vec3(gradient)
        rest, row = self.rest, wp.from_torch(self.rest_row)
        rest_inverse = wp.from_torch(rest.rest_inverse, dtype=wp.mat22)
        vertex_area = wp.from_torch(rest.vertex_area)
        element = {name: wp.from_torch(tensor) for name, tensor in self._element.items()}
        wp.launch(
            stretch_kernel,
            dim=(samples, self._faces.shape[0]),
            inputs=[points, row, self._faces, rest_inverse, wp.from_torch(rest.face_area), self._mu, self._lam],
            outputs=[element["stretch"], forces, _vec3(self._normals)],
            device=self.device,
        )
        wp.launch(
            bend_kernel,
            dim=(samples, self._hinges.shape[0]),
            inputs=[
                *(points, row, self._hinges),
                *(wp.from_torch(rest.hinge_angle), wp.from_torch(rest.bend_stiffness)),
            ],
            outputs=[element["bend"], forces],
            device=self.device,
        )
        wp.launch(
            collision_kernel,
            dim=(samples, n),
            inputs=[
                points,
                body.id,
                wp.from_torch(body_offset, dtype=wp.vec3),
                row,
                vertex_area,
                wp.from_torch(self.contact_stiffness),
                self.material.contact_offset,
                self.linear_beyond,
                self.reach,
                self._face_bone,
                self._worn,
                self._own_face,
                _vec3(self._normals),
            ],
            outputs=[
                element["collision"],
                forces,
                wp.from_torch(self.signed_distance),
                wp.from_torch(self.at_worn_part),
            ],
            device=self.device,
        )
        wp.launch(
            gravity_kernel,
            dim=(samples, n),
            inputs=[
                *(points, wp.from_torch(gravity.contiguous(), dtype=wp.vec3), row),
                wp.from_torch(rest.weight),
            ],
            outputs=[element["gravity"], forces],
            device=self.device,
        )
        if self._band:
            wp.launch(
                band_kernel,
                dim=(samples, len(self._band[0])),
                inputs=[
                    points,
                    body.points,
                    wp.from_torch(body_offset, dtype=wp.vec3),
                    len(body.points) // samples,
                    *self._band,
                    row,
                    vertex_area,
                ],
                outputs=[element["band"], forces],
                device=self.device,
            )
        return {name: tensor.sum(dim=1) for name, tensor in self._element.items()}, gradient

    @property
    def element_energies(self) -> dict[str, torch.Tensor]:
        """Energies [J] by term and element, each (B, elements), where last evaluated; contact and gravity by vertex."""
        return self._element

    def _array(self, values: np.ndarray, dtype) -> wp.array:
        scalar = np.int32 if dtype is wp.int32 else np.float32
        return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype, device=self.device)


class _PhysicsEnergy(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, losses, gravity, body, body_offset):
        energies, gradient = losses.evaluate(x, gravity, body, body_offset)
        if math.isfinite(losses.heavy_energy):
            strained = energies["stretch"] + energies["bend"] + energies["collision"] + energies["band"]
            gradient = gradient * torch.rsqrt(1 + strained / losses.heavy_energy)[:, None, None]
        ctx.save_for_backward(gradient)
        parts = tuple(energies[name] for name in TERMS)
        ctx.mark_non_differentiable(*parts)
        return sum(parts).mean(), *parts

    @staticmethod
    def backward(ctx, upstream, *_):
        (gradient,) = ctx.saved_tensors
        return gradient * (upstream / len(gradient)), None, None, None, None


def _vec3(tensor: torch.Tensor) -> wp.array:
    return wp.from_torch(tensor, dtype=wp.vec3)
