"""RLHF: the loss written out, its zero, and what it learns on synthetic videos."""

from math import exp, log

import numpy as np
import pytest
import torch

from rapl_core.representations.alignment import Lesson
from rapl_core.representations.presets import get_preset
from rapl_core.representations.report import wilson_interval
from rapl_core.representations.rlhf import RlhfObjective, fit_rlhf
from rapl_core.representations.training import Batch
from rapl_core.types import Triplet


def test_the_loss_is_bradley_terry_over_all_three_pairs():
    videos = torch.randn(3, 4, 6, 1, generator=torch.Generator().manual_seed(0))
    batch = Batch(videos, videos[:0, 0], videos[:, :0], videos[:2, 0, :0])
    returns = videos.double().sum((2, 3)).numpy()
    expected = np.mean(
        [sum(log(1 + exp(-(x - y))) for x, y in ((a, b), (b, c), (a, c))) for a, b, c in returns.T]
    )
    assert float(RlhfObjective().loss(batch)) == pytest.approx(expected, 1e-5)


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_a_known_linear_reward_is_recovered(preset):
    rng = np.random.default_rng(0)
    weight, mixing = rng.normal(size=6), rng.normal(size=(6, 6))
    features = {f"v{n:02}": rng.normal(size=(20, 6)) + rng.normal(size=6) for n in range(60)}
    features = {name: (v @ mixing).astype(np.float32) for name, v in features.items()}
    truth = np.linalg.solve(mixing, weight)
    returns = {name: float((video @ truth).sum()) for name, video in features.items()}
    asked = [rng.choice(sorted(features), 3, replace=False) for _ in range(150)]
    triplets = [Triplet(*sorted(three, key=returns.__getitem__, reverse=True)) for three in asked]
    experts = sorted(returns, key=returns.__getitem__)[-5:]
    fit = fit_rlhf(features, Lesson(triplets, experts), get_preset(preset), rng)
    frames = rng.normal(size=(500, 6)).astype(np.float32) @ mixing.astype(np.float32)
    assert np.corrcoef(fit.embed(frames)[:, 0], frames @ truth)[0, 1] > 0.95


def test_learnt_rewards_order_unseen_videos_better_than_chance(rlhf, unseen):
    encoder, _ = rlhf
    totals = {n: encoder.reward(encoder.embed(v), ()).total for n, v in unseen.videos.items()}
    right = float(np.mean([totals[t.best] > totals[t.worst] for t in unseen.triplets]))
    assert wilson_interval(right, len(unseen.triplets))[0] > 0.65


def test_the_embedding_is_the_reward_and_zero_at_the_experts(rlhf, pool):
    encoder, report = rlhf
    assert report.method == encoder.info.name == "rlhf"
    assert encoder.info.dimension == 1 and encoder.reward_kind == "scalar"
    z = encoder.embed(pool.videos[pool.names[9]])
    trace = encoder.reward(z, ())
    np.testing.assert_allclose(trace.values, z[:, 0] * encoder.info.reward_scale, rtol=1e-6)
    assert trace.expert_id == "" and trace.converged
    at_experts = np.concatenate([encoder.embed(pool.videos[n]) for n in encoder.expert_ids])
    spread = np.std([encoder.embed(v).mean() for v in pool.videos.values()])
    assert abs(at_experts.mean()) < 0.02 * spread
