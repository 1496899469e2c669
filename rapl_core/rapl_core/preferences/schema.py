"""The tables of a ranking store and how its file is opened."""

import sqlite3
import time
from pathlib import Path

from rapl_core.errors import CorruptFileError, RankingError

APPLICATION_ID = 0x5241504C
"""``RAPL`` in ASCII, in the file's header: tells a ranking store from other databases."""

SCHEMA_VERSION = 2
"""Version 1 had no purpose of a query, and one expiry in place of leases; it is migrated."""

BUSY_TIMEOUT_S = 30.0
"""How long a writer waits for another before it gives up."""

_SMALLEST_PAGE = 512
"""Bytes; every SQLite file has at least one page, and is written by whole pages."""

# All three tables only ever grow: what a row said is never changed or removed.
_TABLES = """
CREATE TABLE rankings (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    ranking_id TEXT NOT NULL UNIQUE,
    annotator TEXT NOT NULL,
    replaces TEXT NOT NULL,
    content TEXT NOT NULL
);
CREATE TABLE queries (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    query_id TEXT NOT NULL UNIQUE,
    annotator TEXT NOT NULL,
    strategy TEXT NOT NULL,
    purpose TEXT NOT NULL,
    episode_ids TEXT NOT NULL,
    created_ns INTEGER NOT NULL
);
CREATE TABLE leases (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    query_id TEXT NOT NULL,
    expires_ns INTEGER NOT NULL
);
"""

_MIGRATE_1 = f"""
ALTER TABLE queries RENAME TO queries_1;
{_TABLES[_TABLES.index("CREATE TABLE queries") :]}
INSERT INTO queries (query_id, annotator, strategy, purpose, episode_ids, created_ns)
    SELECT query_id, annotator, strategy, 'new', episode_ids, created_ns
    FROM queries_1 ORDER BY created_ns, query_id;
INSERT INTO leases (query_id, expires_ns)
    SELECT query_id, expires_ns FROM queries_1 ORDER BY created_ns, query_id;
DROP TABLE queries_1;
"""


def check_database(path: Path) -> None:
    """Read ``path`` and leave it as it is; nothing happens when it does not exist or is empty.

    Only SQLite may open the file: a process that closes it by other means loses the locks of its
    open stores, and another process then removes the log that they write to
    (sqlite.org/howtocorrupt.html, 2.2).

    :raises CorruptFileError: if it is no ranking store, or a damaged one.
    """
    if not path.exists() or path.stat().st_size == 0:
        return
    no_database = f"{path} is not a ranking store: no SQLite file; it is left as is"
    if path.stat().st_size < _SMALLEST_PAGE:  # SQLite would take it for an empty one
        raise CorruptFileError(no_database)
    try:
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=BUSY_TIMEOUT_S
        )
        try:
            # One snapshot for all: another process may be about to create the tables.
            connection.execute("BEGIN")
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        finally:
            connection.close()
    except sqlite3.OperationalError as error:
        raise RankingError(f"cannot read the ranking store {path}: {error}") from error
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_NOTADB:
            raise CorruptFileError(no_database) from error
        raise CorruptFileError(f"{path} is damaged: {error}; it is left as is") from error
    if verdict != "ok":
        raise CorruptFileError(f"{path} is damaged: {verdict}; it is left as is")
    if tables == 0:
        return  # another process has only just created it
    if application != APPLICATION_ID:
        raise CorruptFileError(f"{path} is a database of another program; it is left as is")
    if not 1 <= version <= SCHEMA_VERSION:
        raise CorruptFileError(
            f"{path} has the format {version}, expected 1 to {SCHEMA_VERSION}: it is of a later "
            "program; it is left as is"
        )


def open_database(path: Path) -> sqlite3.Connection:
    """Open the ranking store at ``path``, created if need be, for reading and writing.

    Write-ahead log with full synchronisation: a row that was committed survives ``kill -9``.
    The connection may be used by any thread, one at a time.

    :raises CorruptFileError: if the file is damaged.
    :raises RankingError: if the folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        check_database(path)
    except OSError as error:
        raise RankingError(f"cannot write the ranking store {path}: {error}") from error
    deadline_s = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            return _connect(path)
        except sqlite3.OperationalError as error:
            # SQLite does not wait when two first users set the journal mode at once.
            if "locked" not in str(error) or time.monotonic() > deadline_s:
                raise RankingError(f"cannot write the ranking store {path}: {error}") from error
            time.sleep(0.01)


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(
        path, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
    )
    try:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        _create_tables(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _create_tables(connection: sqlite3.Connection) -> None:
    """Create or migrate in one transaction: two first users do not collide, and a process that is
    killed half-way leaves the file as it was."""
    connection.execute("BEGIN IMMEDIATE")
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if tables == 0 or version < SCHEMA_VERSION:
        for statement in (_TABLES if tables == 0 else _MIGRATE_1).split(";"):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id={APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    connection.execute("COMMIT")
