"""Training on simulated drapes instead of on their energy, to compare with (paper: Ablation Studies, Supervision).

Drapes of training bodies at random poses are minimised in the full space, the body being moved there from the canonical
pose in stages; the same networks then learn their vertices by squared distance.
Dimensions: `G` groups of one body each, `k` drapes a group, `B` samples of a batch, `n` garment vertices, `d` degrees
of freedom.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from physkin_core.avatar.body_model import BodyModel
from physkin_training.config import TrainingConfig
from physkin_training.networks.draping import Drape
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.newton_solver import Solution
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.physics.staged_drape import drape_in_stages
from physkin_training.physics.wearing import Wearing
from physkin_training.sampling.pose_sampling import PoseSampler
from physkin_training.sampling.posed_bodies import PosedBodies
from physkin_training.train.trainer import Trainer

__all__ = ["SimulatedDrapes", "SupervisedTrainer", "simulate_drapes"]

log = logging.getLogger(__name__)
REACH = 0.3
"""The body is looked for up to this distance [m]."""
STAGES = 6
DISTANCE_UNIT = 0.01
"""Distances are squared in this unit [m]: gradients then have about the size of those of energies."""


@dataclass(frozen=True)
class SimulatedDrapes:
    """Drapes to learn, on one device.

    positions (G, k, d) [rad], gravity (G, k, 3), body (G,) int64 index of a training body, vertices (G, k, n, 3) [m],
    gradient_norm (G, k) [N] left by the solver and whether it converged (G, k) bool.
    """

    positions: torch.Tensor
    gravity: torch.Tensor
    body: torch.Tensor
    vertices: torch.Tensor
    gradient_norm: torch.Tensor
    converged: torch.Tensor


def simulate_drapes(
    trainer: Trainer, count: int, folder: Path, *, batch: int, tolerance: float = 0.05, iterations: int = 100
) -> SimulatedDrapes:
    """At least `count` drapes of the trainer's garment on its training bodies, its configuration's poses at full range.

    As many drapes a body as its steps have samples. batch: drapes minimised at once. Every batch is stored in `folder`
    when done, and taken from there the next time. tolerance, iterations: of `FullSpaceSolver.minimise`.
    Raises ValueError when count or batch are below 1.
    """
    if count < 1 or batch < 1:
        raise ValueError(f"drapes and their batch must be at least 1, got {count} and {batch}")
    config, device = trainer.config, trainer.device
    per_body = config.optimisation.samples // config.optimisation.bodies
    groups = math.ceil(count / per_body)
    generator = torch.Generator().manual_seed(config.seed)
    order = [torch.randperm(len(trainer.bodies), generator=generator) for _ in range(-(-groups // len(trainer.bodies)))]
    body = torch.cat(order)[:groups]
    sampler = PoseSampler.of_training(trainer.rig, torch.device("cpu"))
    positions, gravity = sampler.sample(groups * per_body, 1.0, generator=generator)
    every = body.repeat_interleave(per_body)
    simulation = None
    parts = []
    folder.mkdir(parents=True, exist_ok=True)
    for start in range(0, len(every), batch):
        path = folder / f"drapes_{start:06d}_of_{len(every)}_by_{batch}.safetensors"
        if not path.exists():
            simulation = simulation or _StagedSimulation(trainer, trainer.body_model, batch)
            pick = torch.arange(start, start + batch) % len(every)  # a last partial batch is filled up
            pairs = (values[pick].to(device) for values in (positions, gravity, every))
            part = simulation.run(*pairs, tolerance=tolerance, iterations=iterations)
            kept = min(batch, len(every) - start)
            partial = path.with_suffix(".partial")
            save_file({name: values[:kept].cpu().contiguous() for name, values in part.items()}, partial)
            partial.replace(path)
        parts.append(load_file(path))
        log.info("simulated %d of %d drapes", min(start + batch, len(every)), len(every))
    whole = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    whole |= {"positions": positions, "gravity": gravity}
    grouped = {name: values.unflatten(0, (groups, per_body)).to(device) for name, values in whole.items()}
    return SimulatedDrapes(body=body.to(device), **grouped)


class _StagedSimulation:
    """Drapes of one trainer's garment, `samples` at once, from plain skinning at the canonical pose onwards."""

    def __init__(self, trainer: Trainer, body_model: BodyModel, samples: int) -> None:
        garment, device = trainer.garment, trainer.device
        self._drape: Drape = trainer.drape
        self._node_positions = trainer.drape.node_positions(trainer.bodies)
        self._rest = torch.as_tensor(trainer.rig.rest.copy(), dtype=torch.float32, device=device)
        self._posed = PosedBodies(body_model, trainer.bodies, samples)
        wearing = Wearing.of(garment, body_model)
        losses = PhysicsLosses(garment, trainer.config.material, samples, device, wearing=wearing, reach=REACH)
        self.solver = FullSpaceSolver(losses)

    @torch.no_grad()
    def run(
        self, positions: torch.Tensor, gravity: torch.Tensor, body: torch.Tensor, *, tolerance: float, iterations: int
    ) -> dict[str, torch.Tensor]:
        """Minimise at joint positions (B, d), gravity (B, 3) on bodies (B,). Returns the fields of `SimulatedDrapes`
        that are the solver's, each (B, ...)."""
        upright = torch.tensor([0.0, 0.0, -1.0], device=gravity.device)

        def skinned_at(share: float) -> tuple[torch.Tensor, torch.Tensor]:
            nodes = self._drape.posed_nodes(
                self._posed.pose(self._rest + share * (positions - self._rest), body), self._node_positions[body]
            )
            return self._drape.skin(nodes), self._drape.linear_parts(nodes)

        def minimise(start: torch.Tensor, share: float, **options) -> Solution:
            down = torch.nn.functional.normalize(upright + share * (gravity - upright), dim=1)
            return self.solver.minimise(start, down, self._posed.mesh, self._posed.offset, **options)

        solution = drape_in_stages(skinned_at, minimise, stages=STAGES, tolerance=tolerance, iterations=iterations)
        names = ("vertices", "gradient_norm", "converged")
        return {name: getattr(solution, name) for name in names}


class SupervisedTrainer(Trainer):
    """A training run on simulated drapes: all of one body's drapes for every body of a step, all of the template.

    The model is the moving average at the end: which one has the least energy is not for it to know. Raises ValueError
    when the drapes are not as many a body as a step's samples.
    """

    def __init__(self, config: TrainingConfig, device: torch.device, drapes: SimulatedDrapes) -> None:
        super().__init__(config, device)
        if drapes.positions.shape[1] != self._samples // self._bodies:
            raise ValueError(f"drapes must be {self._samples // self._bodies} a body, got {drapes.positions.shape[1]}")
        self._drapes = drapes
        self.made.zero_()

    def draw(self) -> tuple[torch.Tensor, ...]:
        group = torch.randint(len(self._drapes.body), (self._bodies,), device=self.device)
        chosen = self._drapes.body[group]
        positions, gravity, self._targets = (
            values[group].flatten(0, 1)
            for values in (self._drapes.positions, self._drapes.gravity, self._drapes.vertices)
        )
        return chosen, positions, gravity, *self.bodies.sample_points(chosen, self.schedule.encoder_points)

    def objective(self, vertices: torch.Tensor, gravity: torch.Tensor) -> torch.Tensor:
        """Mean squared distance of vertices (B, n, 3) from the simulated ones, in units of `DISTANCE_UNIT`."""
        return ((vertices - self._targets) / DISTANCE_UNIT).square().sum(dim=-1).mean()

    def validate(self) -> None:
        """Nothing: the energy is kept out of it."""
