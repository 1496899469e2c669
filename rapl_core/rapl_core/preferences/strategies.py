"""Query selection beyond the uniform: by what a model is unsure of, or by what was never shown."""

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.preferences.answers import (
    LARGEST_ORDER,
    AnswerModel,
    LinearAnswers,
    disagreement,
    information,
)
from rapl_core.preferences.queries import QuerySelector, UniformQueries, sets_of
from rapl_core.preferences.utility import comparisons, fit_utility
from rapl_core.preferences.video_features import VideoFeatures
from rapl_core.types import Ranking

CANDIDATES = 800
"""Queries drawn at random of which the best are asked."""
BATCH = 16
"""Queries chosen at a time, no two with a video in common, so that several people, or one who is
quicker than the model, are not asked nearly the same."""

STRATEGIES = ("uniform", "contest", "uncertainty", "information", "coverage", "transport")
LEARNING = STRATEGIES[2:]
"""Those that look at the videos' features and learn from answers."""


def strategy_of(preset: str) -> str:
    """Return the strategy of those who name none: the paper asks uniformly, ``tuned`` does not."""
    return "contest" if preset == "tuned" else "uniform"


ModelOf = Callable[[Sequence[Ranking]], AnswerModel | None]
"""Learns a model from rankings; None while there are too few."""
Acquisition = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""(K, C, s!) probabilities of orders to (C,) scores: the higher, the sooner asked."""


class LearningSelector(QuerySelector, Protocol):
    """A selector that learns from answers."""

    def update(self, rankings: Sequence[Ranking], asked: Iterable[Iterable[str]] = ()) -> None:
        """Learn from the rankings that count; may take seconds, in a thread of its own."""
        ...


class ModelQueries:
    """Asks what an ensemble is least sure of.

    :param name: of the strategy.
    :param rng: candidates follow from it.
    :param features: the videos that may be asked about.
    :param model_of: learns the ensemble.
    :param acquisition: scores candidates.
    :param size: videos in a query.
    """

    def __init__(
        self,
        name: str,
        rng: np.random.Generator,
        features: VideoFeatures,
        model_of: ModelOf,
        acquisition: Acquisition,
        size: int = 3,
    ) -> None:
        self.name = name
        self._rng = rng
        self._features = features
        self._model_of = model_of
        self._acquisition = acquisition
        self._size = size
        self._uniform = UniformQueries(rng, size)
        self._chosen: tuple[tuple[str, ...], ...] = ()

    def update(self, rankings: Sequence[Ranking], asked: Iterable[Iterable[str]] = ()) -> None:
        """Learn the ensemble anew and choose the next queries; the old ones hold meanwhile."""
        model = self._model_of(rankings)
        if model is None:
            self._chosen = ()
            return
        candidates = self._candidates(asked)  # (C, s)
        scores = self._acquisition(model.orders(candidates[:, :LARGEST_ORDER]))
        names = self._features.episode_ids
        chosen: list[tuple[str, ...]] = []
        used: set[int] = set()
        for row in np.argsort(-scores, kind="stable"):
            videos = [int(i) for i in candidates[row]]
            if used.isdisjoint(videos):
                used.update(videos)
                chosen.append(tuple(names[i] for i in videos))
            if len(chosen) == BATCH:
                break
        self._chosen = tuple(chosen)

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """The best query that nobody was asked; a uniform one when those are used up."""
        past, known = sets_of(asked), set(episode_ids)
        for query in self._chosen:
            if frozenset(query) not in past and known.issuperset(query):
                return query
        return self._uniform.next(episode_ids, past)

    def _candidates(self, asked: Iterable[Iterable[str]]) -> NDArray[np.int64]:
        past = sets_of(asked)
        names = self._features.episode_ids
        if len(names) < self._size:
            raise RankingError(f"no query: {len(names)} of {self._size} episodes recorded")
        drawn = {
            tuple(int(i) for i in self._rng.choice(len(names), self._size, replace=False))
            for _ in range(CANDIDATES)
        }
        fresh = sorted(q for q in drawn if frozenset(names[i] for i in q) not in past)
        if not fresh:
            raise RankingError(f"no query: all combinations of {len(names)} episodes were asked")
        order = self._rng.permutation(len(fresh))
        return np.array(fresh, dtype=np.int64)[order]


class CoverageQueries:
    """Shows what is farthest from everything shown: k-centres (Sener and Savarese 2018), greedy.

    Each video of a query is the one farthest, in the features, from all videos that were asked
    about and from those already in the query.
    """

    name = "coverage"

    def __init__(self, rng: np.random.Generator, features: VideoFeatures, size: int = 3) -> None:
        self._rng = rng
        self._features = features
        self._size = size
        self._uniform = UniformQueries(rng, size)

    def update(self, rankings: Sequence[Ranking], asked: Iterable[Iterable[str]] = ()) -> None:
        """Nothing is learnt from answers."""

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """The next centres, in random order."""
        past = sets_of(asked)
        names = [name for name in sorted(set(episode_ids)) if name in self._features]
        if len(names) < self._size:
            return self._uniform.next(episode_ids, past)
        x = self._features.values[self._features.rows(names)]  # (n, d)
        number = {name: i for i, name in enumerate(names)}
        shown = [number[name] for query in past for name in query if name in number]
        # How often each was shown breaks the tie once every video has been.
        counts = np.bincount(np.array(shown, dtype=np.int64), minlength=len(names))
        round_shown = np.flatnonzero(counts > counts.min())
        nearest = np.full(len(names), np.inf)
        for row in x[round_shown]:
            nearest = np.minimum(nearest, np.linalg.norm(x - row, axis=1))
        nearest[counts > counts.min()] = -1.0
        query: list[int] = []
        while len(query) < self._size:
            i = int(self._rng.integers(len(names))) if np.isinf(nearest).all() else int(
                np.argmax(nearest)
            )  # fmt: skip
            query.append(i)
            nearest = np.minimum(nearest, np.linalg.norm(x - x[i], axis=1))
            nearest[query] = -2.0
        chosen = tuple(names[int(k)] for k in self._rng.permutation(query))
        return chosen if frozenset(chosen) not in past else self._uniform.next(episode_ids, past)


def make_selector(
    strategy: str,
    rng: np.random.Generator,
    features: VideoFeatures,
    transport_model: ModelOf,
    size: int = 3,
) -> LearningSelector:
    """Return the selector of a strategy that learns; ``uniform`` and ``contest`` need no features.

    :param transport_model: learns the ensemble of representations of ``transport``
        (:class:`rapl_core.representations.query_ensemble.TransportEnsemble`).
    :raises UnknownNameError: naming the known strategies.
    :raises RankingError: if ``transport`` is to ask about another number of videos than three.
    """

    def linear(rankings: Sequence[Ranking]) -> AnswerModel:
        utility = fit_utility(comparisons(features, rankings), features.values.shape[1])
        return LinearAnswers(utility, features, rng)

    if strategy == "uncertainty":
        return ModelQueries(strategy, rng, features, linear, disagreement, size)
    if strategy == "information":
        return ModelQueries(strategy, rng, features, linear, information, size)
    if strategy == "coverage":
        return CoverageQueries(rng, features, size)
    if strategy == "transport":
        if size != 3:
            raise RankingError(f"strategy transport asks about three videos, not {size}")
        return ModelQueries(strategy, rng, features, transport_model, information, size)
    raise UnknownNameError("query strategy", strategy, LEARNING)
