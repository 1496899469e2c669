"""How the file of a ranking store is opened: damaged, of another format or program, refused."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from rankings import ranking

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences import RankingStore

OLD = """
CREATE TABLE rankings (number INTEGER PRIMARY KEY AUTOINCREMENT, ranking_id TEXT NOT NULL UNIQUE,
    annotator TEXT NOT NULL, replaces TEXT NOT NULL, content TEXT NOT NULL);
CREATE INDEX rankings_by_annotator ON rankings (annotator, number);
CREATE TABLE queries (query_id TEXT PRIMARY KEY, annotator TEXT NOT NULL, strategy TEXT NOT NULL,
    episode_ids TEXT NOT NULL, created_ns INTEGER NOT NULL, expires_ns INTEGER NOT NULL);
INSERT INTO rankings VALUES (7, 'r1', 'ada', '', '{"annotator": "ada", "created_ns": 5,
    "episode_ids": ["a", "b"], "query_id": "q1", "ranking_id": "r1", "ranks": [2, 1],
    "replaces": "", "response_s": null, "verdict": "ranked"}');
INSERT INTO queries VALUES ('q1', 'ada', 'uniform', 'a b', 5, 6);
INSERT INTO queries VALUES ('q2', 'bob', 'uniform', 'b c', 5, 9000000000000000000);
PRAGMA application_id = 1380012108;
PRAGMA user_version = 1;
"""


def test_a_short_file_that_is_no_database_is_not_taken_for_an_empty_one(tmp_path: Path) -> None:
    path = tmp_path / "rankings.sqlite"
    path.write_text("ranking,1,2,3")
    with pytest.raises(CorruptFileError, match="no SQLite file"):
        RankingStore(path)
    assert path.read_text() == "ranking,1,2,3"


@pytest.mark.parametrize("damage", ["not a database", "page", "truncated"])
def test_a_damaged_file_is_named_and_left_as_it_is(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "rankings.sqlite"
    with RankingStore(path) as store, ThreadPoolExecutor(50) as threads:
        list(threads.map(store.add, [ranking(f"r{number}") for number in range(200)]))
    content = bytearray(path.read_bytes())
    if damage == "not a database":
        content = bytearray(b"ranking,1,2,3\n" * 100)
    elif damage == "page":
        content[4096:] = b"\xff" * (len(content) - 4096)
    else:
        content = content[: len(content) // 2]
    path.write_bytes(content)
    with pytest.raises(CorruptFileError, match="rankings.sqlite"):
        RankingStore(path)
    assert path.read_bytes() == content


def test_a_store_of_the_first_format_is_migrated_and_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "old.sqlite"
    with sqlite3.connect(path) as connection:
        connection.executescript(OLD)
    connection.close()
    with RankingStore(path) as store:
        (old,) = store.all()
        assert (old.ranks, old.query_id, old.created_ns) == ((2, 1), "q1", 5)
        assert store.add(old) == 1, "sent again, it is still the same"
        assert store.query("q1").expires_ns == 6 and store.query("q2").purpose == "new"
        assert [q.query_id for q in store.open_queries()] == ["q2"]
        answer = ranking("r2", annotator="bob", query_id="q2", episode_ids=("b", "c"), ranks=(1, 2))
        assert store.add(answer) == 2
    with RankingStore(path) as again:
        assert [r.ranking_id for r in again.all()] == ["r1", "r2"]


def test_a_store_of_a_later_program_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "later.sqlite"
    RankingStore(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 9")
    connection.close()
    with pytest.raises(CorruptFileError, match="has the format 9, expected 1 to 2"):
        RankingStore(path)


def test_a_database_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE things (name TEXT)")
    with pytest.raises(CorruptFileError, match="of another program"):
        RankingStore(path)


def test_a_folder_that_cannot_be_written_is_a_clear_error() -> None:
    # Nobody can create files there, whatever the user.
    with pytest.raises(RankingError, match="cannot write the ranking store /proc/self/new/r.sq"):
        RankingStore("/proc/self/new/r.sqlite")
    with pytest.raises(RankingError, match="cannot write the ranking store /proc/self/r.sqlite"):
        RankingStore("/proc/self/r.sqlite")
