"""Which videos to ask about next."""

from collections.abc import Iterable, Sequence
from math import comb
from typing import Protocol

import numpy as np

from rapl_core.errors import RankingError


class QuerySelector(Protocol):
    """Chooses the videos of the next query; never sees a return."""

    name: str
    """The strategy in a query's record."""

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[tuple[str, ...]] = ()
    ) -> tuple[str, ...]:
        """Return the videos to show, left to right.

        :param episode_ids: the videos there are.
        :param asked: the videos of each query before, not to be asked again.
        :raises RankingError: if there are too few videos, or all combinations were asked.
        """
        ...


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
        self, episode_ids: Sequence[str], asked: Iterable[tuple[str, ...]] = ()
    ) -> tuple[str, ...]:
        """Return ``size`` different videos that were not asked about together before."""
        videos = sorted(set(episode_ids))
        if len(videos) < self.size:
            raise RankingError(f"no query: {len(videos)} of {self.size} episodes recorded")
        known = set(videos)
        past = {frozenset(query) for query in asked if len(query) == self.size}
        past = {query for query in past if query <= known}
        if len(past) >= comb(len(videos), self.size):
            raise RankingError(
                f"no query: all {len(past)} combinations of {len(videos)} episodes were asked"
            )
        while True:
            chosen = self._rng.choice(len(videos), size=self.size, replace=False)
            query = tuple(videos[int(i)] for i in chosen)
            if frozenset(query) not in past:
                return query
