"""Physics losses (paper: Training): the mean energy of drapes, with its gradient, for torch.

torch sees one differentiable operation, whose backward pass is a product. Nothing allocates or waits for the host, so a
training step can be captured as a CUDA graph. The energies themselves are in `physkin_training.energies`.

Dimensions: `B` samples, `n` garment vertices. Metres, root frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.band import Band
from physkin_training.energies.bend import Bend
from physkin_training.energies.collision import Collision
from physkin_training.energies.energy import Cloth, Drapes, Energy, view
from physkin_training.energies.gravity import Gravity
from physkin_training.energies.rest_data import RestData
from physkin_training.energies.seams import Threads
from physkin_training.energies.self_contact import SelfContact
from physkin_training.energies.stretch import Stretch
from physkin_training.quiet_warp import wp

__all__ = ["TERMS", "Energies", "PhysicsLosses", "gradient_weight", "lightened"]

TERMS = ("stretch", "bend", "collision", "self_contact", "gravity", "band", "threads")
"""The energies, in the order of `Energies`."""


@dataclass(frozen=True)
class Energies:
    """Energies of each sample (B,) [J] by term, signed distance to the body (B, n) [m], capped at the reach, and
    whether the closest part of the body is one that the vertex is worn on (B, n) bool."""

    stretch: torch.Tensor
    bend: torch.Tensor
    collision: torch.Tensor
    self_contact: torch.Tensor
    gravity: torch.Tensor
    band: torch.Tensor
    threads: torch.Tensor
    signed_distance: torch.Tensor
    at_worn_part: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """Sum of the terms (B,)."""
        return sum(getattr(self, name) for name in TERMS)

    @property
    def strained(self) -> torch.Tensor:
        """All terms but gravity (B,)."""
        return self.total - self.gravity


def gradient_weight(energy: torch.Tensor, heavy_energy: float) -> torch.Tensor:
    """What the gradient of a sample of energy E [J] counts in `PhysicsLosses`: 1 / sqrt(1 + E / heavy_energy)."""
    return torch.rsqrt(1 + energy / heavy_energy)


def lightened(energy: torch.Tensor, heavy_energy: float) -> torch.Tensor:
    """What an energy E [J] counts where its gradient is weighted as a sample's: the integral of `gradient_weight`."""
    return 2 * heavy_energy * ((1 + energy / heavy_energy).sqrt() - 1)


class PhysicsLosses:
    """Physics losses of one garment for a fixed number of samples on one device.

    wearing: what of the body counts as contact, where the garment may touch itself, and the band; without it all of the
    body counts, cloth passes through itself and nothing holds the garment up. For training only, and by default none of
    them acts: contact force grows no more from a depth of `linear_beyond` [m]; with `leads_back`, a vertex deep in the
    body whose hit does not count, as it is in another limb or on the wrong side, is pushed before the plane of the body
    face it is worn on; a sample's gradient is weighted by 1 / sqrt(1 + E / heavy_energy) of its energy E [J] without
    gravity, so that the few heaviest poses do not outweigh all others.
    rest: the garment's rest shapes, default its own alone; `rest_row` (B,) int32 says which of them each sample has,
    the first one until it is changed in place. `energies`: all that count, in order. A schedule may change how far and
    how hard the body presses, `collision.reach` and `collision.stiffness`, and how stiffly cloth bends, `bend.stiffer`.
    `drapes`: where they were evaluated last.
    """

    drapes: Drapes

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
        self.material, self.heavy_energy = material, heavy_energy
        self.rest = rest or RestData(garment, material, device)
        self.rest_row = torch.zeros(samples, dtype=torch.int32, device=device)
        self.cloth = Cloth(garment, material, self.rest, self.rest_row)
        self.bend, self.band = Bend(self.cloth), Band(self.cloth, wearing)
        self.collision = Collision(self.cloth, wearing, reach=reach, linear_beyond=linear_beyond, leads_back=leads_back)
        self.stretch = Stretch(self.cloth)
        touching = wearing and wearing.touching
        self.self_contact = SelfContact(self.cloth, touching, linear_beyond=linear_beyond)
        felt = self.stretch, self.bend, self.collision, self.self_contact
        self.energies: list[Energy] = [*felt, Gravity(self.cloth), self.band, Threads(self.cloth)]
        self._normals = self.cloth.zeros(len(garment.vertices), 3)

    def __call__(
        self, x: torch.Tensor, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor
    ) -> tuple[torch.Tensor, Energies]:
        """Energies of garment vertices x (B, n, 3) under gravity (B, 3) against the posed bodies.

        body: one Warp mesh of all samples' posed bodies, sample s displaced by body_offset[s] (B, 3).
        Returns the differentiable mean total energy [J] and the (detached) energies.
        """
        total, *parts = _PhysicsEnergy.apply(x, self, gravity, body, body_offset)
        terms = dict(zip((energy.name for energy in self.energies), parts))
        contact = self.collision
        return total, Energies(**terms, signed_distance=contact.signed_distance, at_worn_part=contact.at_worn_part)

    def evaluate(
        self, x: torch.Tensor, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Energies (B,) by term and their summed gradient dE/dx (B, n, 3), without autograd."""
        x = x.detach().contiguous()
        gradient = torch.zeros_like(x)
        self._normals.zero_()
        self.drapes = drapes = Drapes()
        drapes.x, drapes.gradient, drapes.normals = view(x), view(gradient), view(self._normals)
        drapes.gravity, drapes.offset = view(gravity.contiguous()), view(body_offset.contiguous())
        drapes.body, drapes.body_points = body.id, body.points
        for energy in self.energies:
            energy.evaluate(drapes)
        return {energy.name: energy.values.sum(dim=1) for energy in self.energies}, gradient


class _PhysicsEnergy(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, losses, gravity, body, body_offset):
        energies, gradient = losses.evaluate(x, gravity, body, body_offset)
        if math.isfinite(losses.heavy_energy):
            strained = sum(energies[name] for name in TERMS if name != "gravity")
            gradient = gradient * gradient_weight(strained, losses.heavy_energy)[:, None, None]
        ctx.save_for_backward(gradient)
        parts = tuple(energies.values())
        ctx.mark_non_differentiable(*parts)
        return sum(parts).mean(), *parts

    @staticmethod
    def backward(ctx, upstream, *_):
        (gradient,) = ctx.saved_tensors
        return gradient * (upstream / len(gradient)), None, None, None, None
