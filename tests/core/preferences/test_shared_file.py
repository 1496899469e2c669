"""Threads and processes on one ranking store at the same time, and one that is killed."""

import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest
from rankings import ranking

from rapl_core.errors import RankingError
from rapl_core.preferences import RankingStore

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


def start_writer(path: Path, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), name, str(count)],
        stdout=subprocess.PIPE,
        text=True,
    )


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
