"""Strategies ask about what is not known, never the same twice, and learn faster than chance."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
import pytest
from scipy.stats import spearmanr
from videos import asked, made_videos

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.preferences import SimulatedHuman, UniformQueries
from rapl_core.preferences.answers import (
    LinearAnswers,
    disagreement,
    information,
    plackett_luce,
)
from rapl_core.preferences.strategies import BATCH, LEARNING, STRATEGIES, make_selector
from rapl_core.preferences.utility import comparisons, fit_utility
from rapl_core.preferences.video_features import VideoFeatures, summarise
from rapl_core.types import Ranking


def no_model(_: Sequence[Ranking]) -> None:
    return None


def test_plackett_luce_sums_to_one_over_all_orders() -> None:
    u = np.array([0.3, -1.0, 2.0])
    orders = np.array([u[list(order)] for order in permutations(range(3))])
    p = plackett_luce(orders)
    assert p.sum() == pytest.approx(1.0)
    first = np.exp(u[2]) / np.exp(u).sum()
    assert p[list(permutations(range(3))).index((2, 0, 1))] == pytest.approx(
        first * np.exp(u[0]) / (np.exp(u[0]) + np.exp(u[1]))
    )


def test_information_is_nothing_where_all_agree_and_most_where_they_are_sure_and_differ() -> None:
    sure = np.array([[[1.0, 0.0]], [[1.0, 0.0]]])  # (K, C, 2)
    split = np.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    unsure = np.full((2, 1, 2), 0.5)
    assert information(sure)[0] == pytest.approx(0.0)
    assert information(unsure)[0] == pytest.approx(0.0), "an even answer teaches nothing"
    assert information(split)[0] == pytest.approx(np.log(2))
    assert disagreement(split)[0] == pytest.approx(0.25)
    assert disagreement(unsure)[0] == pytest.approx(0.0)


def test_the_ensemble_narrows_as_answers_come() -> None:
    rng = np.random.default_rng(0)
    features, returns = made_videos(60, rng)
    x = summarise(features)
    candidates = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    scores = []
    for count in (0, 20, 200):
        utility = fit_utility(comparisons(x, asked(returns, count, rng)), x.values.shape[1])
        orders = LinearAnswers(utility, x, np.random.default_rng(1), members=100).orders(candidates)
        assert orders.shape == (100, 3, 6) and np.allclose(orders.sum(-1), 1)
        scores.append(float(information(orders).mean()))
    assert scores[0] > scores[1] > scores[2]


@pytest.mark.parametrize("strategy", ["uncertainty", "information", "coverage"])
def test_a_strategy_never_asks_twice_and_outlasts_its_batch(strategy: str) -> None:
    rng = np.random.default_rng(3)
    features, returns = made_videos(40, rng)
    selector = make_selector(strategy, rng, summarise(features), no_model)
    selector.update([], [])
    queries: list[tuple[str, ...]] = []
    for _ in range(3 * BATCH):
        queries.append(selector.next(sorted(returns), queries))
    assert len({frozenset(query) for query in queries}) == 3 * BATCH
    assert all(len(set(query)) == 3 for query in queries)


def test_coverage_shows_the_corners_first_and_every_video_before_any_twice() -> None:
    corners = [(10.0, 0.0), (-10.0, 0.0), (0.0, 10.0)]
    values = np.array([*corners, *np.random.default_rng(0).normal(size=(6, 2))])
    names = tuple(f"v{number}" for number in range(9))
    rng = np.random.default_rng(0)
    selector = make_selector("coverage", rng, VideoFeatures(names, values), no_model)
    queries: list[tuple[str, ...]] = []
    for _ in range(3):
        queries.append(selector.next(names, queries))
    assert {"v0", "v1", "v2"} & set(queries[0]) and len({v for q in queries for v in q}) == 9
    assert {"v0", "v1", "v2"} <= {*queries[0], *queries[1]}


def test_choosing_queries_learns_faster_than_chance() -> None:
    """Mean rank correlation of the learnt utility over four made worlds, after 24 answers."""
    found = {}
    for strategy in ("uniform", "information", "uncertainty"):
        scores = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            features, returns = made_videos(120, rng, width=24)
            x, human = summarise(features), SimulatedHuman(rng)
            queries: list[tuple[str, ...]] = []
            rankings: list[Ranking] = []
            for number in range(24):
                if strategy == "uniform":
                    selector = UniformQueries(rng)
                elif number % 6 == 0:
                    selector = make_selector(strategy, rng, x, no_model)
                    selector.update(rankings, queries)
                queries.append(selector.next(list(returns), queries))
                ranks = human.rank([returns[name] for name in queries[-1]])
                rankings.append(Ranking(str(number), "ada", queries[-1], ranks))
            utility = fit_utility(comparisons(x, rankings), x.values.shape[1])
            truth = [returns[name] for name in x.episode_ids]
            scores.append(spearmanr(x.values @ utility.weights, truth).statistic)
        found[strategy] = float(np.mean(scores))
    assert found["information"] > found["uniform"] and found["uncertainty"] > found["uniform"]


def test_unknown_strategies_and_sizes_are_refused_by_name() -> None:
    rng = np.random.default_rng(0)
    x = summarise(made_videos(5, rng)[0])
    with pytest.raises(UnknownNameError, match="'telepathy'; known: coverage"):
        make_selector("telepathy", rng, x, no_model)
    with pytest.raises(RankingError, match="asks about three videos, not 4"):
        make_selector("transport", rng, x, no_model, size=4)
    with pytest.raises(RankingError, match="no query: 5 of 6 episodes"):
        make_selector("information", rng, x, no_model, size=6).update([])
    assert set(LEARNING) == {"uncertainty", "information", "coverage", "transport"}
    assert set(STRATEGIES) == {"uniform", "contest", *LEARNING}
