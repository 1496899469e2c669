r"""What models expect people to answer: probabilities of every order of the videos of a query."""

from collections.abc import Iterable
from itertools import permutations
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError
from rapl_core.preferences.utility import LinearUtility
from rapl_core.preferences.video_features import VideoFeatures

LARGEST_ORDER = 4
"""Videos of which all orders are listed (24); larger queries are judged by their first four."""


class AnswerModel(Protocol):
    """An ensemble that predicts answers."""

    def orders(self, candidates: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the probability of each order under each member.

        :param candidates: (C, s) rows of videos, s at most LARGEST_ORDER.
        :return: (K, C, s!) in the order of :func:`orders_of`; the last axis sums to 1.
        """
        ...


def orders_of(size: int) -> NDArray[np.int64]:
    """(s!, s) every order: positions in the query, the best first."""
    return np.array(list(permutations(range(size))), dtype=np.int64)


class LinearAnswers:
    """Plackett-Luce over draws from the posterior of a linear utility.

    :param members: K.
    """

    def __init__(
        self,
        utility: LinearUtility,
        features: VideoFeatures,
        rng: np.random.Generator,
        members: int = 24,
    ) -> None:
        self._utilities = utility.draws(features.values, members, rng)  # (K, n)

    def orders(self, candidates: NDArray[np.int64]) -> NDArray[np.float64]:
        """See :class:`AnswerModel`."""
        shown = self._utilities[:, candidates]  # (K, C, s)
        return np.stack(
            [plackett_luce(shown[:, :, order]) for order in orders_of(shown.shape[2])], axis=-1
        )


def plackett_luce(utilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability that videos come out in the order given: (..., s) -> (...)."""
    rest = np.logaddexp.accumulate(utilities[..., ::-1], axis=-1)[..., ::-1]
    return np.asarray(np.exp((utilities - rest).sum(axis=-1)))


def information(orders: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Information in nats that an answer gives about which member is right (BALD): entropy of the
    mean minus mean entropy (Houlsby et al. 2011; Biyik et al. 2019 for preferences).

    :param orders: (K, C, s!).
    :return: (C,)
    """
    return np.asarray(_entropy(orders.mean(axis=0)) - _entropy(orders).mean(axis=0))


def disagreement(orders: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance over the ensemble of the probability that one video beats another, mean over the
    pairs of a query (Christiano et al. 2017).

    :param orders: (K, C, s!).
    :return: (C,)
    """
    return np.asarray(_beats(orders).var(axis=0).mean(axis=-1))


def _beats(orders: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, C, s!) -> (K, C, pairs) probability that the first of each pair is the better one."""
    size = _size(orders.shape[-1])
    ranks = np.argsort(orders_of(size), axis=1)  # (s!, s) place of each video
    pairs = [(i, j) for i in range(size) for j in range(i + 1, size)]
    return np.stack([orders[..., ranks[:, i] < ranks[:, j]].sum(-1) for i, j in pairs], axis=-1)


def _entropy(p: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(-(p * np.log(np.maximum(p, 1e-300))).sum(axis=-1))


def _size(orders: int) -> int:
    for size in range(2, LARGEST_ORDER + 1):
        if len(orders_of(size)) == orders:
            return size
    raise RankingError(f"{orders} orders are not those of 2 to {LARGEST_ORDER} videos")


def triplet_orders(
    nearness: Iterable[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Normalise log-likelihoods of the six orders of a triplet: 6 x (K, C) -> (K, C, 6)."""
    logits = np.stack(list(nearness), axis=-1)
    logits = logits - logits.max(axis=-1, keepdims=True)
    p = np.exp(logits)
    return np.asarray(p / p.sum(axis=-1, keepdims=True))
