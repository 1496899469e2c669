"""Likelihoods that doubt answers: their limits, and what they are worth when answers are wrong."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn.functional import logsigmoid

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.representations import get_preset
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.answer_noise import log_likelihood
from rapl_core.representations.rapl import fit_rapl
from rapl_core.types import DoubtedTriplet, Noise

MARGINS = torch.tensor([-30.0, -2.0, 0.0, 1.0, 30.0])


@pytest.mark.parametrize("noise", ["smoothing", "estimated"])
def test_without_mistakes_all_are_the_plain_likelihood(noise: Noise) -> None:
    none = torch.zeros(5)
    expected = logsigmoid(MARGINS)
    assert torch.allclose(log_likelihood(MARGINS, none, noise)[1:], expected[1:], atol=1e-5)
    assert torch.equal(log_likelihood(MARGINS, None, noise), expected)
    assert torch.equal(log_likelihood(MARGINS, torch.full((5,), 0.3), "plain"), expected)


def test_an_estimated_mistake_bounds_the_loss_and_its_gradient() -> None:
    margins = MARGINS.clone().requires_grad_()
    value = log_likelihood(margins, torch.full((5,), 0.1), "estimated")
    assert value.min() >= np.log(0.1) - 1e-6
    value.sum().backward()
    assert margins.grad is not None and abs(float(margins.grad[0])) < 1e-6
    smooth = MARGINS.clone().requires_grad_()
    log_likelihood(smooth, torch.full((5,), 0.1), "smoothing").sum().backward()
    assert smooth.grad is not None and float(smooth.grad[-1]) == pytest.approx(-0.1, abs=1e-5)


def test_a_doubt_beyond_one_half_and_unknown_words_are_refused() -> None:
    with pytest.raises(RankingError, match="mistakes is 0.7"):
        DoubtedTriplet("a", "b", "c", 0.7)
    with pytest.raises(UnknownNameError, match="'hope'; known: estimated, plain, smoothing"):
        replace(get_preset("tuned"), noise="hope")  # type: ignore[arg-type]


def test_doubting_wrong_answers_learns_more_from_them() -> None:
    """A third of the triplets are turned round: which head orders clean triplets better?"""
    shares: dict[str, list[float]] = {"plain": [], "estimated": []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        worth = rng.normal(size=60)
        videos = {
            f"v{i}": np.concatenate(
                [np.full((4, 1), worth[i]), rng.normal(size=(4, 7)) * 0.8 + rng.normal(size=7)],
                axis=1,
            ).astype(np.float32)
            for i in range(60)
        }
        triplets = []
        for number in range(120):
            three = sorted(rng.choice(60, 3, replace=False), key=lambda i: -worth[i])
            if number % 3 == 0:
                three = three[::-1]
            triplets.append(DoubtedTriplet(*(f"v{i}" for i in three), mistakes=0.33))
        experts = [f"v{i}" for i in np.argsort(-worth)[:5]]
        for noise, found in shares.items():
            preset = replace(
                get_preset("tuned"), noise=noise, epochs=15, components=8, frames=4,
                slow_weight=0.0, held_out=0.0, dimension=4, inferred=0.0,
            )  # fmt: skip
            fit = fit_rapl(videos, Lesson(triplets, experts), preset, np.random.default_rng(seed))
            z = {name: fit.embed(video).mean(0) for name, video in videos.items()}
            centre = np.mean([z[name] for name in experts], axis=0)
            near = np.array([-np.linalg.norm(z[f"v{i}"] - centre) for i in range(60)])
            i, j = np.triu_indices(60, 1)
            found.append(float(np.mean((near[i] > near[j]) == (worth[i] > worth[j]))))
    assert np.mean(shares["estimated"]) > np.mean(shares["plain"])
