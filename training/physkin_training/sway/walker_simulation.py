"""Cloth with inertia in the numbers of garment nodes: many walkers at once, each a body in a motion of its own.

Contact is softer than in simulations of the full mesh, so that so few numbers can solve a frame in one step. Cloth
between garment nodes cannot buckle, so it yields under compression instead. If it were as stiff as in tension, it would
resist where real cloth makes small folds, and swing only three quarters as far. What is simulated are offsets, which
the garment's node corrections would need to be right.

Dimensions: `B` walkers, those of a body one after the other, `S` bodies, `T` frames, `m` garment nodes. Metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.dynamics.dynamic_simulation import A_LONG_TIME, LARGEST_EXTENT
from physkin_training.dynamics.incremental_potential import IncrementalPotential
from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.energies.motion import Dynamics
from physkin_training.sway.motions import WalkerMotions
from physkin_training.sway.node_skinning import NodeSkinning
from physkin_training.sway.node_step_solver import Metric, NodeStepSolver

__all__ = ["SLOWLY", "WalkerSimulation", "in_one_size", "potential_of_walkers"]

ONE_SIZE = 3
"""Every third body wears the template, the others a garment made to measure."""
SOFTER_CONTACT = 0.1
COMPRESSED = 0.005
"""Share of the stiffness of cloth that is left under compression, of walkers."""
NEWTON, PRODUCTS = 8, 14
FIRST_STEPS, FIRST_STEP, FIRST_DAMPING = 8, 0.2, 0.05
"""A motion begins with the drape at rest, found in so many steps of so many seconds, each from standing still."""
LARGEST_MOVE = 0.33
"""[m] How far the forecast moves a vertex in a frame at most."""
LARGEST_OFFSET = 1.0
"""[m] Cloth with a vertex farther from the model's drape than this is lost, and begins anew at the drape. Vertices are
measured and not garment nodes, some of whose changes move hardly any cloth."""
DEEP, MOST_DEEP = 0.02, 0.002
"""Cloth is also lost if a limb goes through it: if the share of its vertices that are deeper than `DEEP` [m] in the
part of the body they are worn on has grown by more than `MOST_DEEP` since the first frame."""
LOST_FOR = 30
"""Frames that do not count after cloth was lost."""
TETHER = (2 * np.pi * 0.5) ** 2
"""[1/s2] Stiffness over inertia of the tether of each garment node, see `NodeStepSolver`. Many garment nodes together
move cloth, so cloth hardly feels it."""
SLOWLY = (2 * np.pi * 1.4) ** 2
"""[1/s2] Inertia over mass of cloth that swings 1.4 times a second."""


def in_one_size(bodies: int) -> np.ndarray:
    """(bodies,) bool, which of so many bodies wear the template instead of a garment made to measure."""
    return np.arange(bodies) % ONE_SIZE == 1


def potential_of_walkers(dressed: DressedSamples, *, compressed: float) -> IncrementalPotential:
    """The incremental potential of a frame, for cloth that keeps this share of its stiffness under compression. What
    cloth loses inside itself is left out, because it would resist that compression."""
    potential = dressed.potential(1 / RATE_HZ, Dynamics(relaxation=0.0))
    potential.stretch.compressed = compressed
    return potential


@dataclass(frozen=True)
class _Stance:
    """A frame of all walkers, in their root frames: rotations of posed garment nodes (B, m, 3, 3), the model's drape
    (B, m, 3, 4), gravity (B, 3); where the root is, turn (B, 3, 3) and place (B, 3)."""

    node_turns: torch.Tensor
    drape: torch.Tensor
    gravity: torch.Tensor
    turn: torch.Tensor
    place: torch.Tensor

    def to_world(self, nodes: torch.Tensor) -> torch.Tensor:
        nodes = self.turn[:, None] @ nodes
        return torch.cat([nodes[..., :3], nodes[..., 3:] + self.place[:, None, :, None]], dim=-1)

    def to_root(self, nodes: torch.Tensor) -> torch.Tensor:
        nodes = torch.cat([nodes[..., :3], nodes[..., 3:] - self.place[:, None, :, None]], dim=-1)
        return self.turn[:, None].mT @ nodes

    def nodes(self, offsets: torch.Tensor) -> torch.Tensor:
        return self.drape + self.node_turns @ offsets

    def offsets(self, nodes: torch.Tensor) -> torch.Tensor:
        return self.node_turns.mT @ (nodes - self.drape)


class WalkerSimulation:
    """`each` walkers on each of bodies (S, c), shape coefficients of `body_model`.

    free: (m,) bool, garment nodes that move; others, such as those of a bodice, stay as the model has them. `inertia`
    [kg] and `cost` [J], both (12 m, 12 m), are averages over bodies at rest: the mass that a change of offsets moves,
    and the energy that it costs in strain and in the inertia of cloth that swings.
    """

    def __init__(
        self,
        model: GarmentModel,
        body_model: BodyModel,
        bodies: np.ndarray,
        each: int,
        device: torch.device,
        *,
        free: np.ndarray,
    ) -> None:
        body = torch.arange(len(bodies) * each, device=device) // each
        self.dressed = DressedSamples(model, body_model, bodies, body, one_size=in_one_size(len(bodies)))
        self.potential = potential_of_walkers(self.dressed, compressed=COMPRESSED)
        self.potential.collision.stiffness *= SOFTER_CONTACT
        self.skinning = NodeSkinning(self.dressed)
        self.free = torch.as_tensor(free, device=device)
        self._solver = NodeStepSolver(self.dressed, self.potential, self.skinning, self.free)
        with torch.no_grad():
            self._learn_metric()

    def _learn_metric(self) -> None:
        walkers, device = len(self.dressed.body), self.dressed.device
        rest = torch.tensor(self.dressed.model.rig.rest, dtype=torch.float32, device=device)
        upright = torch.eye(3, device=device).expand(walkers, -1, -1)
        down = torch.tensor(UPRIGHT_GRAVITY, dtype=torch.float32, device=device).expand(walkers, -1).contiguous()
        place = torch.zeros(walkers, 3, device=device)
        stance = self._stance(rest.expand(walkers, -1).contiguous(), upright, place, down)
        still = self.skinning.vertices(stance.drape)
        self.potential.begin(still, still)
        at = (stance.drape, stance.node_turns, stance.gravity)
        moving = self._solver.mean_stiffness(*at)
        time_step = self.potential.time_step
        step, time_step.seconds = time_step.seconds, A_LONG_TIME
        strained = self._solver.mean_stiffness(*at)
        time_step.seconds = step
        self._solver.metric = Metric.regular(moving, self.free)
        self.inertia = self._solver.mean_inertia(stance.node_turns)
        self._solver.tether = TETHER * self.inertia.diagonal()
        self.cost = Metric.regular(strained + SLOWLY / RATE_HZ**2 * (moving - strained), self.free).matrix

    def run(
        self, motions: WalkerMotions, watch: Callable[[int, torch.Tensor, torch.Tensor, torch.Tensor], None]
    ) -> None:
        """Simulate motions of the B walkers. After every frame `watch` is called with its index, the offsets of garment
        nodes in their own posed frames (B, m, 3, 4), the forces [N] by which inertia and drag resist changes of them
        (B, m, 3, 4), and which walkers count (B,)."""
        device = self.dressed.device
        moved = (motions.positions, motions.turn, motions.place, motions.gravity)
        positions, *others = (torch.as_tensor(a, device=device) for a in moved)

        def stance(frame: int) -> _Stance:
            return self._stance(*(a[:, frame].contiguous() for a in (positions, *others)))

        with torch.no_grad():
            now = stance(0)
            nodes = self._at_rest(now)
            offsets = now.offsets(nodes)
            last = before_last = now.to_world(nodes)
            deep_at_first = self._deep(now, self.skinning.vertices(nodes))
            lost_for = torch.zeros(len(positions), dtype=torch.int64, device=device)
            watch(0, offsets, torch.zeros_like(offsets), lost_for == 0)
            for frame in range(1, positions.shape[1]):
                now = stance(frame)
                nodes, vertices = self._step(now, last, before_last, offsets)
                resistance = self._solver.pulled_back(self.potential.time_step.resistance(vertices))
                away = (vertices - self.skinning.vertices(now.drape)).norm(dim=2).amax(dim=1)
                pierced = self._deep(now, vertices) - deep_at_first > MOST_DEEP
                lost = pierced | ~(away < LARGEST_OFFSET) | ~(vertices.abs().amax(dim=(1, 2)) < LARGEST_EXTENT)
                anew = lost[:, None, None, None]
                nodes = torch.where(anew, now.drape, nodes)
                offsets = now.offsets(nodes)
                here = now.to_world(nodes)
                last, before_last = here, torch.where(anew, here, last)
                lost_for = torch.where(lost, LOST_FOR, (lost_for - 1).clamp_min(0))
                watch(frame, offsets, resistance, lost_for == 0)

    def _stance(
        self, positions: torch.Tensor, turn: torch.Tensor, place: torch.Tensor, gravity: torch.Tensor
    ) -> _Stance:
        posed = self.dressed.pose(positions)
        drape, offsets = self.dressed.draped(positions, gravity, posed)
        self.skinning.fold(offsets)
        return _Stance(posed[..., :3].contiguous(), drape, gravity, turn, place)

    def _at_rest(self, now: _Stance) -> torch.Tensor:
        time_step = self.potential.time_step
        step, time_step.seconds = time_step.seconds, FIRST_STEP
        nodes = now.drape
        for _ in range(FIRST_STEPS):
            still = self.skinning.vertices(nodes)
            self.potential.begin(still, still)
            nodes, _ = self._solver.minimise(
                [nodes],
                *(now.drape, now.node_turns, now.gravity),
                newton=NEWTON + 1,
                products=2 * PRODUCTS,
                damping=FIRST_DAMPING,
            )
        time_step.seconds = step
        return nodes

    def _deep(self, now: _Stance, vertices: torch.Tensor) -> torch.Tensor:
        """(B,) share of the vertices (B, n, 3) that are deep in what they are worn on."""
        self.potential.evaluate(vertices, now.gravity, *self.dressed.contact)
        collision = self.potential.collision
        return ((collision.signed_distance < -DEEP) & collision.at_worn_part).float().mean(dim=1)

    def _step(
        self, now: _Stance, last: torch.Tensor, before_last: torch.Tensor, offsets: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Garment nodes (B, m, 3, 4) and vertices of this frame. last, before_last: garment nodes in the world; offsets
        of the last frame."""
        forecast = torch.where(self.free[:, None, None], now.to_root(2 * last - before_last), now.drape)
        before = self.skinning.vertices(now.to_root(last))
        move = self.skinning.vertices(forecast) - before
        move = move * (LARGEST_MOVE / move.norm(dim=2, keepdim=True).clamp_min(LARGEST_MOVE))
        self.potential.begin(before, before + move)
        starts = [forecast, now.nodes(offsets)]
        at = (now.drape, now.node_turns, now.gravity)
        return self._solver.minimise(starts, *at, newton=NEWTON, products=PRODUCTS)
