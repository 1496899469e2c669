r"""How often answers are wrong, estimated for each annotator from all answers together.

Model: a comparison is answered by Bradley-Terry on a utility, and then flipped with probability
epsilon of its annotator (Christiano et al. 2017 assume 10 % random answers; Chen et al. 2013,
Crowd-BT, estimate one rate for each annotator). Margins are cross-fitted: no answer is judged by a
utility that it helped to learn. So an annotator who disagrees with what everybody's other answers
predict gets a high rate, and weighs less in learning; videos need not overlap for it."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.preferences.utility import Comparisons, comparisons, fit_utility
from rapl_core.preferences.video_features import VideoFeatures
from rapl_core.types import Ranking

FOLDS = 5
FEWEST_PAIRS = 30
"""With fewer comparisons nothing is estimated: the prior's mean holds."""
PRIOR_RATE, PRIOR_PAIRS = 0.05, 20.0
"""The prior says as much as so many comparisons with so many mistakes."""
_RATES = np.linspace(0.0, 0.5, 51)
_SCALES = np.geomspace(0.25, 16.0, 25)


@dataclass(frozen=True)
class MistakeEstimate:
    """Share of comparisons that are answered wrong."""

    rate: float
    """Over all annotators, in [0, 0.5]."""
    by_annotator: dict[str, float]
    pairs: dict[str, int]
    """Comparisons behind each."""
    accuracy: float
    """Share of comparisons that the cross-fitted utility orders as they were answered; NaN when
    there were too few to estimate."""

    def of(self, annotator: str) -> float:
        """Rate of an annotator; of one never seen, the overall rate."""
        return self.by_annotator.get(annotator, self.rate)


def estimate_mistakes(
    features: VideoFeatures, rankings: Sequence[Ranking], rng: np.random.Generator
) -> MistakeEstimate:
    """Estimate how often each annotator is wrong.

    :param rankings: those that count, of one group of people with one wish.
    :param rng: the folds follow from it.
    """
    pairs = comparisons(features, rankings)
    counts = dict(Counter(pairs.annotators))
    strict = pairs.wins == 1.0
    if int(strict.sum()) < FEWEST_PAIRS:
        return MistakeEstimate(PRIOR_RATE, dict.fromkeys(counts, PRIOR_RATE), counts, math.nan)
    margins = cross_fitted_margins(pairs, rng)[strict]  # (m,)
    people = np.array([name for name, keep in zip(pairs.annotators, strict, strict=True) if keep])
    # Flips and a soft utility look alike where margins are small; where they are large only flips
    # remain. One scale for all, one rate for each.
    best, scale = -math.inf, 1.0
    for candidate in _SCALES:
        value = sum(
            _log_likelihood(candidate * margins[people == name]).max() for name in set(people)
        )
        if value > best:
            best, scale = float(value), float(candidate)
    rates = {
        name: float(_RATES[np.argmax(_log_likelihood(scale * margins[people == name]))])
        if name in people
        else PRIOR_RATE
        for name in counts
    }
    overall = sum(rates[name] * count for name, count in counts.items()) / sum(counts.values())
    accuracy = float(np.mean((margins > 0) + 0.5 * (margins == 0)))
    return MistakeEstimate(overall, rates, counts, accuracy)


def cross_fitted_margins(pairs: Comparisons, rng: np.random.Generator) -> NDArray[np.float64]:
    """(m,) margin of each comparison by a utility learnt from the other rankings."""
    dimension = pairs.differences.shape[1]
    numbers = np.unique(pairs.rankings)
    fold_of = dict(zip(numbers.tolist(), rng.permutation(len(numbers)) % FOLDS, strict=True))
    folds = np.array([fold_of[int(number)] for number in pairs.rankings])
    margins = np.zeros(len(pairs))
    for fold in range(FOLDS):
        held = folds == fold
        if held.any():
            utility = fit_utility(pairs.where(~held), dimension)
            margins[held] = utility.margins(pairs.where(held))
    return margins


def _log_likelihood(margins: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each rate (R,), prior included."""
    p = 1 / (1 + np.exp(-margins))  # (m,)
    e = _RATES[:, None]
    likelihood = np.log(np.maximum((1 - e) * p + e * (1 - p), 1e-12)).sum(axis=1)  # (R,)
    e = np.clip(_RATES, 1e-4, None)
    prior = PRIOR_PAIRS * (PRIOR_RATE * np.log(e) + (1 - PRIOR_RATE) * np.log(1 - e))
    return np.asarray(likelihood + prior)
