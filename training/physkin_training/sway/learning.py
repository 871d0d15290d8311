"""Learning a sway network from walkers: its outputs over windows of motion against what was simulated.

The error is measured in coefficients of shapes, so it counts the mass that is in the wrong place and the energy that
this costs. A network that is right on average swings less far than cloth does, so the first shapes are also asked to
swing as far as they did. Walkers that are held out show how well it has learnt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import torch

from physkin_core.progress import progress_line
from physkin_training.recorded_step import RecordedStep
from physkin_training.soap import Soap
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.walkers import Walkers
from physkin_training.sway.windows import STRIDES, Window, Windows

__all__ = ["descend", "drawn_from", "held_out_millimetres", "learnt_network", "learning_rates", "missed_swing", "split"]

BATCH = 256
"""Windows of a step."""
LEARNING_RATE, LAST_SHARE, WARM_UP_STEPS = 3e-3, 0.01, 100
SWINGING, SWING = 16, 1.0
"""How many shapes are asked to swing as far as they did, and the weight of that in the loss."""
HELD_OUT, MOST_HELD_OUT = 0.1, 320
"""Share of the walkers, and how many at most."""


def split(walkers: Walkers, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Indices of the walkers to learn from, some on every body, and of those held out."""
    order = torch.randperm(len(walkers.body), generator=generator)
    body = walkers.body.cpu()[order]
    first_of_body = torch.stack([(body == k).nonzero()[0, 0] for k in range(len(walkers.bodies))])
    may_be_held = torch.ones(len(order), dtype=torch.bool)
    may_be_held[first_of_body] = False
    held = order[may_be_held][: max(1, min(MOST_HELD_OUT, round(HELD_OUT * len(order))))]
    return order[~torch.isin(order, held)], held


def learning_rates(largest: float, steps: int, *, warm_up: int, last: float) -> list[float]:
    """The learning rate of each step: after a warm-up half a cosine from the largest down to a share `last` of it."""

    def share(step: int) -> float:
        return (last + (1 - last) * (1 + math.cos(math.pi * step / steps)) / 2) * min(1.0, (step + 1) / warm_up)

    return [largest * share(step) for step in range(steps)]


@contextmanager
def drawn_from(generator: torch.Generator, device: torch.device) -> Iterator[None]:
    """Let the generator also decide what torch draws by itself, such as first network weights and blur."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
        yield


def learnt_network(
    walkers: Walkers,
    features: Features,
    learnt: torch.Tensor,
    generator: torch.Generator,
    *,
    joints: int,
    steps: int,
) -> SwayModule:
    """A network from `joints` joints to coefficients of the walkers' shapes, trained for so many steps on windows of
    the walkers `learnt`."""
    windows = Windows(walkers, features)
    device = walkers.positions.device
    with drawn_from(generator, device):
        network = SwayModule(joints, walkers.codes.shape[1], walkers.coefficients.shape[2]).to(device)
        optimiser = Soap(network.parameters(), [], device)

        def loss(window: Window) -> torch.Tensor:
            coefficients = network.out(window.blurred().hidden(network))
            errors, evenly = (coefficients - window.coefficients).square().sum(dim=-1), window.evenly()
            swing_errors = missed_swing(window, coefficients).square().sum(dim=-1)
            return window.mean(evenly[:, None] * errors) + SWING * (evenly * swing_errors).mean()

        def draw(step: int) -> torch.Tensor:
            return learnt[torch.randint(len(learnt), (BATCH,), generator=generator)]

        rates = learning_rates(LEARNING_RATE, steps, warm_up=WARM_UP_STEPS, last=LAST_SHARE)
        descend(windows, optimiser, loss, draw, rates, windows_a_step=BATCH, doing="learning")
    return network


def descend(
    windows: Windows,
    optimiser: Soap,
    loss: Callable[[Window], torch.Tensor],
    draw: Callable[[int], torch.Tensor],
    rates: Sequence[float],
    *,
    windows_a_step: int,
    doing: str,
) -> None:
    """Lower the loss of windows of motion, the three frame rates in turn, one step for each of the learning rates.

    A step is many kernels that each take microseconds: launched one by one, they would leave a GPU waiting. So a step
    of each frame rate is recorded once, and `loss` must not wait for the device; what it reads may be changed in place
    between steps. draw: the walkers (windows_a_step,) of a step, by its number. doing: what the progress line says.
    """
    device = optimiser.steps.device
    walkers = torch.zeros(windows_a_step, dtype=torch.int64, device=device)

    def compute(stride: int) -> None:
        optimiser.zero_grad()
        loss(windows.at(walkers, stride=stride)).backward()
        optimiser.step()

    recorded = [RecordedStep(partial(compute, stride), device, clear=optimiser.zero_grad) for stride in STRIDES]
    watch = progress_line(doing)
    for step, rate in enumerate(rates):
        for group in optimiser.param_groups:
            group["lr"].fill_(rate)
        walkers.copy_(draw(step))
        recorded[step % len(STRIDES)]()
        optimiser.turn_bases(step + 1)
        watch((step + 1) / len(rates))


def missed_swing(window: Window, coefficients: torch.Tensor) -> torch.Tensor:
    """How much farther the first shapes swing by coefficients (B, t, r) than they did in simulation, (B, SWINGING)."""
    own, simulated = (window.swing(each[..., :SWINGING]) for each in (coefficients, window.coefficients))
    return own - simulated


def held_out_millimetres(
    walkers: Walkers,
    features: Features,
    held_out: torch.Tensor,
    coefficients: Callable[[torch.Tensor], torch.Tensor],
    network: SwayModule,
) -> float:
    """How far [mm] the network's cloth is from that of held-out walkers, over all frame rates. coefficients: makes
    coefficients of shapes (..., r) from what the network's last layer reads."""
    windows, errors = Windows(walkers, features), []
    with torch.no_grad():
        for stride in STRIDES:
            window = windows.at(held_out.to(walkers.positions.device), stride=stride)
            differences = coefficients(window.hidden(network)) - window.coefficients
            errors.append(window.mean(walkers.shapes.millimetres(differences)))
    return float(torch.stack(errors).mean().sqrt())
