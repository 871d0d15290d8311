"""The sway network in torch: twin of native/src/evaluator/learnt_sway.cpp, over whole windows of frames.

Dimensions: `B` windows, `T` frames, `j` joints, `f = 2 j + 15` drive, `p = j + 3` pose, `c` body code, `K` oscillators.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.sway_network import SwayNetwork, drive_size, pose_size
from physkin_core.native_module import native
from physkin_core.rig.rig import Rig
from physkin_core.runtime.around_legs import of_legs, reaches_knees
from physkin_training.sway.body_codes import BodyCodes

__all__ = ["HIDDEN", "Features", "SwayModule", "swaying_joints"]

BEYOND: float = native.constants["joints_beyond"]
LARGEST_RATE: float = native.constants["largest_rate"]
LARGEST_VELOCITY: float = native.constants["largest_velocity"]
LARGEST_TURNING: float = native.constants["largest_turning"]
MOST_SPEED_UP: float = native.constants["most_speed_up"]
"""As in C++, which says what they are."""

HIDDEN, OSCILLATORS, READ, LAST = 96, 64, 192, 96
SLOWEST, FASTEST = 2.0, 12.0
"""[1/s] by which oscillators decay at first."""
LEAST_RATE, MOST_RATE = 1.8, 50.0
"""[1/s] between which learning leaves them, gates included; slower ones still move cloth seconds after a stop."""
GATE = -1.0
"""Bias of gates at first: they let oscillators run slower than they could, but not at their slowest."""
LOWEST_HZ, HIGHEST_HZ, STILL = 0.3, 4.0, 0.25
"""How often they oscillate at first; a quarter of them does not."""

HIDDEN_LAYERS, CODE_LAYERS = ("first", "drive", "gate", "read", "last"), ("first_code", "read_code")
"""Layers with a bias but for the last one, `out`, and those that read the body code; `SwayNetwork` has the same names.
"""


def swaying_joints(model: GarmentModel, free: np.ndarray) -> np.ndarray:
    """The joints (j,) int32 that a sway network looks at: those that move the bones which `free` garment nodes (m,)
    follow, and whole legs where cloth reaches the knees. Raises ValueError where none of them moves."""
    rig = model.rig
    followed = set(model.node_bone[free].tolist())
    moving = followed.union(*(rig.ancestors(bone) for bone in followed))
    if reaches_knees(rig, model.node_bone[free]):
        moving.update(np.flatnonzero(of_legs(rig)).tolist())
    joints = np.flatnonzero(np.isin(rig.dof_bones, list(moving))).astype(np.int32)
    if not len(joints):
        raise ValueError("no joint moves the garment nodes that are to sway: sway cannot be learnt")
    return joints


class Features:
    """What the network sees of motions of a rig."""

    def __init__(self, rig: Rig, joints: np.ndarray, device: torch.device) -> None:
        self._joints = torch.as_tensor(joints, device=device).long()
        lower, upper = (torch.tensor(a[joints], dtype=torch.float32, device=device) for a in (rig.lower, rig.upper))
        self._middle, self._half = (lower + upper) / 2, (upper - lower) / 2

    def __call__(
        self, positions: torch.Tensor, place: torch.Tensor, turn: torch.Tensor, gravity: torch.Tensor, step: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Drive (B, T, f) and pose (B, T, p) of positions (B, T, d), place (B, T, 3) and turn (B, T, 3, 3) of the root,
        and gravity (B, T, 3) in its frame, in frames of `step` [s]. The first one stands still."""
        joints = (positions[..., self._joints] - self._middle) / self._half
        rate = (joints - _before(joints)) / step
        moved = (place - _before(place)) / step
        velocity = (turn.mT @ moved[..., None])[..., 0]
        turning = _rotation_vector(_before(turn).mT @ turn) / step
        rate, v, w = _softly(rate, LARGEST_RATE), _softly(velocity, LARGEST_VELOCITY), _softly(turning, LARGEST_TURNING)
        mean, down = (joints + _before(joints)) / 2, (gravity + _before(gravity)) / 2
        pose = torch.cat([joints.clamp(-BEYOND, BEYOND), gravity], dim=-1)
        rates = (rate / 3, v, w / 2, torch.linalg.cross(w, v) / 4, w * w / 8)
        return torch.cat([mean.clamp(-BEYOND, BEYOND), down, *rates], dim=-1), pose


class SwayModule(nn.Module):
    """joints, code: how many numbers these are; outputs: of the last layer."""

    def __init__(self, joints: int, code: int, outputs: int) -> None:
        super().__init__()
        drive = drive_size(joints)
        self.first, self.first_code = nn.Linear(drive, HIDDEN), nn.Linear(code, HIDDEN, bias=False)
        self.drive, self.gate = nn.Linear(HIDDEN, 2 * OSCILLATORS), nn.Linear(HIDDEN, OSCILLATORS)
        order = torch.randperm(OSCILLATORS)
        slower = MOST_SPEED_UP * math.tanh(GATE)  # than ungated, a logarithm
        decays = torch.linspace(math.log(SLOWEST), math.log(FASTEST), OSCILLATORS) - slower
        self.log_rates = nn.Parameter(decays[order])
        turns = torch.exp(torch.empty(OSCILLATORS).uniform_(math.log(LOWEST_HZ), math.log(HIGHEST_HZ)))
        turns[: round(STILL * OSCILLATORS)] = 0
        self.turns = nn.Parameter(2 * math.pi * math.exp(-slower) * turns)
        self.read = nn.Linear(2 * OSCILLATORS + pose_size(joints) + drive, READ)
        self.read_code = nn.Linear(code, READ, bias=False)
        self.last, self.out = nn.Linear(READ, LAST), nn.Linear(LAST, outputs)
        nn.init.zeros_(self.gate.weight)
        nn.init.constant_(self.gate.bias, GATE)
        nn.init.normal_(self.out.weight, std=0.3 / math.sqrt(LAST))

    @classmethod
    def of(cls, sway: SwayNetwork) -> SwayModule:
        """A model's network in torch. Its outputs are in the order of the file, see `exported`."""
        network = cls(len(sway.joints), len(sway.code_directions), len(sway.out[1])).eval()
        state = {"log_rates": np.log(sway.rates), "turns": sway.turns}
        for name in (*HIDDEN_LAYERS, "out"):
            state[f"{name}.weight"], state[f"{name}.bias"] = getattr(sway, name)
        state |= {f"{name}.weight": getattr(sway, name) for name in CODE_LAYERS}
        network.load_state_dict({name: torch.as_tensor(np.array(array)) for name, array in state.items()})
        return network

    def exported(self, out: tuple[torch.Tensor, torch.Tensor], joints: np.ndarray, codes: BodyCodes) -> SwayNetwork:
        """The network as part of a garment model.

        out: weight (12 m, h) and bias (12 m,) of the last layer, to offsets of garment nodes (m, 3, 4). In the file the
        nine numbers of each rotation come first and then the translation. joints: (j,) int32, what the network reads.
        """
        entry = torch.arange(len(out[1]), device=out[1].device).view(-1, 3, 4)
        in_file = torch.cat([entry[..., :3].flatten(1), entry[..., 3]], dim=1).flatten()  # (m, 9 + 3)

        def numpy(tensor: torch.Tensor) -> np.ndarray:
            return np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float32)

        state = {name: numpy(tensor) for name, tensor in self.state_dict().items()}
        return SwayNetwork(
            joints=joints,
            **{name: (state[f"{name}.weight"], state[f"{name}.bias"]) for name in HIDDEN_LAYERS},
            **{name: state[f"{name}.weight"] for name in CODE_LAYERS},
            rates=numpy(self.rates),
            turns=state["turns"],
            out=tuple(numpy(part[in_file]) for part in out),
            code_mean=codes.mean,
            code_directions=codes.directions,
        )

    @property
    def rates(self) -> torch.Tensor:
        """(K,) [1/s] by which oscillators decay where their gates leave them as they are."""
        least, most = math.log(LEAST_RATE) + MOST_SPEED_UP, math.log(MOST_RATE)
        return torch.exp(self.log_rates.clamp(least, most))

    def forward(self, drive: torch.Tensor, pose: torch.Tensor, code: torch.Tensor, step: float) -> torch.Tensor:
        """Outputs (B, T, o) of drive (B, T, f), pose (B, T, p) and code (B, c), frames of `step` [s]."""
        return self.out(self.hidden(drive, pose, code, step))

    def hidden(
        self, drive: torch.Tensor, pose: torch.Tensor, code: torch.Tensor, step: float, *, every: int = 1
    ) -> torch.Tensor:
        """What the last layer reads, of every so many frames from the first on."""
        silu, body = nn.functional.silu, code[:, None]
        driven = silu(self.first(drive) + self.first_code(body))
        states = self._oscillate(self.drive(driven), self.gate(driven), step)
        read = torch.cat([states, pose, drive], dim=-1)[:, ::every]
        return silu(self.last(silu(self.read(read) + self.read_code(body))))

    def _oscillate(self, drive: torch.Tensor, gate: torch.Tensor, step: float) -> torch.Tensor:
        """States (B, T, 2 K), real parts and then imaginary ones; they begin at rest."""
        own = torch.complex(-self.rates, self.turns)
        rest = torch.complex(*drive.chunk(2, dim=-1)) * (-own.conj() / own.abs())
        kept = torch.exp(own * torch.exp(MOST_SPEED_UP * torch.tanh(gate)) * step)
        begun = torch.cat([rest[:, :1], ((1 - kept) * rest)[:, 1:]], dim=1)
        states = _recurrence(kept, begun)
        return torch.cat([states.real, states.imag], dim=-1)


def _recurrence(kept: torch.Tensor, driven: torch.Tensor) -> torch.Tensor:
    """x (B, T, K) with x[t] = kept[t] x[t - 1] + driven[t], x[-1] = 0.

    Two frames make one of a sequence of half as many: a window takes few kernels, however long it is.
    """
    frames = driven.shape[1]
    if frames == 1:
        return driven
    first, second = slice(0, frames - 1, 2), slice(1, None, 2)
    at_second = _recurrence(kept[:, second] * kept[:, first], kept[:, second] * driven[:, first] + driven[:, second])
    later = slice(2, None, 2)
    at_first = kept[:, later] * at_second[:, : (frames - 1) // 2] + driven[:, later]
    at_first = torch.cat([driven[:, :1], at_first], dim=1)
    states = torch.stack([at_first[:, : frames // 2], at_second], dim=2).flatten(1, 2)
    return states if frames % 2 == 0 else torch.cat([states, at_first[:, -1:]], dim=1)


def _before(values: torch.Tensor) -> torch.Tensor:
    """Of the frame before, (B, T, ...); of the first frame its own."""
    return torch.cat([values[:, :1], values[:, :-1]], dim=1)


def _rotation_vector(turn: torch.Tensor) -> torch.Tensor:
    """(..., 3) [rad] of rotations (..., 3, 3) by less than half a turn."""
    pairs = ((2, 1), (0, 2), (1, 0))
    axis = torch.stack([turn[..., i, j] - turn[..., j, i] for i, j in pairs], dim=-1) / 2
    sine = axis.norm(dim=-1, keepdim=True)
    cosine = (turn.diagonal(dim1=-2, dim2=-1).sum(dim=-1)[..., None] - 1) / 2
    return axis * (torch.atan2(sine, cosine) / sine.clamp_min(1e-9)).where(sine > 1e-6, 1.0)


def _softly(values: torch.Tensor, largest: float) -> torch.Tensor:
    return values / torch.sqrt(1 + (values / largest) ** 2)
