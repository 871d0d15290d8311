"""Physics losses (paper: Training): the mean energy of drapes, with its gradient, for torch.

torch sees one differentiable operation, whose backward pass is a product. Nothing allocates or waits for the host, so a
training step can be captured as a CUDA graph. The energies themselves are in `energy_kernels`.

Dimensions: `B` samples, `n` garment vertices, `f` faces, `q` hinges, `V` body vertices, `k` band vertices. Metres,
root frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.physics.energy_kernels import (
    BAND_SLACK,
    band_kernel,
    bend_kernel,
    collision_kernel,
    gravity_kernel,
    stretch_kernel,
)
from physkin_training.physics.rest_data import RestData
from physkin_training.physics.wearing import Wearing

__all__ = ["TERMS", "Energies", "PhysicsLosses"]

TERMS = ("stretch", "bend", "collision", "gravity", "band")
"""The energies, in the order of `Energies`."""


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
    the first one until it is changed in place; `stiffer` (B,) says how many times as stiffly its cloth bends.
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
        self.stiffer = torch.ones(samples, device=device)

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
        other_limb = np.zeros_like(worn) if wearing is None else wearing.other_limb
        own_face = np.zeros(n) if wearing is None else wearing.own_face
        self._leads_back = leads_back and wearing is not None
        self._face_bone = self._array(face_bone, wp.int32)
        self._own_face = self._array(own_face, wp.int32)
        self._worn = wp.array(worn, dtype=wp.bool, device=self.device)
        self._other_limb = wp.array(other_limb, dtype=wp.bool, device=self.device)
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
                *(wp.from_torch(rest.hinge_angle), wp.from_torch(rest.bend_stiffness), wp.from_torch(self.stiffer)),
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
                self._other_limb,
                self._own_face,
                self._leads_back,
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
