"""Cloth that moves: one garment on several bodies in several scenes, all at once, by implicit Euler on the full mesh.

The state is kept in the world; each step is solved in the root frame that it ends in, where the bodies are.
Dimensions: `B` samples, `n` garment vertices, `d` degrees of freedom, `T` frames, `k` steps a frame. Metres, seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.motion.motion import Motion
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.dynamics.scenes import scene_wind
from physkin_training.dynamics.step_solver import StepSolver
from physkin_training.energies.motion import Dynamics
from physkin_training.physics.full_space_solver import FullSpaceSolver

__all__ = ["A_LONG_TIME", "LARGEST_EXTENT", "DynamicSimulation"]

TOLERANCE, ITERATIONS, PRODUCTS = 1e-3, 3, 48
"""Residual force of a step over the garment's weight; Newton steps in a step of time, and products of the second
derivative in one of these, at most."""
FIRST_TOLERANCE, FIRST_ITERATIONS = 5e-3, 80
"""Of the drape at rest that a scene begins with."""
SETTLING_STEP, SETTLING_STEPS, SETTLING_ITERATIONS, SETTLING_PRODUCTS, SETTLED = 0.05, 100, 6, 96, 2e-4
"""Cloth whose minimum is not reached then comes to rest in at most so many steps of so many seconds, each from standing
still, until no vertex moves farther [m]: else it would swing by itself when the scene begins."""
UNSETTLED = 0.02
"""Residual force of a step over the weight from which on the next one does not begin with the same acceleration."""
LARGEST_EXTENT = 3.0
"""[m] a garment with a vertex farther from the root is lost."""
FASTEST = 20.0
"""[m/s] no cloth is faster in the world."""
A_LONG_TIME = 1e3
"""A step [s] in which inertia is nothing."""


class DynamicSimulation:
    """A garment on every body in every scene: sample `s` is body `s // scenes` in scene `s % scenes`.

    bodies: (S, c) shape coefficients of `body_model`, each in a garment made to measure. scenes: motions of one length
    and rate. steps: in a frame. held_above: [m] in the canonical pose; vertices above, as those of a bodice, stay as
    the model drapes them. `lost_at` (B,) is the first frame in which a sample was nowhere, `frame_count` for the
    others.
    Raises ValueError for scenes of different lengths or rates.
    """

    def __init__(
        self,
        model: GarmentModel,
        body_model: BodyModel,
        bodies: np.ndarray,
        scenes: Sequence[Motion],
        device: torch.device,
        *,
        steps: int = 4,
        held_above: float = float("inf"),
    ) -> None:
        if len({(scene.frame_count, scene.rate_hz) for scene in scenes}) != 1:
            raise ValueError("scenes that are simulated together must have the same number of frames and rate")
        self.model, self.device, self.steps = model, device, steps
        self.frame_count, rate = scenes[0].frame_count, scenes[0].rate_hz
        self.samples = len(bodies) * len(scenes)
        index = torch.arange(self.samples, device=device)
        self.body, self.scene = index // len(scenes), index % len(scenes)
        fine = [scene.resampled(rate * steps) if steps > 1 else scene for scene in scenes]
        self.step = 1 / (rate * steps)

        def tensor(arrays: Sequence[np.ndarray], dtype=torch.float32) -> torch.Tensor:
            return torch.as_tensor(np.stack(arrays), dtype=dtype, device=device)

        self._positions = tensor([motion.positions_for(model.rig) for motion in fine])
        turns = [Rotation.from_quat(motion.root_orientation).as_matrix() for motion in fine]
        self._turn = tensor(turns, torch.float64)
        self._place = tensor([motion.root_position for motion in fine], torch.float64)
        dynamics = Dynamics()
        felt = [dynamics.effective_gravity(turn, scene_wind(motion)) for turn, motion in zip(turns, fine)]
        self._gravity = tensor(felt)

        self.lost_at = torch.full((self.samples,), self.frame_count, device=device)
        self.dressed = DressedSamples(model, body_model, bodies, self.body)
        self.potential = self.dressed.potential(self.step, dynamics)
        self._held = torch.as_tensor(model.garment.vertices[:, 2] > held_above, device=device)
        self._holds = bool(self._held.any())
        self._solver = FullSpaceSolver(self.potential, held=self._held)
        self.force_scale = self._solver.force_scale
        self._step_solver = StepSolver(self._solver.hessian, ~self._held)

    def run(self, watch: Callable[[int, torch.Tensor], None]) -> None:
        """Simulate, telling `watch` the number of every frame and its vertices (B, n, 3) in the root frames.

        A sample that is lost goes on from the model's drape.
        """
        with torch.no_grad():
            vertices = self.at_rest()
            here = self._to_world(vertices, 0)
            velocity, acceleration = torch.zeros_like(here), torch.zeros_like(here)
            watch(0, vertices)
            for frame in range(1, self.frame_count):
                for step in range((frame - 1) * self.steps + 1, frame * self.steps + 1):
                    gravity = self._pose(step)
                    forecast = here + self.step * velocity
                    self.potential.begin(self._to_root(here, step), self._to_root(forecast, step))
                    start = self._to_root(forecast + self.step**2 * acceleration, step)
                    solution = self._step_solver.minimise(
                        self._with_held(start, step),
                        *(gravity, *self.dressed.contact),
                        tolerance=TOLERANCE * self.force_scale,
                        iterations=ITERATIONS,
                        products=PRODUCTS,
                    )
                    vertices = solution.vertices
                    there = self._to_world(vertices, step)
                    last, velocity, here = velocity, (there - here) / self.step, there
                    velocity = velocity * (FASTEST / velocity.norm(dim=2, keepdim=True).clamp_min(FASTEST))
                    settled = solution.gradient_norm < UNSETTLED * self.force_scale
                    acceleration = settled[:, None, None] * (velocity - last) / self.step
                lost = ~(vertices.abs().amax(dim=(1, 2)) < LARGEST_EXTENT)  # or not finite
                if lost.any():
                    begun = self._to_world(self._model_drape(step), step)
                    here = torch.where(lost[:, None, None], begun, here)
                    velocity, acceleration = (
                        torch.where(lost[:, None, None], 0.0, field) for field in (velocity, acceleration)
                    )
                    self.lost_at = torch.where(lost, self.lost_at.clamp_max(frame), self.lost_at)
                watch(frame, vertices)

    def at_rest(self) -> torch.Tensor:
        """Drapes (B, n, 3) at rest in the first frame, from the model's: minimised, and then settled."""
        gravity = self._pose(0)
        local = self._model_drape(0)
        time_step = self.potential.time_step
        step, time_step.seconds = time_step.seconds, A_LONG_TIME
        self.potential.begin(local, local)
        vertices = self._solver.minimise(
            local, gravity, *self.dressed.contact, tolerance=FIRST_TOLERANCE, iterations=FIRST_ITERATIONS
        ).vertices
        time_step.seconds = SETTLING_STEP
        for _ in range(SETTLING_STEPS):
            before = vertices
            self.potential.begin(before, before)
            vertices = self._step_solver.minimise(
                before,
                *(gravity, *self.dressed.contact),
                tolerance=TOLERANCE * self.force_scale,
                iterations=SETTLING_ITERATIONS,
                products=SETTLING_PRODUCTS,
            ).vertices
            if (vertices - before).abs().max() < SETTLED:
                break
        time_step.seconds = step
        return vertices

    def _model_drape(self, step: int) -> torch.Tensor:
        """What the model makes of the bodies posed last, (B, n, 3)."""
        positions = self._positions[self.scene, step]
        return self.dressed.skinned(*self.dressed.draped(positions, self._gravity_at(step), self._posed))

    def _with_held(self, local: torch.Tensor, step: int) -> torch.Tensor:
        if not self._holds:
            return local
        return torch.where(self._held[:, None], self._model_drape(step), local)

    def _pose(self, step: int) -> torch.Tensor:
        """Pose the bodies, and return gravity (B, 3) in the root frames."""
        self._posed = self.dressed.pose(self._positions[self.scene, step])
        return self._gravity_at(step)

    def _gravity_at(self, step: int) -> torch.Tensor:
        """With the pull of the wind, (B, 3) in the root frames."""
        return self._gravity[self.scene, step]

    def _to_root(self, world: torch.Tensor, step: int) -> torch.Tensor:
        """(B, n, 3) float64 world to float32 root frame."""
        return ((world - self._place[self.scene, step, None]) @ self._turn[self.scene, step]).float()

    def _to_world(self, local: torch.Tensor, step: int) -> torch.Tensor:
        turned = local.double() @ self._turn[self.scene, step].transpose(1, 2)
        return turned + self._place[self.scene, step, None]
