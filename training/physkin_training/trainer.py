"""Joint optimisation of networks and skinning weights by physics losses alone (paper: Training).

One step draws bodies, poses and gravity, encodes the bodies, drapes the garment and descends the mean physical energy.
On a GPU the step is captured as a CUDA graph and replayed: everything that changes between steps (pose range, contact
stiffness, learning rates) sits in tensors.

Dimensions: `B` samples, `S` bodies of a step, `n` garment vertices.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path

import torch
import warp as wp

from physkin_core.body_model import load_body_model
from physkin_core.garment import load_garment
from physkin_core.hyper_modulator import POINT_COUNT
from physkin_training.checkpoint import load_checkpoint, load_drape, save_checkpoint
from physkin_training.config import TrainingConfig
from physkin_training.draping import Drape, GarmentNodes
from physkin_training.physics_losses import TERMS, PhysicsLosses
from physkin_training.pose_sampling import PoseSampler, pose_range
from physkin_training.posed_bodies import BodySet, PosedBodies
from physkin_training.wearing import Wearing

__all__ = ["Trainer", "TrainingDiverged"]


EARLY_REACH = 0.1
"""How far [m] bodies are looked for while the pose range grows: heavy ones start that deep in the garment."""


NORMALISING_POSES = 2048
"""Poses from which the node deformer's inputs are scaled."""


def influences_left(progress: float, config: TrainingConfig) -> int:
    """Influences a vertex at `progress` (0 to 1) of the run: they fall one by one from `prune_from` to `prune_at`."""
    most, fewest = config.garment_nodes.initial_influences, config.garment_nodes.influences
    start, end = config.optimisation.prune_from, config.optimisation.prune_at
    if progress < start:
        return most
    if progress >= end:
        return fewest
    return most - math.ceil((most - fewest) * (progress - start) / (end - start))


class TrainingDiverged(RuntimeError):
    """Energies or gradients are no longer finite."""


class Trainer:
    """A training run that can stop anywhere and go on exactly.

    `step` counts finished steps; `drape` is the model in training, `averaged` its exponential moving average, which is
    what to export and evaluate (the drape itself where the configuration averages nothing). `started_from`: plain data
    on the run this one took its networks from, or None.
    """

    def __init__(self, config: TrainingConfig, device: torch.device) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.device = device
        self.step = 0
        self.started_from: dict | None = None
        optimisation = config.optimisation
        body_model = load_body_model()
        if config.train_bodies > len(body_model.train_bodies):
            raise ValueError(f"train_bodies must be 1 to {len(body_model.train_bodies)}, got {config.train_bodies}")
        self.rig = body_model.rig
        self.garment = load_garment(config.garment)
        nodes = GarmentNodes.sample(
            self.garment, self.rig, config.garment_nodes.count, config.garment_nodes.initial_influences
        )
        self.nodes = nodes
        self.drape = Drape(self.garment, nodes, self.rig, config.networks).to(device)
        self.bodies = BodySet(body_model, body_model.train_bodies[: config.train_bodies], device)
        self.node_positions = self.drape.node_positions(self.bodies)
        self.sampler = PoseSampler(
            self.rig,
            device,
            upright=config.poses.upright,
            largest_tilt=math.radians(config.poses.largest_tilt_degrees),
        )
        wearing = Wearing.of(self.garment, body_model).worn_faces()
        self.posed_bodies = PosedBodies(body_model, self.bodies, optimisation.samples, faces=wearing.faces)
        self._normalise_nodes()
        self.averaged = copy.deepcopy(self.drape).requires_grad_(False) if optimisation.average > 0 else self.drape
        self.losses = PhysicsLosses(
            self.garment,
            config.material,
            optimisation.samples,
            device,
            wearing=wearing,
            reach=EARLY_REACH,
            linear_beyond=optimisation.contact_linear_beyond,
            heavy_energy=optimisation.heavy_energy,
        )
        self.range = torch.zeros((), device=device)
        self._average_decay = torch.zeros((), device=device)
        self._energy_sum = torch.zeros(len(TERMS), device=device)
        self._stretch_and_collision = torch.zeros(optimisation.samples, device=device)
        self._summed_from = 0
        self.gradient_norm = torch.zeros((), device=device)
        self.optimiser = self._make_optimiser()
        self._graph: torch.cuda.CUDAGraph | None = None
        self._influences = config.garment_nodes.initial_influences
        self._encoder_points = config.optimisation.encoder_points

    def run(self, steps: int) -> Iterator[int]:
        """Do up to `steps` steps, yielding the count of finished ones after each."""
        end = min(self.step + steps, self.config.optimisation.steps)
        while self.step < end:
            self._set_schedules()
            self._replay_step()
            self.step += 1
            yield self.step

    def mean_energies(self) -> dict[str, float]:
        """Mean energies [J] a sample by term over the steps since the last call. Waits for the device.

        Raises TrainingDiverged when they are not finite.
        """
        self.check_finite()
        steps = max(1, self.step - self._summed_from)
        means = (self._energy_sum / steps).tolist()
        self._energy_sum.zero_()
        self._summed_from = self.step
        return dict(zip(TERMS, means, strict=True))

    def median_energy(self) -> float:
        """Median of stretch and contact energy [J] over the last step's samples: the few worst poses, which decide the
        mean, do not move it. Waits for the device."""
        return self._stretch_and_collision.median().item()

    def check_finite(self) -> None:
        """Raise TrainingDiverged when energies since the last report or the last gradient are not finite."""
        if not torch.isfinite(torch.cat([self._energy_sum, self.gradient_norm[None]])).all():
            raise TrainingDiverged(f"energies or gradients are not finite at step {self.step}")

    def save(self, folder: Path) -> None:
        """Write a checkpoint (see `physkin_training.checkpoint`). Raises TrainingDiverged and leaves `folder` as it is
        when the run has diverged."""
        self.check_finite()
        save_checkpoint(
            folder,
            self.drape,
            self.averaged,
            self.optimiser,
            step=self.step,
            config=self.config,
            started_from=self.started_from,
        )

    def resume(self, folder: Path) -> None:
        """Go on from a checkpoint of the same configuration."""
        step, self.started_from = load_checkpoint(folder, self.drape, self.averaged, self.optimiser, config=self.config)
        self.step = self._summed_from = step

    def start_from(self, folder: Path) -> None:
        """Begin a new run with the networks and skinning weights of another run's checkpoint."""
        self.started_from = load_drape(folder, self.drape)
        self.averaged.load_state_dict(self.drape.state_dict())

    def _normalise_nodes(self) -> None:
        """Scale the node deformer's inputs by their spread over poses of the full range."""
        samples = self.config.optimisation.samples
        posed = []
        for _ in range(math.ceil(NORMALISING_POSES / samples)):
            positions, _ = self.sampler.sample(samples, 1.0)
            body = torch.randint(len(self.bodies), (samples,), device=self.device)
            bones = self.posed_bodies.pose(positions, body)
            posed.append(self.drape.posed_nodes(bones, self.node_positions[body]))
        self.drape.networks.normalise_nodes(torch.cat(posed))

    def _make_optimiser(self) -> torch.optim.Adam:
        """Adam whose learning rates sit in tensors, which `_set_schedules` fills."""
        groups = [
            {"params": list(self.drape.networks.parameters()), "lr": torch.zeros((), device=self.device)},
            {"params": [self.drape.skinning_logits], "lr": torch.zeros((), device=self.device)},
        ]
        on_gpu = self.device.type == "cuda"
        return torch.optim.Adam(groups, capturable=on_gpu, fused=on_gpu)

    def _set_schedules(self) -> None:
        optimisation = self.config.optimisation
        progress = self.step / optimisation.steps
        self.range.fill_(pose_range(progress, optimisation.growth))
        ramp = min(1.0, progress / optimisation.growth) if optimisation.growth > 0 else 1.0
        softness = optimisation.initial_contact + (1 - optimisation.initial_contact) * ramp
        self.losses.contact_stiffness.fill_(self.config.material.contact_stiffness * softness)
        warm = min(1.0, (progress + 1e-9) / optimisation.warm_up) if optimisation.warm_up > 0 else 1.0
        cosine = 0.5 * (1 + math.cos(math.pi * progress))
        factor = warm * (optimisation.final_rate + (1 - optimisation.final_rate) * cosine)
        rates = (optimisation.learning_rate, optimisation.skinning_rate)
        for group, rate in zip(self.optimiser.param_groups, rates, strict=True):
            group["lr"].fill_(rate * factor)
        # A young average forgets faster, so that it does not hold on to the untrained start.
        self._average_decay.fill_(min(optimisation.average, (1 + self.step) / (10 + self.step)))
        influences = influences_left(progress, self.config)
        if influences < self._influences:
            self._influences = influences
            self.drape.prune_influences(influences)
            self.averaged.influence_bias.copy_(self.drape.influence_bias)
        points = POINT_COUNT if progress >= optimisation.full_encoding else optimisation.encoder_points
        reach = EARLY_REACH if progress < optimisation.growth else optimisation.late_reach
        if (points, reach) != (self._encoder_points, self.losses.reach):
            self._encoder_points, self.losses.reach = points, reach
            self._graph = None

    def _replay_step(self) -> None:
        if self.device.type != "cuda":
            self._compute_step()
        elif self._graph is None:
            self._capture()
        else:
            self._graph.replay()

    def _capture(self) -> None:
        """Run a real step on a side stream, then record the next ones. The recording itself changes nothing."""
        side = torch.cuda.Stream()
        stream = wp.stream_from_torch(side)
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side), wp.ScopedStream(stream, sync_enter=False):
            self._compute_step()
        torch.cuda.current_stream().wait_stream(side)
        torch.cuda.synchronize()
        self.optimiser.zero_grad(set_to_none=True)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph, stream=side), wp.ScopedStream(stream, sync_enter=False):
            wp.capture_begin(stream=stream, external=True)
            try:
                self._compute_step()
            finally:
                wp.capture_end(stream=stream)

    def _compute_step(self) -> None:
        optimisation = self.config.optimisation
        per_body = optimisation.samples // optimisation.bodies
        with torch.no_grad():
            chosen = torch.randint(len(self.bodies), (optimisation.bodies,), device=self.device)
            body_index = chosen.repeat_interleave(per_body)
            positions, gravity = self.sampler.sample(optimisation.samples, self.range)
            surface = self.bodies.sample_points(chosen, self._encoder_points)
            bone_transforms = self.posed_bodies.pose(positions, body_index)
            posed_nodes = self.drape.posed_nodes(bone_transforms, self.node_positions[body_index])
        modulation = self.drape.networks.hyper_modulator(*surface)
        vertices = self.drape(modulation.repeat_interleave(per_body, dim=0), positions, gravity, posed_nodes)
        loss, energies = self.losses(vertices, gravity, self.posed_bodies.mesh, self.posed_bodies.offset)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.drape.parameters(), optimisation.gradient_clip, foreach=True)
        self.optimiser.step()
        self._update_average()
        self.gradient_norm.copy_(norm)
        self._energy_sum += torch.stack([getattr(energies, term).mean() for term in TERMS])
        self._stretch_and_collision.copy_(energies.stretch + energies.collision)

    @torch.no_grad()
    def _update_average(self) -> None:
        """average = parameter + decay * (average - parameter): in place, and the decay may sit in a tensor."""
        if self.averaged is self.drape:
            return
        average, parameters = list(self.averaged.parameters()), list(self.drape.parameters())
        torch._foreach_sub_(average, parameters)
        torch._foreach_mul_(average, self._average_decay)
        torch._foreach_add_(average, parameters)
