"""The expert set D+: the most preferred videos, by the rankings alone."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ConvergenceError, RankingError
from rapl_core.preferences.triplets import pairs_from
from rapl_core.types import Ranking

_NEWTON_STEPS = 50
_TOLERANCE = 1e-10
_ROUNDING = 1e-13


def strengths(
    rankings: Iterable[Ranking],
    prior_deviation: float = 1.0,
    trust: Mapping[str, float] | None = None,
) -> dict[str, float]:
    r"""Return the Bradley-Terry strength of every ranked video.

    Maximises the posterior of the log-strengths s,

    .. math:: \sum_{i \succ j} \log\sigma(s_i - s_j) - \sum_i s_i^2 / (2\,\tau^2),

    over all pairs of all rankings; a tie counts as half a win for each. The Gaussian prior of
    deviation tau makes the optimum unique and finite: without it a video seen once and
    preferred would be infinitely strong; with it, it is about as strong as one seen three times
    and preferred twice, and the strength of those that it beat counts.

    :param prior_deviation: tau; small: shrink videos seen seldom more strongly.
    :param trust: how much an answer of each annotator counts; None: all count 1.
    :return: log-strength by episode id, of mean zero.
    :raises RankingError: if tau is not positive.
    :raises ConvergenceError: if Newton's method fails (it does not on finite input).
    """
    if not prior_deviation > 0:
        raise RankingError(f"the prior's deviation is {prior_deviation}, expected more than 0")
    pairs = [
        (pair, 1.0 if trust is None else trust[ranking.annotator])
        for ranking in rankings
        for pair in pairs_from([ranking])
    ]
    videos = sorted({video for pair, _ in pairs for video in (pair.better, pair.worse)})
    if not videos:
        return {}
    number = {video: i for i, video in enumerate(videos)}
    wins = np.zeros((len(videos), len(videos)))  # (n, n) wins[i, j]: how often i beat j
    for pair, counts in pairs:
        better, worse = number[pair.better], number[pair.worse]
        wins[better, worse] += counts * (0.5 if pair.tie else 1.0)
        wins[worse, better] += counts * (0.5 if pair.tie else 0.0)
    return dict(zip(videos, _maximise(wins, 1 / prior_deviation**2).tolist(), strict=True))


def expert_set(
    rankings: Iterable[Ranking], size: int = 10, trust: Mapping[str, float] | None = None
) -> list[str]:
    """Return the ``size`` most preferred videos, the best first.

    Uses the rankings alone, never a return. Equal strengths go to the video seen more often,
    then by name, so that the choice is the same everywhere.

    :param trust: how much an answer of each annotator counts; None: all count 1.
    :raises RankingError: if fewer videos were ranked.
    """
    rankings = list(rankings)
    strength = strengths(rankings, trust=trust)
    if size < 1 or len(strength) < size:
        raise RankingError(
            f"an expert set of {size} videos cannot be chosen from {len(strength)} ranked ones"
        )
    seen = dict.fromkeys(strength, 0)
    for ranking in rankings:
        for video in ranking.episode_ids if ranking.ranks else ():
            seen[video] += 1
    order = sorted(strength, key=lambda video: (-round(strength[video], 9), -seen[video], video))
    return order[:size]


def _maximise(wins: NDArray[np.float64], precision: float) -> NDArray[np.float64]:
    """Newton's method with halving; the objective is strictly concave.

    :param wins: (n, n).
    :return: (n,) log-strengths.
    """
    games = wins + wins.T  # (n, n)
    s = np.zeros(len(wins))
    value = _log_posterior(s, wins, precision)
    for _ in range(_NEWTON_STEPS):
        p = 1 / (1 + np.exp(s[None, :] - s[:, None]))  # (n, n) p[i, j]: i beats j
        gradient = (wins - games * p).sum(axis=1) - precision * s
        if np.abs(gradient).max() < _TOLERANCE * max(1.0, games.sum()):
            return np.asarray(s - s.mean(), dtype=np.float64)
        weight = games * p * p.T
        curvature = np.diag(weight.sum(axis=1) + precision) - weight
        step = np.linalg.solve(curvature, gradient)
        length = 1.0
        while length > 1e-8:
            candidate = s + length * step
            reached = _log_posterior(candidate, wins, precision)
            if reached >= value - _ROUNDING * (1 + abs(value)):
                break
            length /= 2
        s, value = candidate, reached
    raise ConvergenceError(f"Bradley-Terry strengths did not settle in {_NEWTON_STEPS} steps")


def _log_posterior(s: NDArray[np.float64], wins: NDArray[np.float64], precision: float) -> float:
    log_p = -np.logaddexp(0, s[None, :] - s[:, None])  # (n, n)
    return float((wins * log_p).sum() - precision / 2 * (s**2).sum())
