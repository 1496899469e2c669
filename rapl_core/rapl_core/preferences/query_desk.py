"""Who is asked what: new videos, the same ones again, or those that somebody else has ranked."""

import time
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import cast, get_args

import numpy as np

from rapl_core.errors import RankingError, ShapeError, UnknownNameError
from rapl_core.preferences.ledger import Ledger
from rapl_core.preferences.queries import QuerySelector, UniformQueries
from rapl_core.preferences.query import Query, QueryPurpose
from rapl_core.preferences.store import Choice, RankingStore

LARGEST_QUERY = 10
REPEAT_AFTER = 5
"""Answers of the same person between a query and its repetition, where there are so many."""


@dataclass(frozen=True)
class DeskConfig:
    """How queries are handed out."""

    query_size: int = field(default=3, metadata={"minimum": 2, "maximum": LARGEST_QUERY})
    """Videos in a query."""
    lease_s: float = field(default=600.0, metadata={"minimum": 1.0, "maximum": 86400.0})
    """Wall time for which nobody else is asked the same as a query that is not yet answered."""
    seed: int = field(default=0, metadata={"minimum": 0})
    """The order of queries follows from it."""
    repeat_share: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of queries that ask a person what the same person has answered before: consistency."""
    shared_share: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of queries that ask a person what another one has answered: agreement."""

    def __post_init__(self) -> None:
        if self.repeat_share + self.shared_share > 1:
            raise ShapeError(
                f"repeat_share {self.repeat_share:g} and shared_share {self.shared_share:g} "
                "are together more than 1"
            )


@dataclass(frozen=True)
class QueryRequest:
    """What an annotator asks for."""

    annotator: str
    size: int = 0
    """Videos; 0: as configured."""
    purpose: str = ""
    """One of QueryPurpose; empty: by the configured shares."""
    resume: bool = False
    """Give back first what this annotator has open."""
    held: Collection[str] = ()
    """Queries that the caller has already."""

    def __post_init__(self) -> None:
        if self.size and not 2 <= self.size <= LARGEST_QUERY:
            raise RankingError(f"a query of {self.size} videos, expected 2 to {LARGEST_QUERY}")
        if self.purpose and self.purpose not in get_args(QueryPurpose):
            raise UnknownNameError("purpose of a query", self.purpose, get_args(QueryPurpose))


class QueryDesk:
    """Hands out queries so that no two people get the same one unless that is meant."""

    def __init__(self, store: RankingStore, config: DeskConfig) -> None:
        self.config = config
        self._store = store

    def next(
        self,
        request: QueryRequest,
        pool: Collection[str],
        selector: QuerySelector | None = None,
        about: Collection[str] | None = None,
    ) -> Query:
        """Lease the next query of an annotator.

        :param pool: the videos there are.
        :param selector: chooses new videos; None: uniformly.
        :param about: give back only what shows one of these; None: whatever is open.
        :raises RankingError: if there is nothing to ask.
        """

        def choose(ledger: Ledger) -> Choice | Query:
            return self._open(ledger, request, pool, about) or self._choose(
                ledger, request, pool, selector
            )

        return self._store.lease_next(choose, request.annotator, self.config.lease_s)

    def _open(
        self,
        ledger: Ledger,
        request: QueryRequest,
        pool: Collection[str],
        about: Collection[str] | None,
    ) -> Query | None:
        """What the annotator has begun and is to go on with."""
        if not request.resume:
            return None
        there = set(pool)
        for query in ledger.open_queries(time.time_ns(), request.annotator):
            if query.query_id in request.held or not there.issuperset(query.episode_ids):
                continue
            if about is None or not set(about).isdisjoint(query.episode_ids):
                return query
        return None

    def _choose(
        self,
        ledger: Ledger,
        request: QueryRequest,
        pool: Collection[str],
        selector: QuerySelector | None,
    ) -> Choice:
        now = time.time_ns()
        # The number of queries before is part of the seed: a restart goes on, not back.
        rng = np.random.default_rng([self.config.seed, ledger.queries])
        purpose = cast(QueryPurpose, request.purpose or self._purpose(rng))
        if purpose != "new":
            old = self._old_videos(ledger, request, purpose == "repeat", set(pool), rng)
            if old is not None:
                shuffled = tuple(old[int(i)] for i in rng.permutation(len(old)))
                return Choice(shuffled, purpose, purpose)
            if request.purpose:
                raise RankingError(f"no query: nothing to ask {request.annotator!r} as {purpose}")
        size = request.size or self.config.query_size
        chooser = UniformQueries(rng, size) if selector is None else selector
        return Choice(chooser.next(sorted(pool), ledger.asked(now)), chooser.name)

    def _purpose(self, rng: np.random.Generator) -> QueryPurpose:
        draw = float(rng.random())
        if draw < self.config.repeat_share:
            return "repeat"
        return "shared" if draw < self.config.repeat_share + self.config.shared_share else "new"

    def _old_videos(
        self,
        ledger: Ledger,
        request: QueryRequest,
        is_own: bool,
        pool: set[str],
        rng: np.random.Generator,
    ) -> tuple[str, ...] | None:
        """Videos that were ranked together before, and that this person does not have now."""
        own = Counter(frozenset(r.episode_ids) for r in ledger.effective(request.annotator))
        busy = {
            frozenset(q.episode_ids) for q in ledger.open_queries(time.time_ns(), request.annotator)
        }
        if is_own:
            ranked = [r for r in ledger.effective(request.annotator) if r.ranks]
            late = ranked[: max(1, len(ranked) - REPEAT_AFTER)]
            asked_once = [r for r in late if own[frozenset(r.episode_ids)] == 1]
            sets = _sets(r.episode_ids for r in asked_once)
        else:
            others = (r for r in ledger.effective() if r.annotator != request.annotator and r.ranks)
            sets = _sets(r.episode_ids for r in others)
            sets = {key: videos for key, videos in sets.items() if key not in own}
        free = [videos for key, videos in sets.items() if key not in busy and key <= pool]
        if request.size:
            free = [videos for videos in free if len(videos) == request.size]
        return free[int(rng.integers(len(free)))] if free else None


def _sets(queries: Iterable[tuple[str, ...]]) -> dict[frozenset[str], tuple[str, ...]]:
    return {frozenset(videos): videos for videos in queries}
