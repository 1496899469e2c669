"""Who is given which query: the same one only on purpose, for consistency and agreement."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from rapl_core.errors import RankingError, ShapeError, UnknownNameError
from rapl_core.preferences import DeskConfig, Query, QueryDesk, QueryRequest, RankingStore
from rapl_core.types import Ranking

POOL = [f"v{number}" for number in range(8)]


def desk(store: RankingStore, **config: float) -> QueryDesk:
    return QueryDesk(store, DeskConfig(**config))  # type: ignore[arg-type]


def answer(store: RankingStore, query: Query, ranks: tuple[int, ...] = (1, 2, 3)) -> None:
    store.add(
        Ranking(
            f"answer to {query.query_id}"[:64],
            query.annotator,
            query.episode_ids,
            ranks,
            query_id=query.query_id,
        )
    )


def test_people_who_ask_at_once_never_get_the_same_videos(store: RankingStore) -> None:
    one = desk(store)
    with ThreadPoolExecutor(14) as threads:
        names = [f"annotator-{number % 14}" for number in range(56)]
        queries = list(threads.map(lambda name: one.next(QueryRequest(name), POOL), names))
    assert len({frozenset(query.episode_ids) for query in queries}) == 56, "8 over 3, each once"
    with pytest.raises(RankingError, match="no query: all 56 combinations of 8 episodes"):
        one.next(QueryRequest("late"), POOL)


def test_a_lease_that_ends_unanswered_frees_its_videos(
    store: RankingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = desk(store, lease_s=1.0).next(QueryRequest("ada"), POOL[:3])
    with pytest.raises(RankingError, match="no query"):
        desk(store).next(QueryRequest("bob"), POOL[:3])
    monkeypatch.setattr("time.time_ns", lambda: lost.expires_ns + 1)
    again = desk(store).next(QueryRequest("bob"), POOL[:3])
    assert set(again.episode_ids) == set(lost.episode_ids)


def test_after_a_reload_the_open_queries_come_back_with_a_new_lease(store: RankingStore) -> None:
    one = desk(store)
    shown, ahead = (one.next(QueryRequest("ada"), POOL) for _ in range(2))
    back = one.next(QueryRequest("ada", resume=True), POOL)
    assert back.query_id == shown.query_id and back.expires_ns > shown.expires_ns
    other = one.next(QueryRequest("ada", resume=True, held={shown.query_id}), POOL)
    assert other.query_id == ahead.query_id
    held = {shown.query_id, ahead.query_id}
    third = one.next(QueryRequest("ada", resume=True, held=held), POOL)
    assert third.query_id not in held
    bobs = one.next(QueryRequest("bob", resume=True), POOL)
    assert bobs.query_id not in {*held, third.query_id}, "nobody gets another's"


def test_a_query_about_a_video_that_is_gone_does_not_come_back(store: RankingStore) -> None:
    one = desk(store)
    shown = one.next(QueryRequest("ada"), POOL)
    left = [video for video in POOL if video != shown.episode_ids[0]]
    back = one.next(QueryRequest("ada", resume=True), left)
    assert back.query_id != shown.query_id and set(back.episode_ids) <= set(left)


def test_what_is_no_longer_asked_about_does_not_come_back(store: RankingStore) -> None:
    one = desk(store)
    shown = one.next(QueryRequest("ada"), POOL)
    resumed = QueryRequest("ada", resume=True)
    others = [video for video in POOL if video not in shown.episode_ids]
    later = one.next(resumed, POOL, about=others)
    assert later.query_id != shown.query_id
    assert one.next(resumed, POOL, about=[]).query_id not in {shown.query_id, later.query_id}
    assert one.next(resumed, POOL, about=shown.episode_ids[:1]).query_id == shown.query_id


def test_a_repeat_is_what_the_same_person_has_answered_and_is_asked_once(
    store: RankingStore,
) -> None:
    one = desk(store)
    with pytest.raises(RankingError, match="nothing to ask 'ada' as repeat"):
        one.next(QueryRequest("ada", purpose="repeat"), POOL)
    first = one.next(QueryRequest("ada"), POOL)
    answer(store, first)
    again = one.next(QueryRequest("ada", purpose="repeat"), POOL)
    assert set(again.episode_ids) == set(first.episode_ids)
    assert (again.purpose, again.strategy) == ("repeat", "repeat")
    answer(store, again, (3, 2, 1))
    with pytest.raises(RankingError, match="nothing to ask 'ada' as repeat"):
        one.next(QueryRequest("ada", purpose="repeat"), POOL)


def test_a_shared_query_is_what_another_person_has_answered(store: RankingStore) -> None:
    one = desk(store)
    first = one.next(QueryRequest("ada"), POOL)
    answer(store, first)
    with pytest.raises(RankingError, match="nothing to ask 'ada' as shared"):
        one.next(QueryRequest("ada", purpose="shared"), POOL)
    for name in ("bob", "cyd"):
        shared = one.next(QueryRequest(name, purpose="shared"), POOL)
        assert set(shared.episode_ids) == set(first.episode_ids) and shared.purpose == "shared"
    with pytest.raises(RankingError, match="nothing to ask 'bob' as shared"):
        one.next(QueryRequest("bob", purpose="shared"), POOL)


def test_shares_are_kept_and_new_videos_are_asked_where_there_is_nothing_old(
    store: RankingStore,
) -> None:
    pool = [f"v{number}" for number in range(60)]
    one = desk(store, repeat_share=0.3, shared_share=0.3, seed=5)
    purposes = []
    for number in range(120):
        query = one.next(QueryRequest(f"annotator-{number % 4}"), pool)
        answer(store, query)
        purposes.append(query.purpose)
    assert purposes[0] == "new", "there was nothing to repeat"
    assert 20 <= purposes.count("repeat") <= 50 and 20 <= purposes.count("shared") <= 50


def test_videos_are_shown_in_an_order_that_says_nothing(store: RankingStore) -> None:
    pool = [f"v{number:02d}" for number in range(60)]
    one = desk(store)
    queries = [one.next(QueryRequest("ada"), pool) for _ in range(90)]
    ascending = sum(list(q.episode_ids) == sorted(q.episode_ids) for q in queries)
    assert 4 <= ascending <= 30, "one in six by chance"


def test_sizes_and_words_that_are_not_known_are_refused(store: RankingStore) -> None:
    pair = desk(store).next(QueryRequest("ada", size=2), POOL)
    assert len(pair.episode_ids) == 2
    with pytest.raises(RankingError, match="a query of 11 videos, expected 2 to 10"):
        QueryRequest("ada", size=11)
    with pytest.raises(UnknownNameError, match="purpose of a query 'fun'; known: new, repeat"):
        QueryRequest("ada", purpose="fun")
    with pytest.raises(ShapeError, match="together more than 1"):
        DeskConfig(repeat_share=0.6, shared_share=0.6)
    with pytest.raises(RankingError, match="annotator has more than 64"):
        desk(store).next(QueryRequest("a" * 65), POOL)
