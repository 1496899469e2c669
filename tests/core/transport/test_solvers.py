"""Solvers against POT, each other and what must hold of every coupling."""

import numpy as np
import ot
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rapl_core.errors import ConvergenceError, ShapeError, UnknownNameError
from rapl_core.transport import TransportConfig, pairwise_cost, solve

SOLVERS = ("sinkhorn", "exact", "uniform")
TIGHT = TransportConfig(tolerance=1e-9, max_iterations=20_000)


def random_cost(seed: int, t: int, s: int) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    x = torch.from_numpy(rng.normal(size=(t, 6)).cumsum(0))
    y = torch.from_numpy(rng.normal(size=(s, 6)).cumsum(0))
    return pairwise_cost(x, y, "cosine")


def uniform(size: int) -> np.ndarray:
    return np.full(size, 1.0 / size)


@pytest.mark.parametrize("epsilon", [1.0, 0.1, 0.01, 0.005])
def test_the_sinkhorn_plan_equals_that_of_pot(epsilon):
    cost = random_cost(0, 50, 40)
    ours = solve(cost, TransportConfig(epsilon=epsilon, tolerance=1e-9, max_iterations=20_000))
    theirs, log = ot.bregman.sinkhorn_log(
        uniform(50), uniform(40), cost.numpy(), epsilon,
        numItermax=20_000, stopThr=1e-11, log=True,
    )  # fmt: skip
    assert ours.converged and log["err"][-1] < 1e-11
    np.testing.assert_allclose(ours.plan, theirs, atol=1e-6 / 50)


@pytest.mark.parametrize(("t", "s"), [(50, 50), (13, 29), (1, 5)])
def test_the_exact_cost_equals_that_of_pot(t, s):
    cost = random_cost(1, t, s)
    ours = solve(cost, TransportConfig(solver="exact"))
    assert ours.converged
    assert float(ours.cost) == pytest.approx(ot.emd2(uniform(t), uniform(s), cost.numpy()))


def test_sinkhorn_lies_between_the_exact_and_the_uniform_coupling():
    cost = random_cost(2, 20, 20)
    exact = float(solve(cost, TransportConfig(solver="exact")).cost)
    independent = float(solve(cost, TransportConfig(solver="uniform")).cost)
    previous = exact
    for epsilon in (0.003, 0.03, 0.3, 3.0, 300.0):
        regularised = solve(
            cost, TransportConfig(epsilon=epsilon, tolerance=1e-8, max_iterations=50_000)
        )
        assert regularised.converged
        assert previous - 1e-9 < float(regularised.cost) < independent + 1e-9
        previous = float(regularised.cost)
    assert previous == pytest.approx(independent, rel=1e-2)


def test_a_tiny_epsilon_neither_overflows_nor_loses_mass():
    cost = random_cost(3, 30, 30)
    result = solve(cost, TransportConfig(epsilon=1e-5, max_iterations=200))
    assert torch.isfinite(result.plan).all()
    assert float(result.plan.sum()) == pytest.approx(1.0)
    assert torch.isfinite(result.marginal_error)


def test_costs_of_any_size_are_solved():
    cost = random_cost(4, 20, 20)
    for factor in (1e-8, 1e8):
        config = TransportConfig(epsilon=0.1 * factor, tolerance=1e-9)
        result = solve(cost * factor, config)
        reference = solve(cost, TransportConfig(epsilon=0.1, tolerance=1e-9))
        np.testing.assert_allclose(result.plan, reference.plan, atol=1e-9)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_batch_is_solved_like_its_members(solver):
    costs = torch.stack([random_cost(seed, 12, 9) for seed in range(6)]).reshape(2, 3, 12, 9)
    config = TransportConfig(solver=solver, epsilon=0.02)
    batch = solve(costs, config)
    assert batch.plan.shape == (2, 3, 12, 9) and batch.cost.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        alone = solve(costs[i, j], config)
        np.testing.assert_allclose(batch.plan[i, j], alone.plan, atol=1e-12)
        assert batch.iterations[i, j] == alone.iterations


def test_a_float32_cost_gets_a_float32_plan():
    assert solve(random_cost(5, 5, 5).float(), TIGHT).plan.dtype == torch.float32


def test_too_few_iterations_are_reported_or_raised():
    cost = random_cost(6, 40, 40)
    config = TransportConfig(epsilon=1e-3, max_iterations=10)
    result = solve(cost, config)
    assert not result.converged
    assert result.iterations == 10
    assert result.marginal_error > config.tolerance
    with pytest.raises(ConvergenceError, match="1 of 1 problems.*after 10 iterations.*epsilon"):
        solve(cost, TransportConfig(epsilon=1e-3, max_iterations=10, require_convergence=True))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    t=st.integers(1, 12),
    s=st.integers(1, 12),
    solver=st.sampled_from(SOLVERS),
    epsilon=st.sampled_from([0.05, 0.5, 5.0]),
)
def test_every_plan_has_uniform_marginals_and_no_negative_mass(seed, t, s, solver, epsilon):
    config = TransportConfig(solver=solver, epsilon=epsilon)
    result = solve(random_cost(seed, t, s), config)
    assert result.converged
    assert float(result.plan.min()) >= 0.0
    np.testing.assert_allclose(result.plan.sum(-1), uniform(t), atol=1e-6)
    np.testing.assert_allclose(result.plan.sum(-2), uniform(s), atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    size=st.integers(2, 10),
    solver=st.sampled_from(SOLVERS),
    data=st.data(),
)
def test_permuted_frames_give_a_permuted_plan(seed, size, solver, data):
    cost = random_cost(seed, size, size + 1)
    order = data.draw(st.permutations(range(size)))
    config = TransportConfig(solver=solver, epsilon=0.1, tolerance=1e-10)
    plan = solve(cost, config).plan
    permuted = solve(cost[list(order)], config).plan
    np.testing.assert_allclose(permuted, plan[list(order)], atol=1e-9)


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (torch.zeros(3), r"shape \(3,\)"),
        (torch.zeros(0, 3), r"shape \(0, 3\)"),
        (torch.full((2, 2), float("nan")), "NaN or infinite"),
        (torch.full((2, 2), float("inf")), "NaN or infinite"),
    ],
)
def test_a_bad_cost_is_refused(cost, message):
    with pytest.raises(ShapeError, match=message):
        solve(cost, TransportConfig())


@pytest.mark.parametrize(
    ("field", "value", "known"),
    [("cost", "l1", "cosine"), ("solver", "greedy", "exact"), ("expert", "best", "closest")],
)
def test_an_unknown_name_in_the_configuration_is_refused_with_the_known_ones(field, value, known):
    with pytest.raises(UnknownNameError, match=f"{value}.*{known}"):
        TransportConfig(**{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [("epsilon", 0.0), ("epsilon", float("nan")), ("tolerance", -1.0), ("max_iterations", 0)],
)
def test_a_number_out_of_range_is_refused_by_name(field, value):
    with pytest.raises(ShapeError, match=field):
        TransportConfig(**{field: value})
