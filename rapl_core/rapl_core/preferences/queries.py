"""Which videos to ask about next: the seam, and the paper's own way."""

from collections.abc import Iterable, Sequence, Set
from math import comb
from typing import Protocol

import numpy as np

from rapl_core.errors import RankingError

_TRIES = 50
"""Draws before the combinations that are left are counted."""


class QuerySelector(Protocol):
    """Chooses the videos of the next query; never sees a return."""

    name: str
    """The strategy in a query's record."""

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """Return the videos to show, left to right; in microseconds to milliseconds.

        :param episode_ids: the videos there are.
        :param asked: the videos of each query before, not to be asked again.
        :raises RankingError: if there are too few videos, or all combinations were asked.
        """
        ...


def sets_of(asked: Iterable[Iterable[str]]) -> Set[frozenset[str]]:
    """The queries before, to look one up; free for a set of frozensets."""
    if isinstance(asked, Set):
        return asked
    return {frozenset(query) for query in asked}


class UniformQueries:
    """Every combination of ``size`` videos equally likely, in a random order.

    :param rng: the order of queries follows from it.
    :param size: videos in a query.
    """

    name = "uniform"

    def __init__(self, rng: np.random.Generator, size: int = 3) -> None:
        if size < 2:
            raise RankingError(f"a query needs two or more videos, got {size}")
        self.size = size
        self._rng = rng

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """Return ``size`` different videos that were not asked about together before."""
        videos = sorted(set(episode_ids))
        if len(videos) < self.size:
            raise RankingError(f"no query: {len(videos)} of {self.size} episodes recorded")
        past = sets_of(asked)
        tries = 0
        while True:
            chosen = self._rng.choice(len(videos), size=self.size, replace=False)
            query = tuple(videos[int(i)] for i in chosen)
            if frozenset(query) not in past:
                return query
            tries += 1
            if tries == _TRIES:
                self._check_some_are_left(videos, past)

    def _check_some_are_left(self, videos: Sequence[str], past: Set[frozenset[str]]) -> None:
        known = set(videos)
        done = sum(len(query) == self.size and query <= known for query in past)
        if done >= comb(len(videos), self.size):
            raise RankingError(
                f"no query: all {done} combinations of {len(videos)} episodes were asked"
            )
