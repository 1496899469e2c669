"""Who is asked about what, and what the simulated human says."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest

from rapl_core.errors import RankingError
from rapl_core.preferences import SimulatedHuman, UniformQueries

RETURNS = [-3.0, -1.0, -2.0]


def human(**knobs: float) -> SimulatedHuman:
    return SimulatedHuman(np.random.default_rng(0), **knobs)


def test_every_triple_is_about_equally_likely_in_every_order() -> None:
    queries = UniformQueries(np.random.default_rng(0))
    counts = Counter(queries.next("abcd") for _ in range(4800))
    assert len(counts) == 24
    assert min(counts.values()) > 130 and max(counts.values()) < 280  # 200 expected


def test_nothing_is_asked_twice_until_nothing_is_left() -> None:
    queries = UniformQueries(np.random.default_rng(0))
    asked: list[tuple[str, ...]] = []
    for _ in range(10):
        asked.append(queries.next("abcde", asked))
    assert {frozenset(q) for q in asked} == {frozenset(c) for c in combinations("abcde", 3)}
    with pytest.raises(RankingError, match="all 10 combinations"):
        queries.next("abcde", asked)


def test_queries_follow_from_the_seed_whatever_the_order_of_episodes() -> None:
    one = UniformQueries(np.random.default_rng(5))
    two = UniformQueries(np.random.default_rng(5))
    assert [one.next("abcdef") for _ in range(5)] == [two.next("fedcba") for _ in range(5)]


def test_too_few_episodes_are_refused() -> None:
    with pytest.raises(RankingError, match="no query: 2 of 3 episodes recorded"):
        UniformQueries(np.random.default_rng(0)).next(["a", "b"])


def test_without_options_the_ranking_is_the_true_one() -> None:
    assert human().rank(RETURNS) == (3, 1, 2)
    assert human().rank([1.0, 1.0, 0.0]) == (1, 1, 3)


def test_returns_closer_than_the_threshold_tie() -> None:
    assert human(equal_threshold=0.5).rank([0.0, -0.4, -0.8]) == (1, 1, 3)
    assert human(equal_threshold=2.0).rank(RETURNS) == (1, 1, 1)


def test_rationality_sets_how_often_the_better_of_two_wins() -> None:
    noisy = human(beta=2.0)
    wins = np.mean([noisy.rank([0.5, 0.0])[0] == 1 for _ in range(4000)])
    assert wins == pytest.approx(1 / (1 + np.exp(-1.0)), abs=0.025)


def test_mistakes_and_skips_happen_as_often_as_asked() -> None:
    clumsy = human(mistakes=0.3)
    wrong = np.mean([clumsy.rank(RETURNS) != (3, 1, 2) for _ in range(3000)])
    assert wrong == pytest.approx(0.3, abs=0.03)
    shy = human(skip=0.25)
    answers = [shy.answer(RETURNS) for _ in range(3000)]
    assert np.mean([a.verdict == "skipped" for a in answers]) == pytest.approx(0.25, abs=0.03)
    assert {a.ranks for a in answers} == {(), (3, 1, 2)}


def test_unknown_truth_and_bad_options_are_refused() -> None:
    with pytest.raises(RankingError, match="truth is unknown"):
        human().rank([0.0, float("nan")])
    with pytest.raises(RankingError, match="mistakes is 2"):
        human(mistakes=2)
    with pytest.raises(RankingError, match="beta is 0"):
        human(beta=0)
