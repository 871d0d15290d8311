"""SOAP: Adam in the eigenbases of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

Elastic energies are badly conditioned, and how network weights move them together is what Adam cannot see. Kept
libraries have SOAP, but none whose step can be recorded as a CUDA graph: here a step decides nothing on the host, and
the eigenbases are turned between steps. Dimensions: a matrix is (r, c).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import torch
from torch.nn import Parameter

__all__ = ["SIDES", "TURN_EVERY", "Soap"]

BETAS = 0.95, 0.95
"""Of first and second moments in the eigenbases; outside, Adam's own."""
ADAM_BETAS = 0.9, 0.999
COVARIANCE_BETA = 0.98
EPSILON = 1e-8
LEAST_SIDE = 8
"""Matrices with a smaller side are Adam's."""
LARGEST_SIDE = {"cuda": 2048, "cpu": 512}
"""By kind of device: larger sides have no eigenbasis. On a CPU bases of 1,536 and 2,048 took half of a step."""
TURN_EVERY, FIRST_TURNS = 50, 10
"""Steps between two turns of the bases, later and while the first are taken."""
SIDES = ("rows", "columns")


class Soap:
    """Descends networks by SOAP, and what is no matrix of them and `others` by Adam.

    units: by parameter, a tensor that its gradient can be multiplied by: these parameters move as if they were numbers
    in these units, a step being that much longer. Learning rates are tensors, those of `param_groups`: networks'
    matrices, networks' vectors, others. All state lies in `state`, by parameter: "exp_avg" and "exp_avg_sq", in the
    eigenbases where there are any, and for each side that has one "covariance_rows", "basis_rows",
    "covariance_columns", "basis_columns".

    It has what an optimiser of torch has, but is none: these import torch's compiler, which takes some six seconds.
    """

    def __init__(
        self,
        networks: Iterable[Parameter],
        others: Sequence[Parameter],
        device: torch.device,
        *,
        units: Mapping[Parameter, torch.Tensor] | None = None,
    ) -> None:
        networks = list(networks)
        matrices = [p for p in networks if p.ndim == 2 and min(p.shape) >= LEAST_SIDE]
        vectors = [p for p in networks if not any(p is matrix for matrix in matrices)]
        groups = [(matrices, BETAS), (vectors, ADAM_BETAS), (others, ADAM_BETAS)]
        self.steps = torch.zeros((), device=device)
        self._units = dict(units or {})
        self.param_groups = [
            {"params": list(p), "betas": betas, "lr": torch.zeros((), device=device)} for p, betas in groups if p
        ]
        self.state: dict[Parameter, dict[str, torch.Tensor]] = {}
        for parameter in networks + list(others):
            state = {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
            if any(parameter is matrix for matrix in matrices):
                for side, size in zip(SIDES, parameter.shape):
                    if size <= LARGEST_SIDE[device.type]:
                        state[f"covariance_{side}"] = torch.zeros(size, size, device=device)
                        state[f"basis_{side}"] = torch.eye(size, device=device)
            self.state[parameter] = state

    def zero_grad(self) -> None:
        """Forget all gradients."""
        for group in self.param_groups:
            for parameter in group["params"]:
                parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """One step, of parameters that all have gradients."""
        self.steps += 1
        for group in self.param_groups:
            (beta1, beta2), parameters = group["betas"], group["params"]
            states = [self.state[parameter] for parameter in parameters]
            gradients = [self._in_units(parameter.grad, parameter) for parameter in parameters]
            for gradient, state in zip(gradients, states):
                _update_covariances(gradient, state)
            gradients = [_into_bases(gradient, state) for gradient, state in zip(gradients, states)]
            first, second = ([state[name] for state in states] for name in ("exp_avg", "exp_avg_sq"))
            torch._foreach_lerp_(first, gradients, 1 - beta1)
            torch._foreach_mul_(second, beta2)
            torch._foreach_addcmul_(second, gradients, gradients, 1 - beta2)
            size = torch._foreach_sqrt(second)
            torch._foreach_add_(size, EPSILON)
            moves = torch._foreach_div(first, size)
            torch._foreach_mul_(moves, -group["lr"] * torch.sqrt(1 - beta2**self.steps) / (1 - beta1**self.steps))
            moves = [_out_of_bases(move, state) for move, state in zip(moves, states)]
            torch._foreach_add_(parameters, [self._in_units(*pair) for pair in zip(moves, parameters)])

    def _in_units(self, values: torch.Tensor, parameter: Parameter) -> torch.Tensor:
        """A gradient in a parameter's units, or a move out of them: the same product."""
        return values * self._units[parameter] if parameter in self._units else values

    def turn_bases(self, step: int) -> None:
        """After `step` steps: where it is time, bring all bases closer to the covariances' eigenvectors."""
        if step % (TURN_EVERY if step > TURN_EVERY else FIRST_TURNS) == 0:
            self._turn()

    @torch.no_grad()
    def _turn(self) -> None:
        """One step of orthogonal iteration; first moments turn along."""
        for state in self.state.values():
            before = {side: state[f"basis_{side}"].clone() for side in SIDES if f"basis_{side}" in state}
            for side, basis in before.items():
                turned, _ = torch.linalg.qr(state[f"covariance_{side}"] @ basis)
                state[f"basis_{side}"].copy_(turned)
            if before:
                moment = _out_of_bases(state["exp_avg"], {f"basis_{side}": basis for side, basis in before.items()})
                state["exp_avg"].copy_(_into_bases(moment, state))
                # A second moment is never below the first one's square; in other bases it may be, and steps are huge.
                state["exp_avg_sq"].copy_(torch.maximum(state["exp_avg_sq"], state["exp_avg"].square()))


def _update_covariances(gradient: torch.Tensor, state: dict) -> None:
    if "covariance_rows" in state:
        state["covariance_rows"].addmm_(gradient, gradient.mT, beta=COVARIANCE_BETA, alpha=1 - COVARIANCE_BETA)
    if "covariance_columns" in state:
        state["covariance_columns"].addmm_(gradient.mT, gradient, beta=COVARIANCE_BETA, alpha=1 - COVARIANCE_BETA)


def _into_bases(matrix: torch.Tensor, state: dict) -> torch.Tensor:
    if "basis_rows" in state:
        matrix = state["basis_rows"].mT @ matrix
    return matrix @ state["basis_columns"] if "basis_columns" in state else matrix


def _out_of_bases(matrix: torch.Tensor, state: dict) -> torch.Tensor:
    if "basis_rows" in state:
        matrix = state["basis_rows"] @ matrix
    return matrix @ state["basis_columns"].mT if "basis_columns" in state else matrix
