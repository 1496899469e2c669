"""Heads: drawn from the given generator alone; the order of an embedder's parts."""

import numpy as np
import torch

from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.projection import Projection


def test_a_head_follows_from_its_generator_and_leaves_torchs_own_alone():
    torch.manual_seed(0)
    state = torch.get_rng_state()
    first, second, other = (linear_head(100, 8, np.random.default_rng(s)) for s in (1, 1, 2))
    assert torch.equal(first.weight, second.weight) and not torch.equal(first.weight, other.weight)
    assert torch.equal(torch.get_rng_state(), state)
    assert first.weight.abs().max() <= 0.1 and first.weight.std() > 0.04


def test_an_embedder_projects_before_its_head():
    x = torch.randn(50, 6, generator=torch.Generator().manual_seed(0))
    projection, head = Projection(6, 3), linear_head(3, 2, np.random.default_rng(0))
    projection.fit(x, np.random.default_rng(0))
    assert torch.equal(Embedder(projection, head)(x), head(projection(x)))
    assert torch.equal(Embedder(None, None)(x), x)
