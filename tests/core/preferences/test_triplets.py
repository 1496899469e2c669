"""Triplets, pairs and splits say what the rankings said and nothing else."""

from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rapl_core.errors import RankingError
from rapl_core.preferences import pairs_from, split_rankings, triplets_from
from rapl_core.types import Ranking, Triplet


def ranked(ranks: tuple[int, ...], ranking_id: str = "r", prefix: str = "e") -> Ranking:
    ids = tuple(f"{prefix}{i}" for i in range(len(ranks)))
    return Ranking(ranking_id, "ada", ids, ranks)


def test_a_ranking_of_three_gives_one_triplet_in_order() -> None:
    assert triplets_from([ranked((2, 3, 1))]) == [Triplet(best="e2", middle="e0", worst="e1")]


def test_a_tie_gives_no_triplet_but_pairs() -> None:
    ranking = ranked((1, 2, 2))
    assert triplets_from([ranking]) == []
    pairs = pairs_from([ranking])
    assert [(p.better, p.worse, p.tie) for p in pairs] == [
        ("e0", "e1", False),
        ("e0", "e2", False),
        ("e1", "e2", True),
    ]


def test_undecided_and_skipped_rankings_give_nothing() -> None:
    ranking = Ranking("r", "ada", ("a", "b", "c"), (), verdict="skipped")
    assert triplets_from([ranking]) == []
    assert pairs_from([ranking]) == []


@given(st.permutations(range(1, 7)))
def test_a_strict_ranking_of_six_gives_all_triples_in_order(ranks: list[int]) -> None:
    triplets = triplets_from([ranked(tuple(ranks))])
    rank = {f"e{i}": r for i, r in enumerate(ranks)}
    assert len(triplets) == comb(6, 3) == len(set(triplets))
    assert all(rank[t.best] < rank[t.middle] < rank[t.worst] for t in triplets)


@given(st.lists(st.integers(1, 5), min_size=5, max_size=5).filter(lambda r: 1 in r))
def test_triplets_are_strict_whatever_the_ties(ranks: list[int]) -> None:
    rank = {f"e{i}": r for i, r in enumerate(ranks)}
    for triplet in triplets_from([ranked(tuple(ranks))]):
        assert rank[triplet.best] < rank[triplet.middle] < rank[triplet.worst]


def test_a_split_loses_nothing_and_follows_from_its_seed() -> None:
    rankings = [ranked((1, 2, 3), f"r{i}") for i in range(50)]
    first = split_rankings(rankings, 0.2, np.random.default_rng(3))
    again = split_rankings(rankings, 0.2, np.random.default_rng(3))
    other = split_rankings(rankings, 0.2, np.random.default_rng(4))
    assert len(first.held_out) == 10
    assert set(first.train) | set(first.held_out) == set(rankings)
    assert first == again != other


def test_a_split_with_disjoint_videos_shares_none() -> None:
    rng = np.random.default_rng(0)
    rankings = [
        Ranking(
            f"r{i}", "ada", tuple(f"e{j}" for j in rng.choice(200, 3, replace=False)), (1, 2, 3)
        )
        for i in range(100)
    ]
    split = split_rankings(rankings, 0.1, rng, disjoint_videos=True)
    tested = {e for r in split.held_out for e in r.episode_ids}
    assert split.train
    assert tested.isdisjoint(e for r in split.train for e in r.episode_ids)
    assert all(not tested.isdisjoint(r.episode_ids) for r in split.dropped)
    assert len(split.train) + len(split.held_out) + len(split.dropped) == 100


def test_a_split_that_leaves_nothing_is_refused() -> None:
    rankings = [ranked((1, 2, 3), f"r{i}") for i in range(4)]
    with pytest.raises(RankingError, match="0 <= share < 1"):
        split_rankings(rankings, 1.0, np.random.default_rng(0))
    with pytest.raises(RankingError, match="cannot hold out 1 of 1"):
        split_rankings(rankings[:1], 0.5, np.random.default_rng(0))
    with pytest.raises(RankingError, match="shares a video"):
        split_rankings(rankings, 0.3, np.random.default_rng(0), disjoint_videos=True)
