"""Queries about the learner's own videos: which are new, and what stands beside them."""

from pathlib import Path

import numpy as np
import pytest

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences import DeskConfig, QueryDesk, QueryRequest, RankingStore
from rapl_core.preferences.expert_set import strengths
from rapl_core.preferences.own_videos import OwnQueries, OwnVideos, videos_to_learn_from
from rapl_core.types import Ranking

EXPERTS = ("expert-0", "expert-1")


def recorded(folder: Path, count: int, first: int = 0) -> OwnVideos:
    videos = OwnVideos(folder / "own_videos.json")
    for number in reversed(range(first, first + count)):
        videos.add(f"train-{number}", 1000 + number)
    return videos


def selector(videos: OwnVideos, size: int = 3, seed: int = 0) -> OwnQueries:
    return OwnQueries(np.random.default_rng(seed), videos.new(), EXPERTS, size)


def pool(count: int) -> list[str]:
    return [*EXPERTS, *(f"train-{number}" for number in range(count))]


def test_new_is_what_came_since_the_last_alignment_across_restarts(tmp_path: Path) -> None:
    videos = recorded(tmp_path, 5)
    assert videos.new() == tuple(f"train-{n}" for n in range(5))
    videos.aligned(1002)
    assert videos.new() == ("train-3", "train-4")
    again = recorded(tmp_path, 6)
    assert again.new() == ("train-3", "train-4", "train-5")
    again.aligned(1000)
    assert len(again.new()) == 3, "what is known is not forgotten"


def test_of_many_new_videos_the_newest_are_asked_about(tmp_path: Path) -> None:
    new = recorded(tmp_path, 1000).new(most=100)
    assert new == tuple(f"train-{number}" for number in range(900, 1000))


def test_a_damaged_mark_is_named(tmp_path: Path) -> None:
    (tmp_path / "own_videos.json").write_text("{")
    with pytest.raises(CorruptFileError, match=r"own_videos\.json"):
        OwnVideos(tmp_path / "own_videos.json")


@pytest.mark.parametrize("size", [2, 3, 4])
def test_a_query_has_one_expert_in_any_place_and_is_never_asked_twice(
    tmp_path: Path, size: int
) -> None:
    queries, asked = selector(recorded(tmp_path, 8), size), set()
    places = set()
    for _ in range(14):
        query = queries.next(pool(8), asked)
        assert len(set(query)) == size and frozenset(query) not in asked
        [expert] = [name for name in query if name in EXPERTS]
        places.add(query.index(expert))
        asked.add(frozenset(query))
    assert places == set(range(size))


def test_too_few_new_videos_no_expert_and_no_query_left_are_said(tmp_path: Path) -> None:
    few = selector(recorded(tmp_path, 1))
    with pytest.raises(RankingError, match="recorded 1 of 2 new videos"):
        few.next(pool(1))
    enough = selector(recorded(tmp_path, 2))
    with pytest.raises(RankingError, match="no expert video"):
        enough.next(["train-0", "train-1"])
    asked = [("train-0", "train-1", expert) for expert in EXPERTS]
    with pytest.raises(RankingError, match="nearly all about the 2 new videos"):
        enough.next(pool(2), asked)


def test_one_person_ranks_own_queries_and_all_strengths_are_connected(tmp_path: Path) -> None:
    store = RankingStore(tmp_path / "rankings.sqlite")
    store.add(Ranking("r0", "ann", (*EXPERTS, "other"), (1, 2, 3)))
    desk = QueryDesk(store, DeskConfig())
    queries = selector(recorded(tmp_path, 6))
    for number in range(12):
        query = desk.next(QueryRequest("ann"), pool(6), queries)
        assert query.strategy == "own"
        order = sorted(query.episode_ids)  # the expert first, then the older video
        ranks = tuple(order.index(name) + 1 for name in query.episode_ids)
        store.add(Ranking(f"q{number}", "ann", query.episode_ids, ranks, query_id=query.query_id))
    found = strengths(store.effective())
    assert found["expert-0"] > found["train-0"] > found["train-5"]
    store.close()


def test_features_are_read_of_the_pool_and_of_those_others_that_were_ranked() -> None:
    rankings = [
        Ranking("a", "ann", ("train-7", "train-3", "video-1"), (1, 2, 3)),
        Ranking("b", "ann", ("train-3", "train-9"), (), "skipped"),
    ]
    assert videos_to_learn_from(["video-0", "video-1"], rankings) == [
        "video-0", "video-1", "train-7", "train-3",
    ]  # fmt: skip
