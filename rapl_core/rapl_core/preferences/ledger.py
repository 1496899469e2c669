"""What the rows of a ranking store add up to, kept in memory and brought up to date row by row."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace

from rapl_core.errors import RankingError
from rapl_core.preferences.query import Query
from rapl_core.types import Ranking


class Ledger:
    """Rankings and queries in the order stored, and who has answered what.

    Rows only ever come on top, so that reading the new ones is enough.
    """

    def __init__(self) -> None:
        self.rankings: list[Ranking] = []
        self._by_id: dict[str, Ranking] = {}
        self._replaced_by: dict[str, str] = {}
        self._answers: defaultdict[str, list[Ranking]] = defaultdict(list)
        self._queries: dict[str, Query] = {}
        self._open: dict[str, Query] = {}
        self._by_videos: defaultdict[frozenset[str], list[str]] = defaultdict(list)
        self._sets_asked: set[frozenset[str]] = set()
        self._given: Counter[str] = Counter()

    # Rows

    def add_ranking(self, ranking: Ranking) -> None:
        """Take in the next row of rankings."""
        self.rankings.append(ranking)
        self._by_id[ranking.ranking_id] = ranking
        replaced = self._by_id.get(ranking.replaces)
        if replaced is not None and replaced.ranking_id not in self._replaced_by:
            self._given[replaced.annotator] -= replaced.verdict == "ranked"
        if ranking.replaces:
            self._replaced_by.setdefault(ranking.replaces, ranking.ranking_id)
        self._given[ranking.annotator] += ranking.verdict == "ranked"
        self._sets_asked.add(frozenset(ranking.episode_ids))
        if ranking.query_id:
            self._answers[ranking.query_id].append(ranking)
            self._sort_in(ranking.query_id)

    def add_query(self, query: Query) -> None:
        """Take in the next row of queries."""
        self._queries[query.query_id] = query
        self._by_videos[frozenset(query.episode_ids)].append(query.query_id)
        self._sort_in(query.query_id)

    def add_lease(self, query_id: str, expires_ns: int) -> None:
        """Take in the next row of leases: the query may be answered until then."""
        self._queries[query_id] = replace(self._queries[query_id], expires_ns=expires_ns)
        self._sort_in(query_id)

    # Rankings

    def ranking(self, ranking_id: str) -> Ranking | None:
        """The row of that id."""
        return self._by_id.get(ranking_id)

    def replaced_by(self, ranking_id: str) -> str | None:
        """Id of the row that replaces this one."""
        return self._replaced_by.get(ranking_id)

    def effective(self, annotator: str | None = None) -> Iterator[Ranking]:
        """The rankings that no later one replaces and that take nothing back."""
        for ranking in self.rankings:
            if (
                (annotator is None or ranking.annotator == annotator)
                and ranking.verdict != "withdrawn"
                and ranking.ranking_id not in self._replaced_by
            ):
                yield ranking

    def given(self, annotator: str | None = None) -> int:
        """How many rankings count: ranked, not corrected or taken back."""
        return self._given.total() if annotator is None else self._given[annotator]

    def annotators(self) -> list[str]:
        """Everybody who ever answered, by name."""
        return sorted({ranking.annotator for ranking in self.rankings})

    # Queries

    @property
    def queries(self) -> int:
        """How many were ever handed out."""
        return len(self._queries)

    def queries_handed_out(self) -> Iterable[Query]:
        """All that were ever handed out, in the order stored."""
        return self._queries.values()

    def knows_query(self, query_id: str) -> bool:
        """Whether it was handed out here; an imported ranking's was not."""
        return query_id in self._queries

    def query(self, query_id: str) -> Query:
        """
        :raises RankingError: if there is none of that id.
        """
        if query_id not in self._queries:
            raise RankingError(f"there is no query {query_id!r}")
        return self._queries[query_id]

    def answer_to(self, query_id: str) -> Ranking | None:
        """The answer to a query that counts now, whatever its verdict."""
        for ranking in self._answers.get(query_id, ()):
            if ranking.verdict != "withdrawn" and ranking.ranking_id not in self._replaced_by:
                return ranking
        return None

    def open_queries(self, now_ns: int, annotator: str | None = None) -> list[Query]:
        """Neither answered nor expired, the oldest first."""
        return [
            query
            for query in self._open.values()
            if query.expires_ns > now_ns and (annotator is None or query.annotator == annotator)
        ]

    def asked_again(self, query: Query, now_ns: int) -> Query | None:
        """A later query about the same videos that is open or answered and makes this one void.

        One that was asked on purpose, of another person, does not.
        """
        ids = self._by_videos[frozenset(query.episode_ids)]
        for query_id in ids[ids.index(query.query_id) + 1 :]:
            later = self._queries[query_id]
            is_meant = later.annotator != query.annotator and later.purpose != "new"
            is_open = query_id in self._open and later.expires_ns > now_ns
            if not is_meant and (is_open or self.answer_to(query_id) is not None):
                return later
        return None

    def asked(self, now_ns: int) -> set[frozenset[str]]:
        """The videos of all that was answered, whatever the answer, or is open."""
        return self._sets_asked | {frozenset(q.episode_ids) for q in self.open_queries(now_ns)}

    def _sort_in(self, query_id: str) -> None:
        """Note whether a query waits for an answer; one of another store is not here."""
        if query_id not in self._queries:
            return
        if self.answer_to(query_id) is None:
            self._open[query_id] = self._queries[query_id]
        else:
            self._open.pop(query_id, None)
