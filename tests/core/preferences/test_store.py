"""The ranking store: nothing is lost, nothing is stored twice, bad input is refused by name."""

from pathlib import Path

import pytest
from rankings import ranking

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.preferences import RankingStore


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


def test_a_closed_store_says_so(store: RankingStore) -> None:
    store.close()
    with pytest.raises(RankingError, match="is closed"):
        store.count()
