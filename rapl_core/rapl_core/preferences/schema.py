"""The tables of a ranking store and how its file is opened."""

import sqlite3
import time
from pathlib import Path

from rapl_core.errors import CorruptFileError, RankingError

APPLICATION_ID = 0x5241504C
"""``RAPL`` in ASCII, in the file's header: tells a ranking store from other databases."""

SCHEMA_VERSION = 1

BUSY_TIMEOUT_S = 30.0
"""How long a writer waits for another before it gives up."""

_MAGIC = b"SQLite format 3\x00"

_TABLES = """
CREATE TABLE IF NOT EXISTS rankings (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    ranking_id TEXT NOT NULL UNIQUE,
    annotator TEXT NOT NULL,
    replaces TEXT NOT NULL,
    content TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS rankings_by_annotator ON rankings (annotator, number);
CREATE INDEX IF NOT EXISTS rankings_by_replaces ON rankings (replaces);
CREATE TABLE IF NOT EXISTS queries (
    query_id TEXT PRIMARY KEY,
    annotator TEXT NOT NULL,
    strategy TEXT NOT NULL,
    episode_ids TEXT NOT NULL,
    created_ns INTEGER NOT NULL,
    expires_ns INTEGER NOT NULL
);
"""


def check_database(path: Path) -> None:
    """Read ``path`` and leave it as it is; nothing happens when it does not exist or is empty.

    :raises CorruptFileError: if it is no ranking store, or a damaged one.
    """
    if not path.exists() or path.stat().st_size == 0:
        return
    with path.open("rb") as file:
        head = file.read(len(_MAGIC))
    if head != _MAGIC:
        raise CorruptFileError(f"{path} is not a ranking store: no SQLite file; it is left as is")
    try:
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=BUSY_TIMEOUT_S
        )
        try:
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        finally:
            connection.close()
    except sqlite3.OperationalError as error:
        raise RankingError(f"cannot read the ranking store {path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise CorruptFileError(f"{path} is damaged: {error}; it is left as is") from error
    if verdict != "ok":
        raise CorruptFileError(f"{path} is damaged: {verdict}; it is left as is")
    if tables == 0:
        return  # another process has only just created it
    if application != APPLICATION_ID:
        raise CorruptFileError(f"{path} is a database of another program; it is left as is")
    if version != SCHEMA_VERSION:
        raise CorruptFileError(
            f"{path} has the format {version}, expected {SCHEMA_VERSION}; it is left as is"
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
    """Create what is missing, in one transaction, so that two first users do not collide."""
    connection.execute("BEGIN IMMEDIATE")
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if tables == 0:
        for statement in _TABLES.split(";"):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id={APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    connection.execute("COMMIT")
