"""The gradient of the distance of two videos against finite differences."""

import numpy as np
import pytest
import torch

from rapl_core.transport import TransportConfig, ot_distance, pairwise_cost, solve


def videos(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(6, 3)), rng.normal(size=(5, 3))
    return torch.from_numpy(x), torch.from_numpy(y)


def finite_differences(function, x: torch.Tensor, step: float = 1e-5) -> np.ndarray:
    gradient = np.zeros(x.shape)
    for index in np.ndindex(*x.shape):
        up, down = x.clone(), x.clone()
        up[index] += step
        down[index] -= step
        gradient[index] = (float(function(up)) - float(function(down))) / (2 * step)
    return gradient


def gradient_of_distance(x: torch.Tensor, y: torch.Tensor, config: TransportConfig) -> np.ndarray:
    x = x.clone().requires_grad_()
    ot_distance(x, y, config).backward()
    return x.grad.numpy()


@pytest.mark.parametrize("kind", ["cosine", "euclidean", "sqeuclidean"])
@pytest.mark.parametrize("solver", ["exact", "uniform"])
def test_the_gradient_of_the_distance_equals_finite_differences(kind, solver):
    x, y = videos(0)
    config = TransportConfig(cost=kind, solver=solver)
    numeric = finite_differences(lambda v: ot_distance(v, y, config), x)
    np.testing.assert_allclose(gradient_of_distance(x, y, config), numeric, atol=1e-7)


@pytest.mark.parametrize("epsilon", [0.05, 0.5])
def test_the_sinkhorn_gradient_is_that_of_the_regularised_objective(epsilon):
    x, y = videos(1)
    config = TransportConfig(epsilon=epsilon, tolerance=1e-12, max_iterations=20_000)

    def objective(v: torch.Tensor) -> torch.Tensor:
        result = solve(pairwise_cost(v, y, "cosine"), config)
        return result.cost + epsilon * torch.special.xlogy(result.plan, result.plan).sum()

    numeric = finite_differences(objective, x)
    np.testing.assert_allclose(gradient_of_distance(x, y, config), numeric, atol=1e-7)


def test_distances_of_a_batch_are_those_of_its_members():
    x, y = videos(2)
    config = TransportConfig(epsilon=0.1)
    batch = ot_distance(torch.stack([x, x + 1]), y, config)
    np.testing.assert_allclose(
        batch, [float(ot_distance(x, y, config)), float(ot_distance(x + 1, y, config))]
    )


def test_the_uniform_distance_is_the_transport_cost_of_the_uniform_plan():
    x, y = videos(3)
    config = TransportConfig(cost="euclidean", solver="uniform")
    expected = solve(pairwise_cost(x, y, "euclidean"), config).cost
    assert float(ot_distance(x, y, config)) == pytest.approx(float(expected))
