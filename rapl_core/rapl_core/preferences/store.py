"""The rankings of a run, in one SQLite file that several processes may write."""

import sqlite3
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from rapl_core.errors import RankingError
from rapl_core.preferences.admission import check_answer, check_correction, check_known
from rapl_core.preferences.ledger import Ledger
from rapl_core.preferences.query import Query, QueryPurpose
from rapl_core.preferences.ranking_json import ranking_to_json
from rapl_core.preferences.shared_file import SharedFile
from rapl_core.types import Ranking

RANKINGS_FILE = "rankings.sqlite"
"""In the run folder."""
UNDO_LEASE_S = 600.0


class Choice(NamedTuple):
    """What to ask somebody."""

    episode_ids: tuple[str, ...]
    """In the order in which to show them."""
    strategy: str
    purpose: QueryPurpose = "new"


class Undone(NamedTuple):
    """What was taken back."""

    ranking: Ranking
    query: Query | None
    """Its query, leased anew; None if it was unasked."""


class RankingStore:
    """Keeps every ranking ever given; corrections are new rows that name the one they replace.

    Safe under several threads, several processes and ``kill -9``: a ranking whose
    :meth:`add` returned is on disk, one whose did not is there entirely or not at all.

    :param path: SQLite file, created if need be; one of an older format is migrated.
    :param known_episode: tells whether an episode exists; rankings of others are refused.
    :raises CorruptFileError: if the file is damaged; it is left as is.
    :raises RankingError: if the folder cannot be written.
    """

    def __init__(self, path: Path | str, known_episode: Callable[[str], bool] | None = None):
        self.path = Path(path)
        self._known_episode = known_episode
        self._file = SharedFile(self.path)

    # Answers

    def add(self, ranking: Ranking) -> int:
        """Store ``ranking`` and return how many rankings there are; sending twice stores once.

        :raises RankingError: if the episodes are unknown, the query is unknown, answered, somebody
            else's, about other videos or expired and asked again, the ranking that it replaces does
            not exist or is replaced already, or another ranking has its id.
        """
        return self._add(ranking, check_query=True)

    def add_imported(self, ranking: Ranking) -> int:
        """Like :meth:`add`, for a ranking whose query another store handed out."""
        return self._add(ranking, check_query=False)

    def _add(self, ranking: Ranking, check_query: bool) -> int:
        def store(rows: sqlite3.Connection, ledger: Ledger) -> int:
            held = ledger.ranking(ranking.ranking_id)
            if held is None:
                what = f"ranking {ranking.ranking_id}"
                check_known(ranking.episode_ids, self._known_episode, what)
                check_correction(ranking, ledger)
                if check_query:
                    check_answer(ranking, ledger, time.time_ns())
                _insert_ranking(rows, ranking)
                return len(ledger.rankings) + 1
            if ranking_to_json(held) != ranking_to_json(ranking):
                raise RankingError(
                    f"ranking {ranking.ranking_id} is already stored with another content; "
                    "a correction needs a new ranking_id and the old one in 'replaces'"
                )
            return len(ledger.rankings)

        return self._file.commit(store)

    def undo(
        self,
        annotator: str,
        withdrawal_id: str,
        ranking_id: str = "",
        lease_s: float = UNDO_LEASE_S,
    ) -> Undone:
        """Take back a ranking by a further row and lease its query again.

        :param withdrawal_id: id of that row; sent twice, it takes back once.
        :param ranking_id: what to take back; empty: the annotator's newest that counts among the
            answers to queries of this store. What was imported or unasked must be named.
        :raises RankingError: if there is none, it is another person's, or was replaced already.
        """
        now = time.time_ns()

        def take_back(rows: sqlite3.Connection, ledger: Ledger) -> Undone:
            earlier = ledger.ranking(withdrawal_id)
            if earlier is not None:
                return _undone_before(ledger, earlier, annotator)
            target = _to_undo(ledger, annotator, ranking_id)
            withdrawal = replace(
                target, ranking_id=withdrawal_id, verdict="withdrawn", ranks=(),
                replaces=target.ranking_id, created_ns=now, shown_ns=0, response_s=float("nan"),
            )  # fmt: skip
            check_correction(withdrawal, ledger)
            _insert_ranking(rows, withdrawal)
            if not ledger.knows_query(target.query_id):
                return Undone(target, None)
            expires_ns = now + round(lease_s * 1e9)
            query = replace(ledger.query(target.query_id), expires_ns=expires_ns)
            _insert_lease(rows, query)
            return Undone(target, query)

        return self._file.commit(take_back)

    def all(
        self, annotator: str | None = None, offset: int = 0, limit: int | None = None
    ) -> list[Ranking]:
        """Return the rankings in the order stored, those that were replaced included.

        :param annotator: only this person's.
        :param offset: how many to pass over.
        :param limit: how many at most.
        """
        with self.reading() as ledger:
            found = (r for r in ledger.rankings if annotator is None or r.annotator == annotator)
            return list(islice(found, offset, None if limit is None else offset + limit))

    def effective(self, annotator: str | None = None) -> list[Ranking]:
        """Return the rankings that count, in the order stored: neither replaced nor taken back."""
        with self.reading() as ledger:
            return list(ledger.effective(annotator))

    def count(self, annotator: str | None = None) -> int:
        """Return how many rankings are stored, those that were replaced included."""
        with self.reading() as ledger:
            if annotator is None:
                return len(ledger.rankings)
            return sum(ranking.annotator == annotator for ranking in ledger.rankings)

    # Queries

    def lease(
        self,
        episode_ids: Sequence[str],
        annotator: str,
        strategy: str,
        duration_s: float,
        purpose: QueryPurpose = "new",
    ) -> Query:
        """Hand out a query about ``episode_ids``; nobody else gets them for ``duration_s``."""
        choice = Choice(tuple(episode_ids), strategy, purpose)
        return self.lease_next(lambda _: choice, annotator, duration_s)

    def lease_next(
        self, choose: Callable[[Ledger], Choice | Query], annotator: str, duration_s: float
    ) -> Query:
        """Hand out what ``choose`` says; nobody else can be given anything meanwhile.

        :param choose: sees the ledger and says what to ask, or which query to lease again. Others
            wait for it, in other processes too: it must be quick.
        """

        def hand_out(rows: sqlite3.Connection, ledger: Ledger) -> Query:
            chosen = choose(ledger)
            now = time.time_ns()
            expires_ns = now + round(duration_s * 1e9)
            if isinstance(chosen, Query):
                query = replace(chosen, expires_ns=expires_ns)
            else:
                query = Query(
                    query_id=uuid.uuid4().hex,
                    episode_ids=chosen.episode_ids,
                    annotator=annotator,
                    strategy=chosen.strategy,
                    created_ns=now,
                    expires_ns=expires_ns,
                    purpose=chosen.purpose,
                )
                check_known(query.episode_ids, self._known_episode, f"query {query.query_id}")
                _insert_query(rows, query)
            _insert_lease(rows, query)
            return query

        # A query that is lost with the power is asked again; its answer is not yet there to lose.
        return self._file.commit(hand_out, durable=False)

    def query(self, query_id: str) -> Query:
        """Return a query that was handed out.

        :raises RankingError: if there is none of that id.
        """
        with self.reading() as ledger:
            return ledger.query(query_id)

    def open_queries(self, annotator: str | None = None) -> list[Query]:
        """Return the queries that are neither answered nor expired, the oldest first."""
        with self.reading() as ledger:
            return ledger.open_queries(time.time_ns(), annotator)

    # The file

    def reading(self) -> AbstractContextManager[Ledger]:
        """Hold the ledger, up to date with what any process has stored; other threads wait."""
        return self._file.reading()

    def close(self) -> None:
        """Close the file; the store is of no use afterwards."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _to_undo(ledger: Ledger, annotator: str, ranking_id: str) -> Ranking:
    if ranking_id:
        found = ledger.ranking(ranking_id)
        if found is None:
            raise RankingError(f"nothing to undo: there is no ranking {ranking_id!r}")
        if found.annotator != annotator:
            raise RankingError(
                f"nothing to undo: ranking {ranking_id} is of {found.annotator!r}, "
                f"not of {annotator!r}"
            )
        if found.verdict == "withdrawn":
            raise RankingError(f"nothing to undo: {ranking_id} is itself an undo")
        return found
    newest = next(
        (
            ranking
            for ranking in reversed(ledger.rankings)
            if ranking.annotator == annotator
            and ranking.verdict != "withdrawn"
            and ledger.replaced_by(ranking.ranking_id) is None
            and ledger.knows_query(ranking.query_id)
        ),
        None,
    )
    if newest is None:
        raise RankingError(
            f"nothing to undo: {annotator!r} has no answer that counts to a query of this store"
        )
    return newest


def _undone_before(ledger: Ledger, withdrawal: Ranking, annotator: str) -> Undone:
    """The answer to an undo that was sent twice."""
    target = ledger.ranking(withdrawal.replaces)
    if withdrawal.verdict != "withdrawn" or withdrawal.annotator != annotator or target is None:
        raise RankingError(
            f"ranking {withdrawal.ranking_id} is already stored with another content; "
            "an undo needs a new withdrawal_id"
        )
    known = ledger.knows_query(target.query_id)
    return Undone(target, ledger.query(target.query_id) if known else None)


def _insert_ranking(rows: sqlite3.Connection, ranking: Ranking) -> None:
    rows.execute(
        "INSERT INTO rankings (ranking_id, annotator, replaces, content) VALUES (?, ?, ?, ?)",
        (ranking.ranking_id, ranking.annotator, ranking.replaces, ranking_to_json(ranking)),
    )


def _insert_query(rows: sqlite3.Connection, query: Query) -> None:
    rows.execute(
        "INSERT INTO queries (query_id, annotator, strategy, purpose, episode_ids, created_ns) "
        "VALUES (?, ?, ?, ?, ?, ?)",
        (
            query.query_id,
            query.annotator,
            query.strategy,
            query.purpose,
            " ".join(query.episode_ids),
            query.created_ns,
        ),
    )


def _insert_lease(rows: sqlite3.Connection, query: Query) -> None:
    rows.execute(
        "INSERT INTO leases (query_id, expires_ns) VALUES (?, ?)",
        (query.query_id, query.expires_ns),
    )
