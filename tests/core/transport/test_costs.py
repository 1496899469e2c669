"""Costs against scipy, finite differences and the places where gradients go wrong."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.transport import pairwise_cost

KINDS = ("cosine", "euclidean", "sqeuclidean")


def embeddings(rng: np.random.Generator, *shape: int) -> torch.Tensor:
    return torch.from_numpy(rng.normal(size=shape))


@pytest.mark.parametrize("kind", KINDS)
def test_costs_equal_those_of_scipy(kind):
    rng = np.random.default_rng(0)
    x, y = embeddings(rng, 7, 5), embeddings(rng, 4, 5)
    np.testing.assert_allclose(pairwise_cost(x, y, kind), cdist(x, y, kind), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_costs_what_its_members_cost(kind):
    rng = np.random.default_rng(1)
    x, y = embeddings(rng, 3, 7, 5), embeddings(rng, 3, 4, 5)
    batch = pairwise_cost(x, y, kind)
    assert batch.shape == (3, 7, 4)
    for i in range(3):
        np.testing.assert_allclose(batch[i], pairwise_cost(x[i], y[i], kind), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_equal_finite_differences(kind):
    rng = np.random.default_rng(2)
    x, y = embeddings(rng, 4, 3).requires_grad_(), embeddings(rng, 5, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda a, b: pairwise_cost(a, b, kind), (x, y))


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_finite_where_vectors_coincide_or_vanish(kind):
    rng = np.random.default_rng(3)
    x = embeddings(rng, 4, 3)
    x[1] = 0.0
    x.requires_grad_()
    cost = pairwise_cost(x, x.detach().clone(), kind)
    cost.sum().backward()
    assert torch.isfinite(cost).all()
    assert torch.isfinite(x.grad).all()
    assert x.grad.abs().max() < 1e3


def test_a_zero_vector_costs_one_to_every_direction():
    x = torch.zeros(1, 3)
    assert pairwise_cost(x, torch.eye(3), "cosine").tolist() == [[1.0, 1.0, 1.0]]


def test_equal_float32_vectors_are_at_distance_zero():
    x = torch.randn(50, 32, generator=torch.Generator().manual_seed(0)) + 100.0
    assert pairwise_cost(x, x, "euclidean").diagonal().abs().max() == 0.0


def test_bad_input_is_refused_by_name():
    with pytest.raises(ShapeError, match=r"\(3, 2\) and \(3, 4\)"):
        pairwise_cost(torch.zeros(3, 2), torch.zeros(3, 4), "cosine")
    with pytest.raises(UnknownNameError, match="manhattan.*cosine, euclidean, sqeuclidean"):
        pairwise_cost(torch.zeros(3, 2), torch.zeros(3, 2), "manhattan")
