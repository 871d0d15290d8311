"""A crumpled tube of cloth over a floor, in motion: every energy acts."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from random_models import tube

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.contact.wearing import Wearing
from physkin_training.dynamics.incremental_potential import IncrementalPotential
from physkin_training.energies.motion import Dynamics
from physkin_training.energies.rest_data import RestData
from physkin_training.physics.energy_hessian import EnergyHessian

CPU = torch.device("cpu")
SAMPLES = 2
STEP = 1 / 120
FLOOR = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]], dtype=np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
LINEAR_BEYOND = 0.006


class CrumpledTube:
    """Two samples of a tube about the origin, 12 cm high, of other rest shapes and bending, over a floor at height
    `floor`; three of its vertices are tied to corners of the floor, and weak threads draw six together. It bends from
    the shape that it was made in. `potential`: of a step that `begin` told of.

    only: of the energies, default all. worn: whether deep contact counts. scale: of the rest shape.
    """

    def __init__(
        self, only: str | None = None, *, floor: float = -0.057, worn: bool = True, scale: float = 1.0, **options
    ) -> None:
        wp.config.quiet = True
        wp.init()
        made = tube(rings=4, segments=7, radius=0.1, height=0.12)
        self.garment = Garment(made.vertices, made.faces, threads=np.array([[1, 7], [4, 10], [19, 25]]))
        n = len(self.garment.vertices)
        self.offset, self.down = torch.tensor([[0.0, 0, 0], [1, 0, 0]]), torch.tensor([[0.0, 0, -1]] * SAMPLES)
        points = np.concatenate([FLOOR + [0, 0, floor] + offset for offset in self.offset.numpy()])
        corners = wp.array(np.concatenate([FACES, FACES + len(FLOOR)]).reshape(-1), dtype=wp.int32, device="cpu")
        self.body = wp.Mesh(wp.array(points, dtype=wp.vec3, device="cpu"), corners)
        wearing = Wearing(
            *(FACES, np.zeros(2, np.int32), np.full((n, 1), worn), np.zeros((n, 1), bool), np.zeros(1, bool)),
            *(
                np.zeros(n, np.int32),
                np.full(n, -1),
                np.arange(3),
                np.arange(3),
                np.zeros(3, np.float32),
                np.zeros(n, bool),
            ),
        )
        material = Material(bending=1e-3, contact_stiffness=1e5, rest_angles="as_made")
        shapes = np.stack([self.garment.vertices, self.garment.vertices * [1.2, 0.9, 1.1]])
        self.potential = IncrementalPotential(
            *(self.garment, material, SAMPLES, CPU),
            step=options.pop("step", STEP),
            dynamics=options.pop("dynamics", Dynamics(air_drag=40.0, relaxation=0.05)),
            wearing=wearing,
            rest=RestData(self.garment, material, CPU, shapes=shapes),
            rest_row=torch.tensor(options.pop("rows", [1, 0])),
            **options,
        )
        self.potential.bend.stiffer.copy_(torch.tensor([1.0, 3.0]))
        (threads,) = [each for each in self.potential.energies if each.name == "threads"]
        threads.stiffness.fill_(3.0)
        if only:
            self.potential.energies = [each for each in self.potential.energies if each.name == only]
        self.rest = torch.tensor(np.stack([self.garment.vertices] * SAMPLES), dtype=torch.float32)
        self.x = self.crumpled(0, scale)
        self.potential.begin(self.crumpled(1), self.crumpled(2))
        self.hessian = EnergyHessian(self.potential)

    def crumpled(self, seed: int, scale: float = 1.0) -> torch.Tensor:
        """Vertices (B, n, 3), each moved some 2 mm."""
        noise = np.random.default_rng(seed).normal(scale=2e-3, size=self.rest.shape)
        return scale * self.rest + torch.tensor(noise, dtype=torch.float32)

    def evaluate(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Energy (B,) and its gradient (B, n, 3), float64."""
        _, gradient = self.potential.evaluate(x, self.down, self.body, self.offset)
        return sum(each.values.double().sum(dim=1) for each in self.potential.energies), gradient.double()

    def assemble(self, *, exact: bool) -> None:
        """The second derivative at `self.x`."""
        self.evaluate(self.x)
        self.hessian.assemble(torch.full((SAMPLES,), exact))

    def product(self, x: torch.Tensor) -> torch.Tensor:
        """The second derivative that was assembled last times x, both (B, n, 3)."""
        product = torch.zeros_like(x)
        self.hessian.multiply(x, product)
        return product

    def matrix(self, *, exact: bool, sample: int = 0) -> np.ndarray:
        """The second derivative (3 n, 3 n) at `self.x`, column by column."""
        self.assemble(exact=exact)
        columns = []
        for column in range(self.x[0].numel()):
            unit = torch.zeros_like(self.x)
            unit.view(SAMPLES, -1)[:, column] = 1.0
            columns.append(self.product(unit)[sample].reshape(-1).numpy().astype(float))
        return np.stack(columns, axis=1)
