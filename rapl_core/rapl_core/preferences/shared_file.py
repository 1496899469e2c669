"""The file behind a ranking store: one connection, its ledger, and writers who share a commit."""

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences.ledger import Ledger
from rapl_core.preferences.query import Query
from rapl_core.preferences.ranking_json import ranking_from_json
from rapl_core.preferences.schema import open_database

LARGEST_COMMIT = 256
"""Writers who share a commit, at most."""

Result = TypeVar("Result")
Work = Callable[[sqlite3.Connection, Ledger], Result]
"""Reads the ledger, writes rows; what it raises leaves nothing of it behind."""


class _Job:
    """A piece of work that waits for a commit."""

    def __init__(self, work: Work[Any], durable: bool) -> None:
        self.work, self.durable = work, durable
        self.done = False
        self.result: Any = None
        self.error: BaseException | None = None


class SharedFile:
    """A SQLite file that several threads and processes write.

    A commit that is durable makes the disk write, which takes milliseconds and on a busy disk tens
    of them. Threads that come meanwhile wait together, and the first of them commits for all.

    :param path: created if need be.
    :raises CorruptFileError: if the file is damaged; it is left as is.
    :raises RankingError: if the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._waiting: list[_Job] = []
        self._connection = open_database(path)
        self._forget()

    def commit(self, work: Work[Result], durable: bool = True) -> Result:
        """Do ``work`` with the write lock held and return its result once it is on disk.

        :param durable: whether it must outlive a loss of power too, not only of this process.
        :raises RankingError: if the file cannot be written, besides what ``work`` raises.
        """
        job = _Job(work, durable)
        self._waiting.append(job)
        with self._lock:
            if not job.done:
                jobs = self._waiting[:LARGEST_COMMIT]
                if job not in jobs:
                    jobs.append(job)
                self._waiting = [other for other in self._waiting if other not in jobs]
                self._commit_all(jobs)
        if job.error is not None:
            raise job.error
        return job.result  # type: ignore[no-any-return]

    @contextmanager
    def reading(self) -> Iterator[Ledger]:
        """Hold the ledger, up to date with what any process has stored; other threads wait."""
        with self._lock:
            with self._named_errors():
                # One snapshot of all tables: a lease without its query would mean nothing.
                self._connection.execute("BEGIN")
                try:
                    self._catch_up()
                finally:
                    self._connection.execute("ROLLBACK")
            yield self._ledger

    def close(self) -> None:
        """Close the file; it is of no use afterwards."""
        with self._lock:
            self._connection.close()

    def _commit_all(self, jobs: list[_Job]) -> None:
        """One transaction for all jobs, a savepoint for each."""
        try:
            with self._named_errors():
                # In WAL mode NORMAL survives the end of a process, FULL the end of power as well.
                level = "FULL" if any(job.durable for job in jobs) else "NORMAL"
                self._connection.execute(f"PRAGMA synchronous={level}")
                self._connection.execute("BEGIN IMMEDIATE")
                for job in jobs:
                    self._do(job)
                self._connection.execute("COMMIT")
        except BaseException as error:
            self._roll_back()
            for job in jobs:
                job.error = job.error or error
            if not isinstance(error, Exception):
                raise
        finally:
            for job in jobs:
                job.done = True

    def _do(self, job: _Job) -> None:
        self._catch_up()  # rows of the jobs before it too
        self._connection.execute("SAVEPOINT job")
        try:
            job.result = job.work(self._connection, self._ledger)
        except sqlite3.Error:
            raise  # the file's trouble is everybody's
        except Exception as error:
            job.error = error
            self._connection.execute("ROLLBACK TO job")
        self._connection.execute("RELEASE job")

    def _roll_back(self) -> None:
        self._forget()
        try:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
        except sqlite3.Error:
            pass  # closed, or SQLite has rolled back by itself

    def _forget(self) -> None:
        """Begin the ledger anew: it may have seen rows that were not committed."""
        self._ledger = Ledger()
        self._read = {"rankings": 0, "queries": 0, "leases": 0}

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        """What SQLite reports becomes an error that names the file."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise RankingError(f"the ranking store {self.path} failed: {error}") from error
        except sqlite3.ProgrammingError as error:
            raise RankingError(f"the ranking store {self.path} is closed") from error
        except sqlite3.DatabaseError as error:
            raise CorruptFileError(f"{self.path} is damaged: {error}") from error

    def _catch_up(self) -> None:
        for number, content in self._new("rankings", "content"):
            self._ledger.add_ranking(ranking_from_json(content))
            self._read["rankings"] = number
        columns = "query_id, episode_ids, annotator, strategy, created_ns, purpose"
        for number, *values in self._new("queries", columns):
            query_id, episode_ids, annotator, strategy, created_ns, purpose = values
            videos = tuple(episode_ids.split(" "))
            query = Query(query_id, videos, annotator, strategy, created_ns, 0, purpose)
            self._ledger.add_query(query)
            self._read["queries"] = number
        for number, query_id, expires_ns in self._new("leases", "query_id, expires_ns"):
            self._ledger.add_lease(query_id, expires_ns)
            self._read["leases"] = number

    def _new(self, table: str, columns: str) -> list[Any]:
        """Rows that were not read yet; their numbers only grow."""
        return self._connection.execute(
            f"SELECT number, {columns} FROM {table} WHERE number > ? ORDER BY number",
            (self._read[table],),
        ).fetchall()
