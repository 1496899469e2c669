"""The rule of the reward's scale."""

import numpy as np
import pytest

from rapl_core.representations.encoder import matched_part
from rapl_core.representations.reward_scale import TARGET, fit_reward_scale
from rapl_core.types import EmbeddedEpisode, RewardTrace


def trace_of(z: np.ndarray) -> RewardTrace:
    return RewardTrace(z[:, 0].astype(float), "", 0.0, True, 0, 0.0, 1.0)


def test_the_worse_half_earns_two_below_zero_a_step():
    embeddings = {f"v{i}": np.full((4, 1), -float(i + 1), np.float32) for i in range(6)}
    scale = fit_reward_scale(embeddings, trace_of, np.random.default_rng(0))
    assert scale * -np.mean([4, 5, 6]) == pytest.approx(TARGET)


def test_rewards_that_are_not_negative_are_left_alone():
    embeddings = {"a": np.ones((4, 1), np.float32)}
    assert fit_reward_scale(embeddings, trace_of, np.random.default_rng(0)) == 1.0


def test_an_alignment_stores_it(rapl, features, pool):
    encoder, report = rapl
    z = {name: encoder.embed_features(features[name]) for name in pool.names}
    start = encoder.card.expert_from
    experts = [EmbeddedEpisode(n, matched_part(z[n], start)) for n in encoder.expert_ids]
    means = np.sort([encoder.reward(v, experts).values.mean() for v in z.values()])
    assert means[: len(means) // 2].mean() == pytest.approx(TARGET, rel=0.05)
    assert report.reward_scale == encoder.info.reward_scale
