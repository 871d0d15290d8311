"""Simulated walkers, as learning takes them: their motions, and the motion of their clothes as coefficients of shapes.

Dimensions: `N` walkers, `T` frames, `t` frames kept, `d` degrees of freedom, `c` body code, `r` shapes, `S` bodies.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.progress import Watch, progress_line
from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.motions import MotionPool, WalkerMotions
from physkin_training.sway.shapes import Shapes, principal_shapes
from physkin_training.sway.walker_simulation import WalkerSimulation

__all__ = ["KEPT_EVERY", "Walkers", "simulated_walkers"]

KEPT_EVERY = 4
"""One of so many frames is learnt."""
AT_ONCE = 5
"""Walkers on each body that are simulated at once, at most."""
MOST_SHAPES = 160
LEAST_VALID = 0.5
"""Share of the frames that must count, see `WalkerSimulation.run`."""
TIMED_FROM = 0.03
"""Share of the frames that are not timed, because kernels are still being loaded. As many are timed at least."""


@dataclass(frozen=True)
class Walkers:
    """Motions: positions (N, T, d) [rad], place (N, T, 3) [m] and turn (N, T, 3, 3) of the root in the world, gravity
    (N, T, 3) in its frame, see `WalkerMotions`, 60 frames a second. Of every fourth frame: coefficients (N, t, r)
    float16 of offsets, resistance (N, t, 12 m) float16 [mN] of inertia and drag, see `WalkerSimulation.run`, and
    whether they count, valid (N, t).
    body (N,): which of the bodies; bodies (S, c'): their shape coefficients; codes (S, c). share: (m,),
    how much of it each garment node sways, see `sway_share`. cost: (12 m, 12 m), see `WalkerSimulation`.
    """

    positions: torch.Tensor
    place: torch.Tensor
    turn: torch.Tensor
    gravity: torch.Tensor
    coefficients: torch.Tensor
    resistance: torch.Tensor
    valid: torch.Tensor
    body: torch.Tensor
    bodies: np.ndarray
    codes: torch.Tensor
    shapes: Shapes
    share: torch.Tensor
    cost: torch.Tensor


def simulated_walkers(
    model: GarmentModel,
    body_model: BodyModel,
    codes: BodyCodes,
    share: np.ndarray,
    device: torch.device,
    *,
    bodies: int,
    each: int,
    seconds: float,
    seed: int,
    within: float,
    say: Callable[[str], None],
) -> Walkers:
    """Simulate `each` walkers on each of so many training bodies, with motions of so many seconds. They are simulated
    equally many at a time, so there may be slightly more of them.

    share: (m,), see `sway_share`. within: [s] that it may take. say: called with sentences on how it went. Raises
    ValueError if most cloth was lost, none moves, or it would take longer.
    """
    chosen = np.random.default_rng(seed).permutation(len(body_model.train_bodies))[:bodies]
    coefficients = body_model.train_bodies[chosen]
    rounds = math.ceil(each / AT_ONCE)
    each = math.ceil(each / rounds)
    simulation = WalkerSimulation(model, body_model, coefficients, each, device, free=share > 0)
    frames = round(seconds * RATE_HZ)
    pool, at_once = MotionPool(model.rig), bodies * each
    watch = _in_time(progress_line(f"simulating {rounds * at_once} walkers"), within)
    motions, found = [], []
    for index in range(rounds):
        motions.append(pool.drawn(range(index * at_once, (index + 1) * at_once), frames, seed=seed))
        found.append(_simulated(simulation, motions[-1], lambda part, done=index: watch((done + part) / rounds)))
    offsets, resistance, valid = (torch.cat(parts) for parts in zip(*found))
    counted = float(valid.float().mean())
    say(f"{len(valid)} walkers of {seconds:g} s simulated, {counted:.1%} of their frames count")
    if counted < LEAST_VALID:
        lost = f"{1 - counted:.0%} of the frames, allowed {1 - LEAST_VALID:.0%}"
        raise ValueError(f"{model.name}: cloth was lost in {lost}")
    mass = float(simulation.potential.time_step.mass.mean(dim=0).sum())
    parts = (part[kept].float() for part, kept in zip(offsets.split(at_once), valid.split(at_once)))
    shapes, moved, missed = principal_shapes(parts, simulation.inertia, simulation.cost, MOST_SHAPES, mass)
    say(f"cloth is {moved:.1f} mm from where it is on average; {len(shapes.directions)} shapes leave {missed:.2f} mm")
    small = [shapes.coefficients(part.float()).half() for part in offsets.split(at_once)]

    def together(name: str) -> torch.Tensor:
        return torch.as_tensor(np.concatenate([getattr(each_round, name) for each_round in motions]), device=device)

    return Walkers(
        *(together("positions"), together("place"), together("turn"), together("gravity")),
        coefficients=torch.cat(small),
        resistance=resistance,
        valid=valid,
        body=simulation.dressed.body.repeat(rounds),
        bodies=coefficients,
        codes=codes(simulation.dressed.body_modulation),
        shapes=shapes,
        share=torch.as_tensor(share, device=device),
        cost=simulation.cost,
    )


def _in_time(watch: Watch, within: float) -> Watch:
    """A watch that raises ValueError once it is sure that all takes longer [s] than it may."""
    first: tuple[float, float] | None = None

    def checked(share: float) -> None:
        nonlocal first
        watch(share)
        if share < TIMED_FROM or not math.isfinite(within):
            return
        first = first or (share, time.monotonic())
        timed, seconds = share - first[0], time.monotonic() - first[1]
        if timed > TIMED_FROM and seconds > within * timed:
            watch(1.0)
            needed = seconds / timed / 60
            raise ValueError(f"simulating walkers takes {needed:.1f} minutes here, and there are {within / 60:.1f}")

    return checked


def _simulated(simulation: WalkerSimulation, motions: WalkerMotions, watch: Watch) -> tuple[torch.Tensor, ...]:
    """Offsets (B, t, 12 m) float16, resistance (B, t, 12 m) float16 [mN], and which of them count (B, t)."""
    kept, felt, valid = [], [], []

    def keep(frame: int, offsets: torch.Tensor, resistance: torch.Tensor, counts: torch.Tensor) -> None:
        if frame % KEPT_EVERY == 0:
            kept.append(offsets.flatten(1).half())
            felt.append((1e3 * resistance).flatten(1).half())
            valid.append(counts)
        watch((frame + 1) / motions.positions.shape[1])

    simulation.run(motions, keep)
    return tuple(torch.stack(parts, dim=1) for parts in (kept, felt, valid))
