"""The ranking store: nothing is lost, nothing is stored twice, bad input is refused by name."""

import json
import signal
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

from rapl_core.errors import CorruptFileError, RankingError, UnknownNameError
from rapl_core.preferences import RankingStore, export_jsonl, export_queries, read_jsonl
from rapl_core.types import Ranking

WRITER = """
import sys
from rapl_core.preferences import RankingStore
from rapl_core.types import Ranking

path, name, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
with RankingStore(path) as store:
    for number in range(count):
        ranking = f"{name}-{number}"
        store.add(Ranking(ranking, name, ("a", "b", "c"), (1, 2, 3)))
        print(ranking, flush=True)
"""


def ranking(ranking_id: str = "r1", **changes: object) -> Ranking:
    fields: dict[str, object] = {
        "ranking_id": ranking_id,
        "annotator": "ada",
        "episode_ids": ("a", "b", "c"),
        "ranks": (2, 1, 3),
    }
    return Ranking(**{**fields, **changes})  # type: ignore[arg-type]


@pytest.fixture
def store(tmp_path: Path) -> RankingStore:
    return RankingStore(tmp_path / "rankings.sqlite")


def start_writer(path: Path, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), name, str(count)],
        stdout=subprocess.PIPE,
        text=True,
    )


def test_a_ranking_comes_back_as_it_went_in(store: RankingStore) -> None:
    given = ranking(response_s=2.5, created_ns=1_700_000_000_000_000_123, verdict="ranked")
    store.add(given)
    with RankingStore(store.path) as reopened:
        assert reopened.all() == [given]


def test_adding_the_same_ranking_twice_stores_it_once(store: RankingStore) -> None:
    assert store.add(ranking()) == 1
    assert store.add(ranking()) == 1


def test_an_id_with_another_content_is_refused_and_the_first_stays(store: RankingStore) -> None:
    store.add(ranking())
    with pytest.raises(RankingError, match="r1 is already stored"):
        store.add(ranking(ranks=(1, 2, 3)))
    assert [r.ranks for r in store.all()] == [(2, 1, 3)]


def test_a_correction_is_a_new_row_and_hides_the_old_one(store: RankingStore) -> None:
    store.add(ranking("r1"))
    store.add(ranking("r2", replaces="r1"))
    store.add(ranking("r3", replaces="r2"))
    assert [r.ranking_id for r in store.all()] == ["r1", "r2", "r3"]
    assert [r.ranking_id for r in store.effective()] == ["r3"]


def test_a_row_is_replaced_once_and_only_by_its_own_videos(store: RankingStore) -> None:
    store.add(ranking("r1"))
    store.add(ranking("r2", replaces="r1"))
    with pytest.raises(RankingError, match="replaces r1, which r2 has replaced already"):
        store.add(ranking("r3", replaces="r1"))
    with pytest.raises(RankingError, match="r4 is about a, b, d, the one that it replaces about"):
        store.add(ranking("r4", replaces="r2", episode_ids=("a", "b", "d")))
    assert [r.ranking_id for r in store.effective()] == ["r2"]


def test_undo_is_a_further_row_and_leases_the_query_again(store: RankingStore) -> None:
    first = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    second = store.lease(("b", "c", "d"), "ada", "uniform", 60)
    store.add(ranking("r1", query_id=first.query_id))
    store.add(ranking("r2", query_id=second.query_id, episode_ids=("b", "c", "d")))
    undone = store.undo("ada", "u1")
    assert undone.ranking.ranking_id == "r2"
    assert undone.query is not None and undone.query.episode_ids == second.episode_ids
    assert store.undo("ada", "u1").ranking.ranking_id == "r2", "sent twice, taken back once"
    assert [r.ranking_id for r in store.effective()] == ["r1"]
    assert [r.ranking_id for r in store.all()] == ["r1", "r2", "u1"], "nothing is deleted"
    assert [q.query_id for q in store.open_queries("ada")] == [second.query_id]
    store.add(ranking("r3", query_id=second.query_id, episode_ids=("b", "c", "d"), ranks=(1, 1, 1)))
    assert [r.ranking_id for r in store.effective()] == ["r1", "r3"]
    assert store.undo("ada", "u2", "r1").ranking.ranking_id == "r1", "any one, not the last alone"
    with RankingStore(store.path) as reopened:
        assert [r.ranking_id for r in reopened.effective()] == ["r3"]
        with reopened.reading() as ledger:
            assert (ledger.given(), ledger.given("ada"), ledger.given("bob")) == (1, 1, 0)


def test_an_undo_of_nothing_is_refused_with_the_reason(store: RankingStore) -> None:
    with pytest.raises(RankingError, match="'ada' has no answer that counts"):
        store.undo("ada", "u0")
    store.add(ranking("r1"))
    with pytest.raises(RankingError, match="there is no ranking 'r9'"):
        store.undo("ada", "u0", "r9")
    with pytest.raises(RankingError, match="r1 is of 'ada', not of 'bob'"):
        store.undo("bob", "u0", "r1")
    assert store.undo("ada", "u1", "r1").query is None, "it was unasked"
    with pytest.raises(RankingError, match="u1 is itself an undo"):
        store.undo("ada", "u2", "u1")
    with pytest.raises(RankingError, match="replaces r1, which u1 has replaced already"):
        store.undo("ada", "u2", "r1")
    with pytest.raises(RankingError, match="r1 is already stored with another content"):
        store.undo("ada", "r1")


def test_an_undo_passes_over_what_was_imported_or_unasked_and_takes_back_an_answer(
    store: RankingStore,
) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    store.add(ranking("asked", query_id=query.query_id))
    store.add(ranking("unasked", episode_ids=("a", "b", "d")))
    store.add_imported(ranking("imported", query_id="elsewhere", episode_ids=("b", "c", "d")))
    assert store.undo("ada", "u1").ranking.ranking_id == "asked"
    with pytest.raises(RankingError, match="no answer that counts"):
        store.undo("ada", "u2")
    assert [r.ranking_id for r in store.effective()] == ["unasked", "imported"]


def test_a_replayed_lease_and_one_of_somebody_else_are_refused(store: RankingStore) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    with pytest.raises(RankingError, match="is of 'bob', its query .* was leased to 'ada'"):
        store.add(ranking("r0", annotator="bob", query_id=query.query_id))
    store.add(ranking("r1", query_id=query.query_id))
    with pytest.raises(RankingError, match="is answered already, by ranking r1"):
        store.add(ranking("r2", query_id=query.query_id))
    assert store.add(ranking("r1", query_id=query.query_id)) == 1, "the same once more is no replay"


def test_a_correction_may_come_after_the_lease(
    store: RankingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    store.add(ranking("r1", query_id=query.query_id))
    monkeypatch.setattr("time.time_ns", lambda: query.expires_ns + 10**9)
    store.add(ranking("r2", query_id=query.query_id, replaces="r1", ranks=(1, 2, 3)))
    assert [r.ranking_id for r in store.effective()] == ["r2"]


def test_a_correction_of_nothing_or_of_another_person_is_refused(store: RankingStore) -> None:
    with pytest.raises(RankingError, match="replaces r0, which is not stored"):
        store.add(ranking("r1", replaces="r0"))
    store.add(ranking("r1"))
    with pytest.raises(RankingError, match="'bob' replaces r1, which is of 'ada'"):
        store.add(ranking("r2", annotator="bob", replaces="r1"))


def test_rankings_are_listed_by_annotator_offset_and_limit(store: RankingStore) -> None:
    for number in range(6):
        store.add(ranking(f"r{number}", annotator="ada" if number % 2 else "bob"))
    assert [r.ranking_id for r in store.all(annotator="bob")] == ["r0", "r2", "r4"]
    assert [r.ranking_id for r in store.all(offset=1, limit=2)] == ["r1", "r2"]
    assert store.all(offset=9) == []
    assert (store.count(), store.count("ada")) == (6, 3)


def test_unknown_episodes_are_refused_by_name(tmp_path: Path) -> None:
    store = RankingStore(tmp_path / "r.sqlite", known_episode={"a", "b"}.__contains__)
    with pytest.raises(RankingError, match="unknown episodes: c"):
        store.add(ranking())
    with pytest.raises(RankingError, match="unknown episodes: d"):
        store.lease(("a", "d"), "ada", "uniform", 60)
    assert store.count() == 0


def test_repeated_episodes_and_wrong_ranks_cannot_be_made() -> None:
    with pytest.raises(RankingError, match="repeats a"):
        ranking(episode_ids=("a", "a", "b"))
    with pytest.raises(RankingError, match="2 ranks, expected 3"):
        ranking(ranks=(1, 2))
    with pytest.raises(RankingError, match="not within 1..3"):
        ranking(ranks=(2, 3, 4))
    with pytest.raises(RankingError, match="is skipped and has 3 ranks"):
        ranking(verdict="skipped")
    with pytest.raises(UnknownNameError, match="'liked'; known: ranked, skipped"):
        ranking(verdict="liked")
    with pytest.raises(RankingError, match="takes back none|withdrawn and names none"):
        ranking(verdict="withdrawn", ranks=())
    with pytest.raises(RankingError, match="annotator has more than 64"):
        ranking(annotator="a" * 65)


def test_a_leased_query_is_open_until_it_is_answered(store: RankingStore) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    assert store.open_queries("ada") == [query]
    assert store.open_queries("bob") == []
    assert store.query(query.query_id) == query
    store.add(ranking(query_id=query.query_id))
    assert store.open_queries() == []


def test_an_answer_after_a_long_break_is_taken_unless_the_same_was_asked_again(
    store: RankingStore,
) -> None:
    late = store.lease(("a", "b", "c"), "ada", "uniform", -5)
    again = store.lease(("c", "b", "a"), "bob", "uniform", 60)
    with pytest.raises(RankingError, match=f"expired 5 s ago, .* again in query {again.query_id}"):
        store.add(ranking("r1", query_id=late.query_id))
    store.add(ranking("r2", annotator="bob", query_id=again.query_id))
    with pytest.raises(RankingError, match="expired 5 s ago"):
        store.add(ranking("r1", query_id=late.query_id))
    quiet = store.lease(("a", "b", "d"), "ada", "uniform", -5)
    store.lease(("a", "b", "d"), "bob", "uniform", -5)  # asked again, and left again
    shared = store.lease(("a", "b", "d"), "cyd", "shared", 60, "shared")  # meant to be the same
    answer = {"query_id": quiet.query_id, "episode_ids": ("a", "b", "d")}
    store.add(ranking("r3", **answer))
    with pytest.raises(RankingError, match="answered already, by ranking r3"):
        store.add(ranking("r4", **answer))
    assert store.open_queries() == [shared]


def test_an_answer_about_other_videos_is_refused(store: RankingStore) -> None:
    other = store.lease(("a", "b", "d"), "ada", "uniform", 60)
    with pytest.raises(RankingError, match="its query .* about a, b, d"):
        store.add(ranking(query_id=other.query_id))
    with pytest.raises(RankingError, match="no query 'nonsense'"):
        store.add(ranking(query_id="nonsense"))
    assert store.open_queries() == [other]


def test_an_answer_sent_again_after_the_lease_ended_is_still_the_same(
    store: RankingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    answer = ranking(query_id=query.query_id)
    store.add(answer)
    monkeypatch.setattr("time.time_ns", lambda: query.expires_ns + 1)
    assert store.add(answer) == 1


def test_threads_and_processes_write_at_the_same_time(tmp_path: Path) -> None:
    path = tmp_path / "rankings.sqlite"
    writers = [start_writer(path, name, 25) for name in ("p0", "p1")]
    with RankingStore(path) as store, ThreadPoolExecutor(4) as threads:
        list(threads.map(lambda n: store.add(ranking(f"t{n}")), range(25)))
        for writer in writers:
            writer.communicate(timeout=60)
            assert writer.returncode == 0
        assert store.count() == 75
        assert len({r.ranking_id for r in store.all()}) == 75


def test_a_reader_sees_a_query_and_its_lease_together(
    store: RankingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = store._file
    read = file._new

    def read_while_another_writes(table: str, columns: str) -> list[Any]:
        rows = read(table, columns)
        if table == "queries":
            other.lease(("a", "b", "c"), "ada", "uniform", 60)
        return rows

    with RankingStore(store.path) as other:
        monkeypatch.setattr(file, "_new", read_while_another_writes)
        for seen in range(3):
            with store.reading() as ledger:
                assert len(ledger.open_queries(0)) == ledger.queries == seen


def test_writers_who_share_a_commit_are_refused_one_by_one(store: RankingStore) -> None:
    together = Barrier(20)

    def answer(number: int) -> str:
        together.wait(timeout=30)
        try:
            store.add(ranking("the-same" if number % 2 else f"r{number}", ranks=(1, 2, 3)))
        except RankingError as error:
            return str(error)
        return ""

    store.add(ranking("the-same"))
    with ThreadPoolExecutor(20) as threads:
        said = list(threads.map(answer, range(20)))
    assert [bool(text) for text in said] == [number % 2 == 1 for number in range(20)]
    assert store.count() == 11


def test_first_users_may_come_at_the_same_moment(tmp_path: Path) -> None:
    def first_use(number: int, path: Path, together: Barrier) -> int:
        together.wait(timeout=30)
        with RankingStore(path) as store:
            return store.add(ranking(f"r{number}"))

    with ThreadPoolExecutor(6) as threads:
        for attempt in range(10):
            path, together = tmp_path / f"{attempt}.sqlite", Barrier(6)
            counts = threads.map(first_use, range(6), [path] * 6, [together] * 6)
            assert sorted(counts) == [1, 2, 3, 4, 5, 6]


def test_what_was_acknowledged_survives_kill_9(tmp_path: Path) -> None:
    path = tmp_path / "rankings.sqlite"
    writer = start_writer(path, "victim", 100_000)
    assert writer.stdout is not None
    acknowledged = [writer.stdout.readline().strip() for _ in range(20)]
    writer.send_signal(signal.SIGKILL)
    acknowledged += [line.strip() for line in writer.stdout if line.endswith("\n")]
    writer.wait(timeout=10)
    with RankingStore(path) as store:
        stored = [r.ranking_id for r in store.all()]
        assert stored[: len(acknowledged)] == acknowledged
        assert len(stored) - len(acknowledged) <= 1
        assert store.add(ranking("afterwards")) == len(stored) + 1


def test_a_second_store_in_a_process_does_not_take_the_locks_of_the_first(tmp_path: Path) -> None:
    """A node opens its store again to align; another process then opens and closes it too.

    Were the first one's locks gone, that process would take itself for the last, remove the log,
    and what the first one stores from then on would be in no file that has a name.
    """
    path = tmp_path / "rankings.sqlite"
    other = f"""
from pathlib import Path
from rapl_core.preferences import RankingStore
with RankingStore(Path({str(path)!r})) as store:
    print(store.count())
"""

    def seen_by_another_process() -> int:
        ended = subprocess.run(
            [sys.executable, "-c", other], check=True, capture_output=True, text=True
        )
        return int(ended.stdout)

    with RankingStore(path) as first:
        first.add(ranking("r0"))
        with RankingStore(path) as second:
            assert second.count() == 1
        assert seen_by_another_process() == 1
        first.add(ranking("r1"))
        assert seen_by_another_process() == 2


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


def test_a_closed_store_says_so(store: RankingStore) -> None:
    store.close()
    with pytest.raises(RankingError, match="is closed"):
        store.count()


def test_an_export_brings_everything_into_another_store(tmp_path: Path) -> None:
    with RankingStore(tmp_path / "one.sqlite") as one, RankingStore(tmp_path / "two.sqlite") as two:
        query = one.lease(("a", "b", "c"), "ada", "uniform", 60)
        one.add(ranking("r1", query_id=query.query_id))
        one.add(ranking("r2", replaces="r1", response_s=1.25))
        one.add(ranking("r3", ranks=(), verdict="skipped"))
        lines = tmp_path / "rankings.jsonl"
        assert export_jsonl(one, lines) == 3
        for _ in range(2):
            for row in read_jsonl(lines):
                two.add_imported(row)
        assert two.count() == 3
        export_jsonl(two, tmp_path / "again.jsonl")
        assert export_queries(one, tmp_path / "queries.jsonl") == 1
    assert (tmp_path / "again.jsonl").read_text() == lines.read_text()
    (asked,) = (tmp_path / "queries.jsonl").read_text().splitlines()
    assert json.loads(asked)["query_id"] == query.query_id
    assert json.loads(asked)["episode_ids"] == ["a", "b", "c"]


def test_a_name_with_a_line_separator_in_it_is_read_back(tmp_path: Path) -> None:
    given = ranking(response_s=1.0, annotator="anna\u2028\x85b")
    with RankingStore(tmp_path / "r.sqlite") as store:
        store.add(given)
        export_jsonl(store, tmp_path / "r.jsonl")
    assert read_jsonl(tmp_path / "r.jsonl") == [given]


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("{", "not JSON"),
        ("[]", "is a JSON object"),
        ('{"ranking_id": "r"}', "lacks the field 'annotator'"),
        ('{"rank": 1}', "unknown fields rank"),
        (
            '{"ranking_id": "r", "annotator": "a", "episode_ids": ["a", "a"], "ranks": [1, 2]}',
            "repeats a",
        ),
        (
            '{"ranking_id": "r", "annotator": "a", "episode_ids": 3, "ranks": [1, 2]}',
            "of the wrong kind",
        ),
    ],
)
def test_a_bad_line_is_named_with_its_number(tmp_path: Path, line: str, complaint: str) -> None:
    path = tmp_path / "rankings.jsonl"
    path.write_text(f"\n{line}\n")
    with pytest.raises(RankingError, match=f"rankings.jsonl, line 2: .*{complaint}"):
        read_jsonl(path)
