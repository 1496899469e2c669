"""Synthetic videos and their features, made once."""

import numpy as np
import pytest
from squares import SMALL, make_pool

from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.rapl import align
from rapl_core.representations.rlhf import learn_reward


@pytest.fixture(scope="session")
def extractor():
    return make_extractor("efficientnet_lite0", SMALL.recipe)


@pytest.fixture(scope="session")
def pool():
    return make_pool("pool", 50, 80, np.random.default_rng(0))


@pytest.fixture(scope="session")
def unseen():
    """Videos and triplets that no training sees."""
    return make_pool("test", 40, 120, np.random.default_rng(1))


@pytest.fixture(scope="session")
def features(extractor, pool):
    store = FeatureStore(extractor)
    for name, frames in pool.videos.items():
        store.add(name, frames)
    return store


@pytest.fixture(scope="session")
def rapl(features, pool):
    """(Encoder, AlignmentReport) of RAPL."""
    return align(features, pool.triplets, pool.expert_ids, SMALL, np.random.default_rng(2))


@pytest.fixture(scope="session")
def rlhf(features, pool):
    """(Encoder, AlignmentReport) of RLHF."""
    return learn_reward(features, pool.triplets, pool.expert_ids, SMALL, np.random.default_rng(2))
