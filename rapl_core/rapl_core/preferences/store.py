"""The rankings of a run, in one SQLite file that several processes may write."""

import sqlite3
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences.query import Query
from rapl_core.preferences.ranking_json import ranking_from_json, ranking_to_json
from rapl_core.preferences.schema import open_database
from rapl_core.types import Ranking

_EFFECTIVE = (
    "NOT EXISTS (SELECT 1 FROM rankings AS later WHERE later.replaces = rankings.ranking_id)"
)


class RankingStore:
    """Keeps every ranking ever given; corrections are new rows that name the one they replace.

    Safe under several threads, several processes and ``kill -9``: a ranking whose
    :meth:`add` returned is on disk, one whose did not is there entirely or not at all.

    :param path: SQLite file, created if need be.
    :param known_episode: tells whether an episode exists; rankings of others are refused.
    :raises CorruptFileError: if the file is damaged; it is left as is.
    :raises RankingError: if the folder cannot be written.
    """

    def __init__(self, path: Path | str, known_episode: Callable[[str], bool] | None = None):
        self.path = Path(path)
        self._known_episode = known_episode
        self._lock = threading.RLock()
        self._connection = open_database(self.path)

    def add(self, ranking: Ranking) -> int:
        """Store ``ranking`` and return how many rankings there are; sending twice stores once.

        :raises RankingError: if the episodes are unknown, the query is unknown, expired or about
            other videos, the ranking that it replaces does not exist, or another ranking has
            its id.
        """
        return self._add(ranking, check_query=True)

    def add_imported(self, ranking: Ranking) -> int:
        """Like :meth:`add`, for a ranking whose query another store handed out."""
        return self._add(ranking, check_query=False)

    def _add(self, ranking: Ranking, check_query: bool) -> int:
        content = ranking_to_json(ranking)
        with self._transaction() as rows:
            held = rows.execute(
                "SELECT content FROM rankings WHERE ranking_id = ?", (ranking.ranking_id,)
            ).fetchone()
            if held is None:
                self._check_episodes(ranking)
                self._check_replaces(rows, ranking)
                if check_query and ranking.query_id:
                    self._check_answer(rows, ranking)
                rows.execute(
                    "INSERT INTO rankings (ranking_id, annotator, replaces, content) "
                    "VALUES (?, ?, ?, ?)",
                    (ranking.ranking_id, ranking.annotator, ranking.replaces, content),
                )
            elif held[0] != content:
                raise RankingError(
                    f"ranking {ranking.ranking_id} is already stored with another content; "
                    "a correction needs a new ranking_id and the old one in 'replaces'"
                )
            return int(rows.execute("SELECT count(*) FROM rankings").fetchone()[0])

    def all(
        self, annotator: str | None = None, offset: int = 0, limit: int | None = None
    ) -> list[Ranking]:
        """Return the rankings in the order stored, those that were replaced included.

        :param annotator: only this person's.
        :param offset: how many to pass over.
        :param limit: how many at most.
        """
        return self._select("1", annotator, offset, limit)

    def effective(self, annotator: str | None = None) -> list[Ranking]:
        """Return the rankings that no later one replaces, in the order stored."""
        return self._select(_EFFECTIVE, annotator, 0, None)

    def count(self, annotator: str | None = None) -> int:
        """Return how many rankings are stored, those that were replaced included."""
        with self._reading() as rows:
            row = rows.execute(
                "SELECT count(*) FROM rankings WHERE ?1 IS NULL OR annotator = ?1", (annotator,)
            ).fetchone()
        return int(row[0])

    def lease(
        self, episode_ids: Sequence[str], annotator: str, strategy: str, duration_s: float
    ) -> Query:
        """Hand out a query about ``episode_ids`` that must be answered within ``duration_s``."""
        now = time.time_ns()
        query = Query(
            query_id=uuid.uuid4().hex,
            episode_ids=tuple(episode_ids),
            annotator=annotator,
            strategy=strategy,
            created_ns=now,
            expires_ns=now + round(duration_s * 1e9),
        )
        self._check_known(query.episode_ids, f"query {query.query_id}")
        with self._transaction() as rows:
            rows.execute(
                "INSERT INTO queries VALUES (?, ?, ?, ?, ?, ?)",
                (
                    query.query_id,
                    query.annotator,
                    query.strategy,
                    " ".join(query.episode_ids),
                    query.created_ns,
                    query.expires_ns,
                ),
            )
        return query

    def query(self, query_id: str) -> Query:
        """Return a query that was handed out.

        :raises RankingError: if there is none of that id.
        """
        with self._reading() as rows:
            return _query(rows, query_id)

    def open_queries(self, annotator: str | None = None) -> list[Query]:
        """Return the queries that are neither answered nor expired, the oldest first."""
        with self._reading() as rows:
            answered = {
                ranking_from_json(content).query_id
                for (content,) in rows.execute("SELECT content FROM rankings")
            }
            found = rows.execute(
                "SELECT query_id FROM queries WHERE expires_ns > ?1 "
                "AND (?2 IS NULL OR annotator = ?2) ORDER BY created_ns, query_id",
                (time.time_ns(), annotator),
            ).fetchall()
            return [_query(rows, query_id) for (query_id,) in found if query_id not in answered]

    def close(self) -> None:
        """Close the file; the store is of no use afterwards."""
        with self._lock:
            self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _select(
        self, condition: str, annotator: str | None, offset: int, limit: int | None
    ) -> list[Ranking]:
        with self._reading() as rows:
            found = rows.execute(
                f"SELECT content FROM rankings WHERE {condition} "
                "AND (?1 IS NULL OR annotator = ?1) ORDER BY number LIMIT ?2 OFFSET ?3",
                (annotator, -1 if limit is None else limit, offset),
            ).fetchall()
        return [ranking_from_json(content) for (content,) in found]

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Hold the write lock; commit at the end, roll back on an error."""
        with self._reading() as rows:
            rows.execute("BEGIN IMMEDIATE")
            try:
                yield rows
            except BaseException:
                rows.execute("ROLLBACK")
                raise
            rows.execute("COMMIT")

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Hold the connection; what SQLite reports becomes an error that names the file."""
        with self._lock:
            try:
                yield self._connection
            except sqlite3.OperationalError as error:
                raise RankingError(f"the ranking store {self.path} failed: {error}") from error
            except sqlite3.ProgrammingError as error:
                raise RankingError(f"the ranking store {self.path} is closed") from error
            except sqlite3.DatabaseError as error:
                raise CorruptFileError(f"{self.path} is damaged: {error}") from error

    def _check_episodes(self, ranking: Ranking) -> None:
        self._check_known(ranking.episode_ids, f"ranking {ranking.ranking_id}")

    def _check_known(self, episode_ids: Sequence[str], what: str) -> None:
        if self._known_episode is None:
            return
        unknown = [e for e in episode_ids if not self._known_episode(e)]
        if unknown:
            raise RankingError(f"{what} names unknown episodes: {', '.join(unknown)}")

    def _check_replaces(self, rows: sqlite3.Connection, ranking: Ranking) -> None:
        if not ranking.replaces:
            return
        held = rows.execute(
            "SELECT annotator FROM rankings WHERE ranking_id = ?", (ranking.replaces,)
        ).fetchone()
        if held is None:
            raise RankingError(
                f"ranking {ranking.ranking_id} replaces {ranking.replaces}, which is not stored"
            )
        if held[0] != ranking.annotator:
            raise RankingError(
                f"ranking {ranking.ranking_id} of {ranking.annotator!r} replaces "
                f"{ranking.replaces}, which is {held[0]!r}'s"
            )

    def _check_answer(self, rows: sqlite3.Connection, ranking: Ranking) -> None:
        query = _query(rows, ranking.query_id)
        if set(query.episode_ids) != set(ranking.episode_ids):
            raise RankingError(
                f"ranking {ranking.ranking_id} is about {', '.join(ranking.episode_ids)}, "
                f"its query {query.query_id} about {', '.join(query.episode_ids)}"
            )
        late_s = (time.time_ns() - query.expires_ns) / 1e9
        if late_s > 0:
            raise RankingError(f"query {query.query_id} expired {late_s:.0f} s ago")


def _query(rows: sqlite3.Connection, query_id: str) -> Query:
    row = rows.execute(
        "SELECT query_id, episode_ids, annotator, strategy, created_ns, expires_ns "
        "FROM queries WHERE query_id = ?",
        (query_id,),
    ).fetchone()
    if row is None:
        raise RankingError(f"there is no query {query_id!r}")
    return Query(row[0], tuple(row[1].split(" ")), *row[2:])
