"""The supervised probe recovers a reward that is linear in the features."""

import numpy as np
import pytest
import torch
from squares import SMALL

from rapl_core.errors import RankingError
from rapl_core.representations.presets import PAPER
from rapl_core.representations.probe import fit_probe, supervised_probe


def test_a_linear_reward_is_recovered_through_noise():
    rng = np.random.default_rng(0)
    weight = rng.normal(size=12)
    features = {f"v{i}": rng.normal(size=(30, 12)).astype(np.float32) for i in range(20)}
    truth = {n: x @ weight - 3.0 for n, x in features.items()}
    noisy = {n: y + rng.normal(size=30) * 0.1 for n, y in truth.items()}
    embedder, strength = fit_probe(features, noisy, PAPER, rng)
    with torch.no_grad():
        found = embedder(torch.from_numpy(features["v3"])).numpy()[:, 0]
    assert np.abs(found - truth["v3"]).max() < 0.1 and strength <= 100


def test_features_that_say_nothing_get_the_strongest_ridge():
    rng = np.random.default_rng(1)
    features = {f"v{i}": rng.normal(size=(10, 50)).astype(np.float32) for i in range(10)}
    noise = {n: rng.normal(size=10) for n in features}
    assert fit_probe(features, noise, PAPER, rng)[1] == 1e4


def test_it_is_an_encoder_with_a_scalar_reward(features, pool):
    truth = {n: -np.linspace(i + 1, i, 8) for i, n in enumerate(pool.names) if n in features}
    encoder = supervised_probe(features, truth, pool.expert_ids, SMALL, np.random.default_rng(2))
    assert (encoder.info.name, encoder.reward_kind) == ("supervised_probe", "scalar")
    good, bad = (
        encoder.reward(encoder.embed(pool.videos[pool.names[i]]), []).total for i in (2, 40)
    )
    assert good > bad


def test_without_the_truth_there_is_no_probe(features):
    with pytest.raises(RankingError, match="5 videos with r.*got 0"):
        fit_probe(features, {}, SMALL, np.random.default_rng(0))
