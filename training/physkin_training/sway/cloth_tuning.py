"""Fine-tuning of a learnt sway network by the energies of cloth.

A network that is near what was simulated on average still strains cloth: what it cannot tell it blurs. So a frame of
some windows is draped, and it is learnt, too, how far cloth is from balance there: what stretch, bending, contact, the
band and weight say against the inertia and drag that were simulated. At rest alone they would take all swing for
strain; in balance they still take some, so how far cloth swings counts more here. From here on the network gives
offsets themselves, beyond the shapes, and errors count by distance alone: what they cost is known better here.

Dimensions: `B` bodies, `a = 12 m` numbers of garment nodes, `h` what the last layer reads.
"""

from __future__ import annotations

import torch
from torch import nn

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.progress import progress_line
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.soap import Soap
from physkin_training.sway.learning import SWINGING, drawn_from, learning_rate, missed_swing
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.node_skinning import NodeSkinning
from physkin_training.sway.walker_simulation import SLOWLY, in_one_size, potential_of_walkers
from physkin_training.sway.walkers import KEPT_EVERY, Walkers
from physkin_training.sway.window_descent import WindowDescent
from physkin_training.sway.windows import Window, Windows

__all__ = ["OffsetLayer", "tuned_network"]

ENERGY, GROWS_FOR = 0.1, 0.5
"""How much energies count, in shares of that of cloth that swings as far as it is from where it is on average, against
squared distances, in shares of that; and the share of the steps in which it grows to that: strain is taken out little
by little, as less swing would be the quickest way."""
COMPRESSED = 0.05
"""Share of the stiffness of cloth that is left under compression: more than of walkers, as here it would crumple."""
SWING = 10.0
"""How much it counts how far the first shapes swing: energies would rather have them still."""
WINDOWS, DRAPED = 3, 1
"""Windows a body in a step, and of how many a frame is draped; these are not blurred, as cloth fits the body."""
LEARNING_RATE, LAST_SHARE, WARM_UP_STEPS = 1e-3, 0.02, 100
LAST_LAYER = 0.05
"""How much slower the last layer learns."""
LARGEST_FORCE = 15.0
"""Of a sample, against the median of all."""


class OffsetLayer(nn.Module):
    """The network's last layer, to offsets (..., a), learnt in coordinates in which what a difference costs is round.

    Begins as what `out` makes of the walkers' shapes, of which each garment node has its share.
    """

    def __init__(self, out: nn.Linear, walkers: Walkers) -> None:
        super().__init__()
        shapes, cost = walkers.shapes, walkers.cost.double()
        root = torch.linalg.cholesky(cost + 1e-6 * cost.diagonal().max() * torch.eye(len(cost), device=cost.device))
        inverse = torch.linalg.solve_triangular(root, torch.eye(len(cost), device=cost.device).double(), upper=False)
        moves = walkers.share.repeat_interleave(12)
        self.register_buffer("_from_round", LAST_LAYER * inverse.float() * moves)
        self.register_buffer("_projection", self._from_round @ shapes.projection)
        self.register_buffer("_mean", shapes.mean @ shapes.projection)
        self.round = nn.Linear(out.in_features, len(cost)).to(cost.device)
        with torch.no_grad():
            to_round = root.float() / LAST_LAYER
            self.round.weight.copy_((out.weight.T @ shapes.directions @ to_round).T)
            self.round.bias.copy_(shapes.offsets(out.bias) @ to_round)

    def forward(self, hidden: torch.Tensor) -> torch.Tensor:
        """Offsets (..., a) of what the layer reads (..., h)."""
        return self.round(hidden) @ self._from_round

    def coefficients(self, hidden: torch.Tensor) -> torch.Tensor:
        """The same in shapes (..., r), by a small product."""
        weight, bias = self.round.weight.T @ self._projection, self.round.bias @ self._projection - self._mean
        return hidden @ weight + bias

    def folded(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight (a, h) and bias (a,) of the plain layer that gives the same."""
        return self._from_round.T @ self.round.weight, self.round.bias @ self._from_round


def tuned_network(
    model: GarmentModel,
    body_model: BodyModel,
    walkers: Walkers,
    features: Features,
    network: SwayModule,
    learnt: torch.Tensor,
    generator: torch.Generator,
    *,
    steps: int,
) -> OffsetLayer:
    """Tune a network in place, and its last layer, which is returned, for so many steps with the walkers `learnt`."""
    last = OffsetLayer(network.out, walkers)
    own = [parameter for name, parameter in network.named_parameters() if not name.startswith("out")]
    optimiser = Soap([*own, *last.parameters()], [], walkers.positions.device)
    windows, cloth = Windows(walkers, features), _Cloth(model, body_model, walkers)
    of_body = [learnt[walkers.body.cpu()[learnt] == body] for body in range(len(walkers.bodies))]
    device, count = walkers.positions.device, WINDOWS * len(of_body)
    sharp = torch.arange(count, device=device) % WINDOWS < DRAPED
    draped = sharp.nonzero()[:, 0]
    spread = walkers.shapes.millimetres(walkers.coefficients[walkers.valid].float()).mean()
    squares = walkers.shapes.distance.diagonal()
    swing = SLOWLY / 2 * cloth.mass * spread / 1e6
    energy_share = torch.zeros((), device=device)

    def loss(window: Window) -> torch.Tensor:
        hidden, evenly = window.blurred(sharp=sharp).hidden(network), window.evenly()
        coefficients = last.coefficients(hidden)
        errors = walkers.shapes.millimetres(coefficients - window.coefficients)
        error = window.mean(evenly[:, None] * errors)
        swing_error = (evenly * (missed_swing(window, coefficients).square() @ squares[:SWINGING])).mean()
        frame = torch.randint(hidden.shape[1], draped.shape, device=device)
        offsets = last(hidden[draped, frame])
        forces = cloth.forces(offsets.detach(), window.walker[draped], frame)
        energy = (window.share[draped, frame, None] * offsets * forces).sum() / len(forces)
        return (error + SWING * swing_error) / spread + energy_share * energy / swing

    descent = WindowDescent(windows, optimiser, loss, windows_a_step=count)
    watch = progress_line("fine-tuning")
    with drawn_from(generator, device):
        for step in range(steps):
            energy_share.fill_(ENERGY * min(1.0, (step + 1) / (GROWS_FOR * steps)))
            drawn = [rows[torch.randint(len(rows), (WINDOWS,), generator=generator)] for rows in of_body]
            rate = LEARNING_RATE * learning_rate(step, steps, warm_up=WARM_UP_STEPS, last=LAST_SHARE)
            descent.step(torch.cat(drawn), rate)
            watch((step + 1) / steps)
    return last


class _Cloth:
    """Drapes of a few walkers on each body. mass [kg], the mean over bodies."""

    def __init__(self, model: GarmentModel, body_model: BodyModel, walkers: Walkers) -> None:
        self._walkers = walkers
        count, device = len(walkers.bodies), walkers.positions.device
        body = torch.arange(count * DRAPED, device=device) // DRAPED
        self._dressed = DressedSamples(model, body_model, walkers.bodies, body, one_size=in_one_size(count))
        self._potential = potential_of_walkers(self._dressed, compressed=COMPRESSED)
        self._skinning = NodeSkinning(self._dressed)
        self.mass = self._potential.time_step.mass.sum(dim=1).mean()

    @torch.no_grad()
    def forces(self, offsets: torch.Tensor, walker: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
        """Forces (B, a) [N] out of balance at offsets (B, a) of these walkers' frames (B,), of those that have
        a target: derivatives of the energies, and the resistance of inertia and drag."""
        known, dressed, at = self._walkers, self._dressed, KEPT_EVERY * frame
        positions, gravity = known.positions[walker, at], known.gravity[walker, at]
        posed = dressed.pose(positions)
        turns = posed[..., :3]
        drape, folds = dressed.draped(positions, gravity, posed)
        self._skinning.fold(folds)
        vertices = self._skinning.vertices(drape + turns @ offsets.unflatten(1, (-1, 3, 4)))
        self._potential.begin(vertices, vertices)  # inertia and drag are those that were simulated
        _, gradient = self._potential.evaluate(vertices, gravity, *dressed.contact)
        resistance = known.resistance[walker, frame].float() / 1e3
        forces = ((turns.mT @ self._skinning.transposed(gradient)).flatten(1) + resistance).nan_to_num()
        size = forces.norm(dim=1, keepdim=True)
        return forces * (LARGEST_FORCE * size.median() / size.clamp_min(1e-12)).clamp_max(1)
