"""Two hundred annotators rank at once: is anything lost or doubled, how long does it take?

    python experiments/preferences/many_annotators.py --annotators 200 --seconds 60

Each annotator is a thread that leases a query, answers it, corrects or takes back one answer in
twenty, and sends one in ten twice, as a page does after a lost connection: once at a person's pace,
once as fast as they can. At last they do so in a process that is ended with kill -9 in the middle;
what it was told is stored must then be there. Writes ``results/many_annotators.json``.
"""

import argparse
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rapl_core.analysis.provenance import commit, machine
from rapl_core.preferences import DeskConfig, QueryDesk, QueryRequest, RankingStore
from rapl_core.types import Ranking

HERE = Path(__file__).parent
VIDEOS = [f"video-{number:04d}" for number in range(1000)]


@dataclass(frozen=True)
class Outcome:
    """What a crowd did and what the store says of it."""

    annotators: int
    wall_s: float
    answered: int
    """Rankings whose storing was confirmed."""
    corrected: int
    withdrawn: int
    sent_twice: int
    errors: int
    lost: int
    """Confirmed and not in the store."""
    doubled: int
    """In the store more than once, or not confirmed to anybody."""
    same_videos: int
    """Queries that two people were given by accident."""
    answers_per_s: float
    store_ms_median: float
    """Time from sending an answer to its being on disk, other writers included."""
    store_ms_99: float
    lease_ms_median: float
    lease_ms_99: float


class Crowd:
    """Threads that rank until time is up."""

    def __init__(self, store: RankingStore, annotators: int, pace_s: float = 0.0) -> None:
        self.store = store
        self.annotators = annotators
        self.confirmed: list[str] = []
        self.corrected: list[str] = []
        self.withdrawn: list[str] = []
        self.twice = 0
        self.store_s: list[float] = []
        self.lease_s: list[float] = []
        self.errors: list[str] = []
        self._desk = QueryDesk(store, DeskConfig())
        self._pace_s = pace_s
        self._end_s = 0.0

    def rank(self, seconds: float) -> float:
        """Rank for so long; returns the wall time."""
        began_s = time.monotonic()
        self._end_s = began_s + seconds
        threads = [
            threading.Thread(target=self._live, args=(number,)) for number in range(self.annotators)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return time.monotonic() - began_s

    def _live(self, number: int) -> None:
        rng = np.random.default_rng(number)
        name = f"annotator-{number:03d}"
        try:
            if self._pace_s:
                time.sleep(float(rng.random()) * self._pace_s)
            while True:  # each answers once at least
                self._rank_one(name, rng)
                if self._pace_s:
                    time.sleep(self._pace_s)
                if time.monotonic() > self._end_s:
                    return
        except Exception as error:  # any at all is a finding
            self.errors.append(f"{name}: {error!r}")

    def _rank_one(self, name: str, rng: np.random.Generator) -> None:
        began_s = time.perf_counter()
        query = self._desk.next(QueryRequest(name), VIDEOS)
        self.lease_s.append(time.perf_counter() - began_s)
        ranks = tuple(int(rank) for rank in 1 + rng.permutation(3))
        ranking = Ranking(uuid.uuid4().hex, name, query.episode_ids, ranks, query_id=query.query_id)
        began_s = time.perf_counter()
        self.store.add(ranking)
        self.store_s.append(time.perf_counter() - began_s)
        self._confirm(ranking.ranking_id)
        draw = rng.random()
        if draw < 0.1:
            self.store.add(ranking)
            self.twice += 1
        elif draw < 0.125:
            better = Ranking(
                uuid.uuid4().hex, name, query.episode_ids, ranks[::-1],
                query_id=query.query_id, replaces=ranking.ranking_id,
            )  # fmt: skip
            self.store.add(better)
            self._confirm(better.ranking_id)
            self.corrected.append(ranking.ranking_id)
        elif draw < 0.15:
            withdrawal = uuid.uuid4().hex
            self.store.undo(name, withdrawal, ranking.ranking_id)
            self._confirm(withdrawal)
            self.withdrawn.append(ranking.ranking_id)

    def _confirm(self, ranking_id: str) -> None:
        self.confirmed.append(ranking_id)


class TellingCrowd(Crowd):
    """Says on a pipe what was confirmed, so that it is known after kill -9."""

    def _confirm(self, ranking_id: str) -> None:
        os.write(1, f"{ranking_id}\n".encode())  # a write this short is never torn


def judge(crowd: Crowd, wall_s: float) -> Outcome:
    """Hold what the crowd was told against a fresh look at the store."""
    with RankingStore(crowd.store.path) as store:
        rows = store.all()
        effective = {ranking.ranking_id for ranking in store.effective()}
    counts = Counter(ranking.ranking_id for ranking in rows)
    confirmed = set(crowd.confirmed)
    wrong = effective & {*crowd.corrected, *crowd.withdrawn}
    # A query and its corrections have one id; two queries with the same videos are an accident.
    queries = {ranking.query_id: frozenset(ranking.episode_ids) for ranking in rows}
    return Outcome(
        annotators=crowd.annotators,
        wall_s=wall_s,
        answered=len(crowd.store_s),
        corrected=len(crowd.corrected),
        withdrawn=len(crowd.withdrawn),
        sent_twice=crowd.twice,
        errors=len(crowd.errors),
        lost=len(confirmed - set(counts)),
        doubled=sum(n - 1 for n in counts.values()) + len(set(counts) - confirmed) + len(wrong),
        same_videos=len(queries) - len(set(queries.values())),
        answers_per_s=len(crowd.store_s) / wall_s,
        **_milliseconds("store", crowd.store_s),
        **_milliseconds("lease", crowd.lease_s),
    )


def survive_kill(path: Path, annotators: int, after: int) -> dict[str, Any]:
    """Kill a crowd in the middle of its work and look for all that it was told is stored.

    :param after: answers that must have been confirmed before.
    """
    import subprocess

    command = [sys.executable, __file__, "--victim", str(path), "--annotators", str(annotators)]
    victim = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert victim.stdout is not None
    confirmed = [victim.stdout.readline().decode().strip() for _ in range(after)]
    victim.send_signal(signal.SIGKILL)
    confirmed += [line.decode().strip() for line in victim.stdout if line.endswith(b"\n")]
    victim.wait(timeout=60)
    with RankingStore(path) as store:
        stored = [ranking.ranking_id for ranking in store.all()]
    return {
        "annotators": annotators,
        "confirmed": len(confirmed),
        "stored": len(stored),
        "lost": len(set(confirmed) - set(stored)),
        "doubled": len(stored) - len(set(stored)),
    }


def fsync_ms(folder: Path) -> float:
    """Median time that this disk takes to make 4 KiB permanent: no store can be faster."""
    times = []
    with (folder / "probe").open("wb") as file:
        for _ in range(50):
            began_s = time.perf_counter()
            file.write(b"x" * 4096)
            file.flush()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - began_s)
    return 1e3 * float(np.median(times))


def _milliseconds(name: str, seconds: list[float]) -> dict[str, float]:
    values = np.array(seconds) * 1e3
    return {
        f"{name}_ms_median": float(np.median(values)),
        f"{name}_ms_99": float(np.quantile(values, 0.99)),
    }


def main() -> None:
    """Run the crowd as fast as it can, at a person's pace, alone, and killed; write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--annotators", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--victim", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    if options.victim:
        TellingCrowd(RankingStore(options.victim), options.annotators).rank(3600.0)
        return
    found: dict[str, Any] = {"commit": commit(), "machine": machine()}
    found["load_average"], found["processors"] = os.getloadavg()[0], multiprocessing.cpu_count()
    with tempfile.TemporaryDirectory(dir=".") as name:  # on the disk where runs lie
        folder = Path(name)
        found["fsync_ms_median"] = fsync_ms(folder)
        for title, annotators, seconds, pace_s in (
            ("one_annotator", 1, 5.0, 0.0),
            ("at_a_persons_pace", options.annotators, options.seconds, 5.0),
            ("as_fast_as_they_can", options.annotators, options.seconds, 0.0),
        ):
            with RankingStore(folder / f"{title}.sqlite") as store:
                crowd = Crowd(store, annotators, pace_s)
                found[title] = asdict(judge(crowd, crowd.rank(seconds)))
            print(title, json.dumps(found[title], indent=1), *crowd.errors[:3], flush=True)
        found["killed"] = survive_kill(folder / "killed.sqlite", options.annotators, 1000)
        print("killed", found["killed"])
    options.results.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found, indent=1, default=str)
    (options.results / "many_annotators.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
