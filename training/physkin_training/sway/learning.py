"""Learning a sway network from walkers: what it makes of windows of motion against what was simulated.

The error is measured in shapes: by the mass that is elsewhere, and by what that costs. What is nearest on average to
all that may happen swings less far than cloth does, so the first shapes are also asked to go as far to and fro as they
did. Walkers that are held out say how well it is learnt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from physkin_core.progress import progress_line
from physkin_training.soap import Soap
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.walkers import Walkers
from physkin_training.sway.window_descent import WindowDescent
from physkin_training.sway.windows import STRIDES, Window, Windows

__all__ = ["drawn_from", "held_out_millimetres", "learnt_network", "learning_rate", "missed_swing", "split"]

BATCH = 256
"""Windows of a step."""
LEARNING_RATE, LAST_SHARE, WARM_UP_STEPS = 3e-3, 0.01, 100
SWINGING, SWING = 16, 1.0
"""Of how many shapes it is asked how far they swing, and how much that counts."""
HELD_OUT, MOST_HELD_OUT = 0.1, 320
"""Of the walkers."""


def split(walkers: Walkers, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Walkers to learn from, and those held out, both as indices. Of every body there are some to learn from."""
    order = torch.randperm(len(walkers.body), generator=generator)
    body = walkers.body.cpu()[order]
    first_of_body = torch.stack([(body == k).nonzero()[0, 0] for k in range(len(walkers.bodies))])
    may_be_held = torch.ones(len(order), dtype=torch.bool)
    may_be_held[first_of_body] = False
    held = order[may_be_held][: max(1, min(MOST_HELD_OUT, round(HELD_OUT * len(order))))]
    return order[~torch.isin(order, held)], held


def learning_rate(step: int, steps: int, *, warm_up: int, last: float) -> float:
    """Share of the full learning rate: after a warm-up half a cosine down to `last`."""
    return (last + (1 - last) * (1 + math.cos(math.pi * step / steps)) / 2) * min(1.0, (step + 1) / warm_up)


@contextmanager
def drawn_from(generator: torch.Generator, device: torch.device) -> Iterator[None]:
    """What torch draws by itself, such as first weights and blur, follows from the generator, too."""
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
    """A network from `joints` joints to coefficients of the walkers' shapes, after so many steps with windows of the
    walkers `learnt`."""
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

        descent = WindowDescent(windows, optimiser, loss, windows_a_step=BATCH)
        watch = progress_line("learning")
        for step in range(steps):
            rate = LEARNING_RATE * learning_rate(step, steps, warm_up=WARM_UP_STEPS, last=LAST_SHARE)
            descent.step(learnt[torch.randint(len(learnt), (BATCH,), generator=generator)], rate)
            watch((step + 1) / steps)
    return network


def missed_swing(window: Window, coefficients: torch.Tensor) -> torch.Tensor:
    """How much farther the first shapes go to and fro by coefficients (B, t, r) than they did, (B, SWINGING)."""
    own, simulated = (window.swing(each[..., :SWINGING]) for each in (coefficients, window.coefficients))
    return own - simulated


def held_out_millimetres(
    walkers: Walkers,
    features: Features,
    held_out: torch.Tensor,
    coefficients: Callable[[torch.Tensor], torch.Tensor],
    network: SwayModule,
) -> float:
    """How far cloth of held-out walkers is from what was simulated [mm], at all frame rates. coefficients: of shapes
    (..., r), of what the network's last layer reads."""
    windows, errors = Windows(walkers, features), []
    with torch.no_grad():
        for stride in STRIDES:
            window = windows.at(held_out.to(walkers.positions.device), stride=stride)
            differences = coefficients(window.hidden(network)) - window.coefficients
            errors.append(window.mean(walkers.shapes.millimetres(differences)))
    return float(torch.stack(errors).mean().sqrt())
