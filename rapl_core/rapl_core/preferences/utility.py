r"""A linear utility of videos, learnt from comparisons: quick, for choosing queries and for telling
people apart. What the robot is rewarded with is never made of it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ConvergenceError, RankingError
from rapl_core.preferences.triplets import pairs_from
from rapl_core.preferences.video_features import VideoFeatures
from rapl_core.types import Ranking

PRIOR_DEVIATION = 1.0
_NEWTON_STEPS = 60
_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Comparisons:
    """Pairs of videos as differences of their features."""

    differences: NDArray[np.float64]
    """(m, d) of the better video minus the worse one."""
    wins: NDArray[np.float64]
    """(m,) 1; 1/2 for a tie."""
    annotators: tuple[str, ...]
    """(m,)"""
    rankings: NDArray[np.int64]
    """(m,) number of the ranking that each comes from."""

    def __len__(self) -> int:
        return len(self.wins)

    def where(self, chosen: NDArray[np.bool_]) -> "Comparisons":
        """Those marked in ``chosen`` (m,)."""
        return Comparisons(
            self.differences[chosen],
            self.wins[chosen],
            tuple(name for name, keep in zip(self.annotators, chosen, strict=True) if keep),
            self.rankings[chosen],
        )


def comparisons(features: VideoFeatures, rankings: Iterable[Ranking]) -> Comparisons:
    """Return every pair of every ranking whose videos have features."""
    rows_better, rows_worse, wins, annotators, numbers = [], [], [], [], []
    for number, ranking in enumerate(rankings):
        for pair in pairs_from([ranking]):
            if pair.better in features and pair.worse in features:
                rows_better.append(pair.better)
                rows_worse.append(pair.worse)
                wins.append(0.5 if pair.tie else 1.0)
                annotators.append(ranking.annotator)
                numbers.append(number)
    x = features.values
    return Comparisons(
        x[features.rows(rows_better)] - x[features.rows(rows_worse)],
        np.array(wins),
        tuple(annotators),
        np.array(numbers, dtype=np.int64),
    )


@dataclass(frozen=True)
class LinearUtility:
    """Weights of features and how sure they are."""

    weights: NDArray[np.float64]
    """(d,)"""
    covariance: NDArray[np.float64]
    """(d, d) of the Laplace approximation."""

    def margins(self, pairs: Comparisons) -> NDArray[np.float64]:
        """(m,) log-odds that the better video of each pair is the better one."""
        return pairs.differences @ self.weights

    def draws(
        self, features: NDArray[np.float64], count: int, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """(K, n) utilities of videos (n, d) under draws from the posterior: an ensemble."""
        root = np.linalg.cholesky(self.covariance + 1e-10 * np.eye(len(self.weights)))
        noise = rng.standard_normal((count, len(self.weights)))
        weights = self.weights + noise @ root.T  # (K, d)
        return np.asarray(weights @ features.T)


def fit_utility(
    pairs: Comparisons,
    dimension: int,
    sample_weights: NDArray[np.float64] | None = None,
    prior_deviation: float = PRIOR_DEVIATION,
) -> LinearUtility:
    r"""Maximise :math:`\sum_i c_i [y_i \log\sigma(w^T x_i) + (1 - y_i) \log\sigma(-w^T x_i)]
    - |w|^2 / 2 \tau^2` by Newton's method; Bradley-Terry with a Gaussian prior.

    :param dimension: d; without pairs the prior is returned.
    :param sample_weights: (m,) c; None: ones.
    :raises RankingError: if the prior's deviation is not positive.
    :raises ConvergenceError: if Newton's method does not settle.
    """
    if not prior_deviation > 0:
        raise RankingError(f"the prior's deviation is {prior_deviation}, expected more than 0")
    precision = np.eye(dimension) / prior_deviation**2
    x, y = pairs.differences.reshape(-1, dimension), pairs.wins
    c = np.ones(len(y)) if sample_weights is None else sample_weights
    w = np.zeros(dimension)
    value = _log_posterior(w, x, y, c, precision)
    for _ in range(_NEWTON_STEPS):
        p = 1 / (1 + np.exp(-x @ w))  # (m,)
        gradient = x.T @ (c * (y - p)) - precision @ w
        curvature = (x * (c * p * (1 - p))[:, None]).T @ x + precision  # (d, d)
        if np.abs(gradient).max() < _TOLERANCE * max(1.0, float(c.sum())):
            return LinearUtility(w, np.asarray(np.linalg.inv(curvature), dtype=np.float64))
        step = np.linalg.solve(curvature, gradient)
        length = 1.0
        while length > 1e-10:
            candidate = w + length * step
            reached = _log_posterior(candidate, x, y, c, precision)
            if reached >= value - 1e-12 * (1 + abs(value)):
                break
            length /= 2
        w, value = candidate, reached
    raise ConvergenceError(f"the utility of {len(y)} pairs did not settle in {_NEWTON_STEPS} steps")


def _log_posterior(
    w: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    c: NDArray[np.float64],
    precision: NDArray[np.float64],
) -> float:
    m = x @ w
    log_right, log_wrong = -np.logaddexp(0, -m), -np.logaddexp(0, m)
    return float((c * (y * log_right + (1 - y) * log_wrong)).sum() - 0.5 * w @ precision @ w)
