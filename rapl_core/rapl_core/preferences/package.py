"""A folder with rankings and the bags of the ranked episodes, to hand on or to take in."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rapl_core.episodes import EpisodeStore
from rapl_core.episodes.writing import TEMPORARY_PREFIX
from rapl_core.errors import RankingError
from rapl_core.preferences.exchange import export_jsonl, export_queries, read_jsonl
from rapl_core.preferences.parquet import export_parquet, read_parquet
from rapl_core.preferences.store import RANKINGS_FILE, RankingStore
from rapl_core.types import Ranking

Format = Literal["jsonl", "parquet"]
QUERIES_FILE = "queries.jsonl"
EPISODES_FOLDER = "episodes"


@dataclass(frozen=True)
class Handed:
    """What was exported or imported."""

    rankings: int
    episodes: int
    """Bags copied; those that were there already are not counted."""
    path: Path


def export_package(run: Path, out: Path, format_: Format = "jsonl", bags: bool = False) -> Handed:
    """Write ``out/rankings.<format>``, ``out/queries.jsonl`` and, if asked, the bags of all ranked
    videos to ``out/episodes``.

    :param run: run folder.
    :raises RankingError: if the run has no rankings, or ``out`` cannot be written.
    """
    if not (run / RANKINGS_FILE).is_file():
        raise RankingError(f"{run} has no {RANKINGS_FILE}: nothing to export")
    path = out / f"rankings.{format_}"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RankingError(f"cannot write rankings to {out}: {error}") from error
    with RankingStore(run / RANKINGS_FILE) as store:
        count = (export_jsonl if format_ == "jsonl" else export_parquet)(store, path)
        export_queries(store, out / QUERIES_FILE)
        shown = {video for ranking in store.all() for video in ranking.episode_ids}
    copied = _copy_bags(shown, run / EPISODES_FOLDER, out / EPISODES_FOLDER) if bags else 0
    return Handed(count, copied, path)


def import_package(run: Path, source: Path) -> Handed:
    """Add the rankings that the run lacks, and the bags beside them.

    :param source: a file of JSON lines or Parquet, or a folder that :func:`export_package` wrote.
    :raises RankingError: if it holds no rankings, one is refused (none is added if it is no
        ranking at all, or about a video that the run lacks), or the folder cannot be written.
    :raises CorruptFileError: if a bag is damaged.
    """
    path = source
    if source.is_dir():
        found = [source / f"rankings.{kind}" for kind in ("jsonl", "parquet")]
        path = next((file for file in found if file.is_file()), found[0])
    rankings = read_rankings(path)
    bags = path.parent / EPISODES_FOLDER
    copied = 0
    if source.is_dir() and bags.is_dir():
        shown = {video for ranking in rankings for video in ranking.episode_ids}
        copied = _copy_bags(shown, bags, run / EPISODES_FOLDER)
    episodes = EpisodeStore(run / EPISODES_FOLDER)
    unknown = sorted({e for r in rankings for e in r.episode_ids if e not in episodes})
    if unknown:
        raise RankingError(
            f"{path} is about {len(unknown)} videos that {run} lacks, such as {unknown[0]}; "
            "an export with bags brings them along"
        )
    with RankingStore(run / RANKINGS_FILE, episodes.__contains__) as store:
        before = store.count()
        for ranking in rankings:
            store.add_imported(ranking)
        return Handed(store.count() - before, copied, path)


def read_rankings(path: Path) -> list[Ranking]:
    """Return the rankings in a file of JSON lines or Parquet, told apart by its name.

    :raises RankingError: if there is none, or it holds something else.
    """
    if not path.is_file():
        raise RankingError(f"there are no rankings at {path}")
    return read_parquet(path) if path.suffix == ".parquet" else read_jsonl(path)


def _copy_bags(ids: set[str], source: Path, target: Path) -> int:
    """Copy episodes that ``target`` lacks, each whole or not at all; checked by their hash."""
    have, into = EpisodeStore(source), EpisodeStore(target)
    copied = 0
    for episode_id in sorted(ids):
        if episode_id in into or episode_id not in have:
            continue
        have.frames(episode_id)  # raises if the bag is damaged
        beside = target / f"{TEMPORARY_PREFIX}{episode_id}.{os.getpid()}"
        try:
            target.mkdir(parents=True, exist_ok=True)
            shutil.copytree(have.path(episode_id), beside)
            beside.replace(target / episode_id)
        except OSError as error:
            shutil.rmtree(beside, ignore_errors=True)
            raise RankingError(f"cannot copy episode {episode_id} to {target}: {error}") from error
        copied += 1
    return copied
