"""The ranking store: nothing is lost, nothing is stored twice, bad input is refused by name."""

import signal
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences import RankingStore, export_jsonl, import_jsonl, read_jsonl
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


def test_a_correction_of_nothing_or_of_another_person_is_refused(store: RankingStore) -> None:
    with pytest.raises(RankingError, match="replaces r0, which is not stored"):
        store.add(ranking("r1", replaces="r0"))
    store.add(ranking("r1"))
    with pytest.raises(RankingError, match="'bob' replaces r1, which is 'ada'"):
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


def test_a_leased_query_is_open_until_it_is_answered(store: RankingStore) -> None:
    query = store.lease(("a", "b", "c"), "ada", "uniform", 60)
    assert store.open_queries("ada") == [query]
    assert store.open_queries("bob") == []
    assert store.query(query.query_id) == query
    store.add(ranking(query_id=query.query_id))
    assert store.open_queries() == []


def test_an_answer_too_late_or_about_other_videos_is_refused(store: RankingStore) -> None:
    late = store.lease(("a", "b", "c"), "ada", "uniform", -5)
    with pytest.raises(RankingError, match="expired 5 s ago"):
        store.add(ranking(query_id=late.query_id))
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


def test_first_users_may_come_at_the_same_moment(tmp_path: Path) -> None:
    def first_use(number: int, path: Path, together: Barrier) -> int:
        together.wait(timeout=30)
        with RankingStore(path) as store:
            return store.add(ranking(f"r{number}"))

    with ThreadPoolExecutor(6) as threads:
        for attempt in range(25):
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


@pytest.mark.parametrize("damage", ["not a database", "page", "truncated"])
def test_a_damaged_file_is_named_and_left_as_it_is(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "rankings.sqlite"
    with RankingStore(path) as store:
        for number in range(200):
            store.add(ranking(f"r{number}"))
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
        assert import_jsonl(lines, two) == 3
        assert import_jsonl(lines, two) == 0
        export_jsonl(two, tmp_path / "again.jsonl")
    assert (tmp_path / "again.jsonl").read_text() == lines.read_text()


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
