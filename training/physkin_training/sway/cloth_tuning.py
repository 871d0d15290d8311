"""Fine-tuning of a learnt sway network by the energies of cloth.

A network that is right on average still strains cloth: where it cannot know what cloth does, it averages over it.
So in every step a frame of some windows is draped, and the network also learns to bring cloth into balance there:
forces of stretch, bending, contact, the band and weight against the simulated forces of inertia and drag. Without
those two, all swing would count as strain. With them some swing is still lost, so the swing of cloth counts more here
than in learning. From here on the network gives offsets of garment nodes instead of coefficients of shapes. Errors
count by distance alone, because the energies know better what an error costs.

Dimensions: `B` bodies, `a = 12 m` numbers of garment nodes, `h` what the last layer reads.
"""

from __future__ import annotations

import torch
from torch import nn

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.soap import Soap
from physkin_training.sway.learning import SWINGING, descend, drawn_from, learning_rates, missed_swing
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.node_skinning import NodeSkinning
from physkin_training.sway.walker_simulation import SLOWLY, in_one_size, potential_of_walkers
from physkin_training.sway.walkers import KEPT_EVERY, Walkers
from physkin_training.sway.windows import Window, Windows

__all__ = ["OffsetLayer", "tuned_network"]

ENERGY, GROWS_FOR = 0.1, 0.5
"""Weight of the energies in the loss, and the share of the steps over which it grows from zero to that. It grows
slowly, because the quickest way to less strain would be less swing. In the loss, energies are divided by the energy of
cloth that swings as far as it does on average, and squared distances by the mean square of that distance."""
COMPRESSED = 0.05
"""Share of the stiffness of cloth that is left under compression. It is more than walkers have: with less, cloth would
crumple here."""
SWING = 10.0
"""Weight in the loss of how far the first shapes swing, which energies would make less."""
WINDOWS, DRAPED = 3, 1
"""Windows of each body in a step, and in how many of them a frame is draped. Those are not blurred, so that cloth fits
the body."""
LEARNING_RATE, LAST_SHARE, WARM_UP_STEPS = 1e-3, 0.02, 100
LAST_LAYER = 0.05
"""Factor by which the last layer learns more slowly."""
LARGEST_FORCE = 15.0
"""Largest norm of a sample's forces, in medians over all samples."""


class OffsetLayer(nn.Module):
    """The network's last layer, to offsets (..., a). It learns in coordinates in which a change costs as much energy in
    every direction.

    At first it gives the offsets that `out` gives as coefficients of the walkers' shapes, times each garment node's
    share of the sway.
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
        """Offsets (..., a) from what the layer reads (..., h)."""
        return self.round(hidden) @ self._from_round

    def coefficients(self, hidden: torch.Tensor) -> torch.Tensor:
        """Coefficients (..., r) of the walkers' shapes, without computing the offsets."""
        weight, bias = self.round.weight.T @ self._projection, self.round.bias @ self._projection - self._mean
        return hidden @ weight + bias

    def folded(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight (a, h) and bias (a,) of the plain linear layer that gives the same offsets."""
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
    """Tune a network in place for so many steps with the walkers `learnt`. Returns its last layer."""
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

    def draw(step: int) -> torch.Tensor:
        energy_share.fill_(ENERGY * min(1.0, (step + 1) / (GROWS_FOR * steps)))
        return torch.cat([rows[torch.randint(len(rows), (WINDOWS,), generator=generator)] for rows in of_body])

    rates = learning_rates(LEARNING_RATE, steps, warm_up=WARM_UP_STEPS, last=LAST_SHARE)
    with drawn_from(generator, device):
        descend(windows, optimiser, loss, draw, rates, windows_a_step=count, doing="fine-tuning")
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
        """Forces (B, a) [N] that are out of balance at offsets (B, a): derivatives of the energies plus the resistance
        of inertia and drag. walker, frame: (B,), the frames counted among those that have a target."""
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
