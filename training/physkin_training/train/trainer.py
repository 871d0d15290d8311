"""Joint optimisation of networks and skinning weights by physics losses alone (paper: Training).

One step draws bodies, poses and gravity, encodes the bodies, drapes the garment and descends the mean physical energy.
Everything that changes between steps (pose range, contact stiffness, learning rates) sits in tensors, so that a GPU can
replay the step.

Dimensions: `B` samples, `S` bodies of a step, `n` garment vertices.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.model.garment import Garment, load_garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model
from physkin_training.config import TrainingConfig
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.rest_data import RestData
from physkin_training.energies.self_contact import SOFTNESS
from physkin_training.networks.draping import Drape, RestShape
from physkin_training.networks.garment_nodes import DetailNodeSet, GarmentNodeSet
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.physics.physics_losses import TERMS, PhysicsLosses, gradient_weight
from physkin_training.recorded_step import RecordedStep
from physkin_training.sampling.bending import drawn_bending
from physkin_training.sampling.pose_sampling import PoseSampler
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies
from physkin_training.sampling.training_bodies import training_bodies
from physkin_training.soap import Soap
from physkin_training.train.checkpoint import CHECKPOINT_SUFFIX, Progress, load_checkpoint, load_drape, save_checkpoint
from physkin_training.train.schedule import EARLY_REACH, Schedule, is_stuck, last_part
from physkin_training.train.steadiness import Steadiness
from physkin_training.train.step_rate import steady_rate
from physkin_training.train.untangling import Untangling
from physkin_training.train.validation import CONTACT_LINEAR_BEYOND, HEAVY_ENERGY, BestModel, Validation
from physkin_training.transfer.warm_start import take_over_model

__all__ = ["Trainer", "TrainingDiverged"]

NORMALISING_POSES = 2048
"""Poses from which the node deformer's inputs are scaled."""
ENGINE_SHARE = 1 / 8
"""Share of a body's poses that are skinned by the weights for engines; one at least."""
LARGEST_GRADIENT = 10.0
"""Longer gradients are shortened to this norm."""
LONG_RUN, FEWEST_STEPS = 100_000, 10
"""Steps of a run while its first ones are timed, which then hardly learn; and fewest steps after them."""


class TrainingDiverged(RuntimeError):
    """Energies or gradients are no longer finite."""


class Trainer:
    """A training run that can stop anywhere and go on exactly.

    `step` counts finished steps and those left out, `skipped` the latter; `drape` is the model in training, `averaged`
    its exponential moving average, `best` the average with the lowest `validation_energy` [J] (the last one measured),
    both None until pose range and influences are final, but for a run with a `start`, which is measured first.
    `started_from`: plain data on the run this one took its networks from, or None. `made` (S,): which bodies of a step
    are worn made to measure, beside small ones.
    garment, start: mesh and model that the run begins with; by default they are read from the files that the
    configuration names. body_model: whose training bodies it takes, by default those of all ages that are shipped.
    """

    def __init__(
        self,
        config: TrainingConfig,
        device: torch.device,
        *,
        garment: Garment | None = None,
        start: GarmentModel | None = None,
        body_model: BodyModel | None = None,
    ) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.device = device
        self.step = self.skipped = 0
        self.best: BestModel | None = None
        self.validation_energy: float | None = None
        self.started_from: dict | None = None
        optimisation = config.optimisation
        self._samples, self._bodies = optimisation.samples, optimisation.bodies
        if self._bodies < 2:
            raise ValueError("optimisation.bodies must be at least 2, one of them with a garment made to measure")
        self.body_model = body_model = body_model or load_body_model()
        if config.train_bodies > len(body_model.train_bodies):
            raise ValueError(f"train_bodies must be 1 to {len(body_model.train_bodies)}, got {config.train_bodies}")
        self.rig = body_model.rig
        self.garment = garment or load_garment(config.garment)
        self.start = start = start or (load_garment_model(config.start) if config.start else None)
        if start:
            nodes, detail = GarmentNodeSet.of_model(start), DetailNodeSet.of_model(start)
        else:
            sizes = config.garment_nodes
            nodes = GarmentNodeSet.sample(self.garment, self.rig, sizes.count, sizes.initial_influences)
            detail = DetailNodeSet.sample(self.garment, config.detail)
        self.nodes = nodes
        self.drape = Drape(self.garment, nodes, self.rig, config.networks, detail).to(device)
        bodies, swelling = training_bodies(body_model, config.train_bodies, seed=config.seed)
        self.bodies = BodySet(body_model, bodies, device, swelling=swelling)
        self.fits = MadeToMeasure(self.garment, self.drape, self.bodies, body_model)
        self.made = torch.arange(self._bodies, device=device) % 2 == 1
        rest = RestData(self.garment, config.material, device, shapes=self.fits.shapes)
        self.sampler = PoseSampler.of_training(self.rig, device)
        wearing = Wearing.of(self.garment, body_model).worn_faces()
        self.posed_bodies = PosedBodies(body_model, self.bodies, self._samples, faces=wearing.faces)
        self._steadiness = Steadiness(self.drape, self.posed_bodies, optimisation.steadiness)
        self._normalise_nodes()
        if start:
            self.started_from = take_over_model(start, self.drape)
        self.averaged = copy.deepcopy(self.drape).requires_grad_(False)
        self.losses = PhysicsLosses(
            self.garment,
            config.material,
            self._samples,
            device,
            wearing=wearing,
            reach=EARLY_REACH,
            linear_beyond=CONTACT_LINEAR_BEYOND,
            leads_back=True,
            heavy_energy=HEAVY_ENERGY,
            rest=rest,
        )
        self._untangling = Untangling(self.garment, self.posed_bodies.offset)
        self.validation = Validation(config, body_model, self.garment, self.bodies, wearing, fits=self.fits, rest=rest)
        self.range = torch.zeros((), device=device)
        self._average_decay = torch.zeros((), device=device)
        self._energy_sum = torch.zeros(len(TERMS), device=device)
        self._stretch_and_collision = torch.zeros(self._samples, device=device)
        self._summed_from = 0
        self.gradient_norm = torch.zeros((), device=device)
        networks = self.drape.networks
        self.optimiser = Soap(networks.parameters(), self._logits(), device, units=networks.output_units())
        self._recorded = RecordedStep(
            lambda: self.take_step(),
            device,
            clear=lambda: self.optimiser.zero_grad(),
        )
        # Nothing is pruned before the first step, whatever its schedule says.
        every = config.garment_nodes.initial_influences
        self.schedule = replace(Schedule.at(0, config), influences=every, engine_influences=every)

    def run(self, steps: int) -> Iterator[int]:
        """Do up to `steps` steps, yielding `step` after each."""
        end = min(self.step + steps, self.config.optimisation.steps)
        if self.step == 0 and self.start:
            self._measure()
        while self.step < end and not self.settled:
            self._set_schedules()
            self._recorded()
            self.step += 1
            self.optimiser.turn_bases(self.step)
            self.validate()
            if is_stuck(self.step, self.best, self.config):
                self.skip_to(max(self.step, last_part(self.config)))
            yield self.step

    def choose_steps(self, seconds: float) -> float:
        """Set the run's steps so that it takes `seconds` from now on. Returns the rate [steps/s].

        Its first steps are timed; they count. Raises ValueError when the run has begun, or the time is too short.
        """
        if self.step:
            raise ValueError(f"the number of steps is chosen before the first one, not after {self.step}")
        began = time.perf_counter()
        self.set_steps(LONG_RUN)
        rate = steady_rate(self.run(LONG_RUN), seconds, self.device)
        left = int(rate * (seconds - (time.perf_counter() - began)))
        if left < FEWEST_STEPS:
            raise ValueError(
                f"{seconds / 60:g} minutes are too short for a run of {FEWEST_STEPS} steps at {rate:.1f} a second"
            )
        self.set_steps(self.step + left)
        return rate

    def set_steps(self, steps: int) -> None:
        """Change how many steps the run takes in all; schedules stretch with it."""
        self.config = replace(self.config, optimisation=replace(self.config.optimisation, steps=steps))

    @property
    def settled(self) -> bool:
        """Whether nothing gets better, even in the last part of the run."""
        return is_stuck(self.step, self.best, self.config) and self.step >= last_part(self.config)

    def skip_to(self, step: int) -> None:
        """Leave out the steps before `step`, as a run has become slower than when they were chosen, or is stuck."""
        self.skipped += step - self.step
        self.step = step

    def best_drape(self) -> Drape:
        """The averaged drape to export and evaluate: of the best step, or the latest where none was measured."""
        if self.best is None:
            return self.averaged
        drape = copy.deepcopy(self.averaged)
        drape.load_state_dict(drape.state_dict() | self.best.parameters)
        return drape

    def mean_energies(self) -> dict[str, float]:
        """Mean energies [J] a sample by term over the steps since the last call. Waits for the device.

        Raises TrainingDiverged when they are not finite.
        """
        sums = self._finite_sums()
        taken = self.step - self.skipped
        steps = max(1, taken - self._summed_from)
        self._energy_sum.zero_()
        self._summed_from = taken
        return {term: energy / steps for term, energy in zip(TERMS, sums)}

    def median_energy(self) -> float:
        """Median of stretch and contact energy [J] over the last step's samples: the few worst poses, which decide the
        mean, do not move it. Waits for the device."""
        return self._stretch_and_collision.median().item()

    def _finite_sums(self) -> list[float]:
        """The summed energies [J]. Raises TrainingDiverged when energies since the last report or the last gradient are
        not finite."""
        sums = torch.cat([self._energy_sum, self.gradient_norm[None]])
        if not torch.isfinite(sums).all():
            raise TrainingDiverged(f"energies or gradients are not finite at step {self.step}")
        return sums[:-1].tolist()

    def save(self, path: Path) -> None:
        """Write a checkpoint. Raises TrainingDiverged and leaves `path` as it is when the run has diverged."""
        self._finite_sums()
        save_checkpoint(
            path,
            self.drape,
            self.averaged,
            self.optimiser,
            progress=Progress(self.step, self.best, self.started_from),
            config=self.config,
        )

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint of the same configuration, exactly as the run would have gone on."""
        progress = load_checkpoint(path, self.drape, self.averaged, self.optimiser, config=self.config)
        self.step = self._summed_from = progress.step
        self.best, self.started_from = progress.best, progress.started_from

    def start_from(self, path: Path) -> None:
        """Begin a new run with the networks and skinning weights of another run's checkpoint, or of a model file.

        Raises CheckpointError or ValueError when they do not fit this run.
        """
        if path.suffix == CHECKPOINT_SUFFIX:
            self.started_from = load_drape(path, self.drape)
        else:
            self.started_from = take_over_model(load_garment_model(path), self.drape)
        self.averaged.load_state_dict(self.drape.state_dict())

    def _normalise_nodes(self) -> None:
        """Scale the node deformer's inputs by their spread over poses of the full range."""
        posed = []
        for _ in range(math.ceil(NORMALISING_POSES / self._samples)):
            positions, _ = self.sampler.sample(self._samples, 1.0)
            body = torch.randint(len(self.bodies), (self._samples,), device=self.device)
            bones = self.posed_bodies.bone_transforms(positions, body)
            every_second = torch.arange(self._samples, device=self.device) % 2 == 1
            posed.append(self.drape.posed_nodes(bones, self.fits.worn(body, every_second).node_positions))
        self.drape.networks.normalise_nodes(torch.cat(posed))

    def _logits(self) -> list[torch.nn.Parameter]:
        """Of the skinning weights, both sets, and of detail nodes' weights."""
        detail = [self.drape.detail_logits] if self.drape.has_detail else []
        return [self.drape.skinning_logits, self.drape.engine_logits, *detail]

    def _set_schedules(self) -> None:
        before, self.schedule = self.schedule, Schedule.at(self.step, self.config)
        schedule = self.schedule
        self.range.fill_(schedule.pose_range)
        self.losses.collision.stiffness.fill_(self.config.material.contact_stiffness * schedule.contact)
        self_contact = SOFTNESS * self.config.material.contact_stiffness * schedule.self_contact
        self.losses.self_contact.stiffness.fill_(self_contact)
        self._untangling.share.fill_(schedule.self_contact)
        *networks, skinning = self.optimiser.param_groups
        for group in networks:
            group["lr"].fill_(schedule.learning_rate)
        skinning["lr"].fill_(schedule.skinning_rate)
        self._average_decay.fill_(schedule.average_decay)
        if schedule.influences < before.influences:
            self.drape.prune_influences(schedule.influences)
            self.averaged.influence_bias.copy_(self.drape.influence_bias)
        if schedule.engine_influences < before.engine_influences:
            self.drape.prune_engine_influences(schedule.engine_influences)
            self.averaged.engine_bias.copy_(self.drape.engine_bias)
        self.losses.collision.reach = schedule.reach
        if schedule.recorded != before.recorded:
            self._recorded.forget()

    def validate(self) -> None:
        """Measure the average, every so often and at the end, and keep it if it is the best."""
        optimisation = self.config.optimisation
        if self.step % optimisation.validate_every and self.step != optimisation.steps:
            return
        last = Schedule.at(self.step - 1, self.config)
        nodes = self.config.garment_nodes
        if (
            last.pose_range < 1
            or last.influences > nodes.influences
            or last.engine_influences > nodes.engine_influences
        ):
            return
        self._measure()

    def _measure(self) -> None:
        with self._recorded.beside():
            self.validation_energy = self.validation.energy(self.averaged)
        if math.isfinite(self.validation_energy) and (self.best is None or self.validation_energy < self.best.energy):
            self.best = BestModel.of(self.averaged, step=self.step, energy=self.validation_energy)

    def draw(self) -> tuple[torch.Tensor, ...]:
        """Bodies (S,), joint positions (B, d) [rad], gravity (B, 3), surface points and normals (S, N, 3) of a step."""
        chosen = torch.randint(len(self.bodies), (self._bodies,), device=self.device)
        positions, gravity = self.sampler.sample(self._samples, self.range)
        return chosen, positions, gravity, *self.bodies.sample_points(chosen, self.schedule.encoder_points)

    def take_step(self) -> None:
        optimisation = self.config.optimisation
        per_body = self._samples // self._bodies
        with torch.no_grad():
            chosen, positions, gravity, *surface = self.draw()
            body_index = chosen.repeat_interleave(per_body)
            bone_transforms = self.posed_bodies.pose(positions, body_index)
            made = self.made | self.fits.small[chosen]
            worn = self.fits.worn(body_index, made.repeat_interleave(per_body))
            self.losses.rest_row.copy_(worn.rows)
            posed_nodes = self.drape.posed_nodes(bone_transforms, worn.node_positions)
            bending, stiffer = drawn_bending(self._bodies, optimisation.other_bending, self.device)
            self.losses.bend.stiffer.copy_(stiffer.repeat_interleave(per_body))
        modulation = self.drape.networks.hyper_modulator(*surface, made.float(), bending)
        modulation = modulation.repeat_interleave(per_body, dim=0)
        nodes, detail = self.drape.draped(modulation, positions, gravity, posed_nodes)
        loss = self.objective(self.skinned(nodes, worn.rest, detail), gravity)
        if optimisation.steadiness:
            loss = loss + self._steadiness(
                nodes,
                posed_nodes,
                detail,
                modulation=modulation,
                positions=positions,
                gravity=gravity,
                node_positions=worn.node_positions,
                body=body_index,
            )
        self.optimiser.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.drape.parameters(), LARGEST_GRADIENT, foreach=True)
        self.optimiser.step()
        self._update_average()
        self.gradient_norm.copy_(norm)

    def skinned(self, nodes: torch.Tensor, rest: RestShape, detail: torch.Tensor | None = None) -> torch.Tensor:
        """Drapes (B, n, 3) of garment nodes (B, m, 3, 4) and detail nodes (B, D, 3); each body's last ones by the
        skinning weights for engines."""
        parts = []
        last = max(1, round(ENGINE_SHARE * self._samples / self._bodies))
        for poses, for_engines in ((slice(None, -last), False), (slice(-last, None), True)):

            def part(values: torch.Tensor, poses: slice = poses) -> torch.Tensor:
                return values.unflatten(0, (self._bodies, -1))[:, poses].flatten(0, 1)

            own = RestShape(part(rest.vertices), part(rest.nodes))
            own_detail = None if detail is None else part(detail)
            skinned = self.drape.skin(part(nodes), own, own_detail, for_engines=for_engines)
            parts.append(skinned.unflatten(0, (self._bodies, -1)))
        return torch.cat(parts, dim=1).flatten(0, 1)

    def objective(self, vertices: torch.Tensor, gravity: torch.Tensor) -> torch.Tensor:
        """What a step descends, from drapes (B, n, 3): the mean energy [J], which is also summed up for reports."""
        loss, energies = self.losses(vertices, gravity, self.posed_bodies.mesh, self.posed_bodies.offset)
        self._energy_sum += torch.stack([getattr(energies, term).mean() for term in TERMS])
        self._stretch_and_collision.copy_(energies.stretch + energies.collision)
        if self.schedule.self_contact:
            loss = loss + self._untangling(vertices, gradient_weight(energies.strained, HEAVY_ENERGY))
        return loss

    @torch.no_grad()
    def _update_average(self) -> None:
        """average = parameter + decay * (average - parameter): in place, and the decay may sit in a tensor."""
        average, parameters = list(self.averaged.parameters()), list(self.drape.parameters())
        torch._foreach_sub_(average, parameters)
        torch._foreach_mul_(average, self._average_decay)
        torch._foreach_add_(average, parameters)
