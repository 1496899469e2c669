"""A human whose preferences are known: ranks videos by the human's true returns."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rapl_core.errors import RankingError
from rapl_core.types import Verdict


class Answer(NamedTuple):
    """What a human says about the videos of a query."""

    verdict: Verdict
    ranks: tuple[int, ...]
    """1 = best, equal numbers tie; empty unless ranked."""


class SimulatedHuman:
    """Ranks by the sum of r*; without the options never errs, like the paper's.

    :param rng: the errors follow from it.
    :param beta: rationality: the order is drawn from Plackett-Luce with utility beta * return;
        infinite: always the true order. In units of 1 / return.
    :param mistakes: probability that a ranking has two neighbours exchanged.
    :param equal_threshold: a video whose return is at most this far below the best of a group
        of equals ties with that group.
    :param skip: probability that no answer is given.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        beta: float = float("inf"),
        mistakes: float = 0.0,
        equal_threshold: float = 0.0,
        skip: float = 0.0,
    ) -> None:
        for name, value in (("mistakes", mistakes), ("skip", skip)):
            if not 0 <= value <= 1:
                raise RankingError(f"{name} is {value}, expected a probability in [0, 1]")
        if not beta > 0:
            raise RankingError(f"beta is {beta}, expected more than 0")
        if not equal_threshold >= 0:
            raise RankingError(f"equal_threshold is {equal_threshold}, expected 0 or more")
        self._rng = rng
        self._beta = beta
        self._mistakes = mistakes
        self._equal_threshold = equal_threshold
        self._skip = skip

    def rank(self, returns: Sequence[float]) -> tuple[int, ...]:
        """Return the rank of each video, 1 = best, equal numbers tie.

        :param returns: the human's return of each video, as shown.
        :raises RankingError: if a return is NaN: the truth is unknown.
        """
        utilities = np.asarray(returns, dtype=np.float64)  # (n,)
        if not np.all(np.isfinite(utilities)):
            raise RankingError(f"cannot rank by the returns {list(returns)}: the truth is unknown")
        if np.isfinite(self._beta):
            # Sorting utilities plus Gumbel noise draws from Plackett-Luce.
            utilities = utilities + self._rng.gumbel(size=len(utilities)) / self._beta
        order = np.argsort(-utilities, kind="stable")
        ranks = np.empty(len(utilities), dtype=np.int64)
        leader, place = utilities[order[0]], 1
        for position, video in enumerate(order, start=1):
            if leader - utilities[video] > self._equal_threshold:
                leader, place = utilities[video], position
            ranks[video] = place
        if self._mistakes > 0 and self._rng.random() < self._mistakes:
            first = int(self._rng.integers(len(order) - 1))
            a, b = order[first], order[first + 1]
            ranks[a], ranks[b] = ranks[b], ranks[a]
        return tuple(int(rank) for rank in ranks)

    def answer(self, returns: Sequence[float]) -> Answer:
        """Return a ranking of the videos; now and then none, if asked to skip."""
        if self._skip > 0 and self._rng.random() < self._skip:
            return Answer("skipped", ())
        return Answer("ranked", self.rank(returns))
