import pytest
import torch
from torch.nn import Parameter

from physkin_training.soap import LARGEST_SIDE, TURN_EVERY, Soap

CPU = torch.device("cpu")


def make(*, seed=0):
    """A matrix and a vector to descend by SOAP, and another vector."""
    torch.manual_seed(seed)
    networks = [Parameter(torch.randn(12, 9)), Parameter(torch.randn(12))]
    others = [Parameter(torch.randn(5))]
    return networks, others, Soap(networks, others, CPU)


def set_rates(optimiser, rate):
    for group in optimiser.param_groups:
        group["lr"].fill_(rate)


def badly_conditioned():
    """||A W B||^2 with singular values from 1e-2 to 1, in no parameter's own directions."""
    torch.manual_seed(1)
    left, right = (torch.linalg.qr(torch.randn(size, size))[0] for size in (12, 9))
    left, right = left * torch.logspace(-2, 0, 12), right * torch.logspace(-2, 0, 9)[:, None]
    return lambda matrix: (left.T @ matrix @ right.T).square().sum()


def descend(optimiser, networks, others, energy, steps):
    for step in range(1, steps + 1):
        optimiser.zero_grad()
        (energy(networks[0]) + networks[1].square().sum() + others[0].square().sum()).backward()
        optimiser.step()
        if isinstance(optimiser, Soap):
            optimiser.turn_bases(step)
    return float(energy(networks[0].detach()))


def test_where_parameters_must_move_together_it_is_faster_than_adam():
    energy, ends = badly_conditioned(), {}
    for kind in ("soap", "adam"):
        networks, others, optimiser = make()
        set_rates(optimiser, 0.02)
        if kind == "adam":
            optimiser = torch.optim.Adam([*networks, *others], lr=0.02)
        ends[kind] = descend(optimiser, networks, others, energy, 300)
        assert max(networks[1].abs().max(), others[0].abs().max()) < 0.2
    assert ends["soap"] < 0.2 * ends["adam"]


def test_a_turn_keeps_what_was_learnt_and_no_step_grows_past_the_rate():
    """Turning changes coordinates only: the first moment is the same matrix, and no number of a move in the bases is
    ever above the learning rate, whatever the bases were turned by."""
    networks, others, optimiser = make()
    set_rates(optimiser, 0.02)
    energy = badly_conditioned()
    descend(optimiser, networks, others, energy, TURN_EVERY - 1)
    state = optimiser.state[networks[0]]

    def moment():
        return state["basis_rows"] @ state["exp_avg"] @ state["basis_columns"].T

    before, basis = moment(), state["basis_rows"].clone()
    state["covariance_rows"].copy_(torch.diag(torch.linspace(1, 2, 12)))  # quite other eigenvectors
    optimiser.turn_bases(TURN_EVERY)
    torch.testing.assert_close(moment(), before)
    assert not torch.allclose(state["basis_rows"], basis, atol=0.1)
    torch.testing.assert_close(state["basis_rows"] @ state["basis_rows"].T, torch.eye(12), atol=1e-5, rtol=0)
    for _ in range(5):
        matrix = networks[0].detach().clone()
        descend(optimiser, networks, others, energy, 1)
        moved = state["basis_rows"].T @ (networks[0].detach() - matrix) @ state["basis_columns"]
        assert moved.abs().max() <= 0.02 * 1.3  # the bias correction is not 1 yet


def test_a_parameter_in_units_moves_as_the_number_of_these_units_would():
    """W = u V: SOAP and Adam take the steps that they would take in V, through turns of the bases, too."""
    units = torch.logspace(-1, 1, 12)[:, None], torch.logspace(-1, 1, 12)
    networks, others, _ = make()
    mixed, aims = torch.randn(9, 40), torch.randn(12, 40)
    optimiser = Soap(networks, others, CPU, units=dict(zip(networks, units)))
    numbers = [Parameter(parameter.detach() / unit) for parameter, unit in zip(networks, units)]
    twin_others = [Parameter(others[0].detach().clone())]
    twin = Soap(numbers, twin_others, CPU)
    for each in (optimiser, twin):
        set_rates(each, 0.02)
    for step in range(1, 31):
        for each, parameters, rest in ((optimiser, networks, others), (twin, numbers, twin_others)):
            each.zero_grad()
            matrix, vector = (p * u for p, u in zip(parameters, units)) if each is twin else parameters
            ((matrix @ mixed - aims).square().sum() + vector.square().sum() + rest[0].square().sum()).backward()
            each.step()
            each.turn_bases(step)
    for parameter, number, unit in zip(networks, numbers, units):
        torch.testing.assert_close(parameter, number * unit, rtol=1e-3, atol=1e-5)


def test_large_sides_and_vectors_have_no_basis(monkeypatch):
    monkeypatch.setitem(LARGEST_SIDE, "cpu", 10)
    networks, others, optimiser = make()
    kinds = {"exp_avg", "exp_avg_sq"}
    assert optimiser.state[networks[0]].keys() == kinds | {"covariance_columns", "basis_columns"}
    assert optimiser.state[networks[1]].keys() == optimiser.state[others[0]].keys() == kinds


@pytest.mark.parametrize("step, turns", [(10, True), (15, False), (TURN_EVERY, True), (TURN_EVERY + 10, False)])
def test_when_bases_turn(step, turns):
    networks, others, optimiser = make()
    set_rates(optimiser, 0.02)
    descend(optimiser, networks, others, badly_conditioned(), 3)
    basis = optimiser.state[networks[0]]["basis_rows"].clone()
    optimiser.turn_bases(step)
    assert torch.equal(optimiser.state[networks[0]]["basis_rows"], basis) != turns
