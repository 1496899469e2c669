"""The most preferred videos are found from the rankings alone."""

import numpy as np
import pytest
from scipy.optimize import minimize

from rapl_core.errors import RankingError
from rapl_core.preferences import (
    SimulatedHuman,
    UniformQueries,
    expert_set,
    pairs_from,
    strengths,
)
from rapl_core.types import Ranking


def rankings_of(truth: dict[str, float], count: int, seed: int = 0) -> list[Ranking]:
    rng = np.random.default_rng(seed)
    queries, human = UniformQueries(rng), SimulatedHuman(rng)
    asked = [queries.next(list(truth)) for _ in range(count)]
    return [
        Ranking(f"r{i}", "ada", ids, human.rank([truth[e] for e in ids]))
        for i, ids in enumerate(asked)
    ]


def test_strengths_are_the_optimum_that_a_general_optimiser_finds() -> None:
    rng = np.random.default_rng(1)
    rankings = rankings_of({f"e{i}": float(rng.normal()) for i in range(12)}, 20)
    rankings.append(Ranking("tie", "ada", ("e0", "e1", "e2"), (1, 1, 3)))
    videos = sorted({e for r in rankings for e in r.episode_ids})
    at = {video: i for i, video in enumerate(videos)}

    def loss(s: np.ndarray) -> float:
        total = (s**2).sum() / (2 * 0.7**2)
        for pair in pairs_from(rankings):
            gap = s[at[pair.better]] - s[at[pair.worse]]
            if pair.tie:
                total += 0.5 * (np.logaddexp(0, -gap) + np.logaddexp(0, gap))
            else:
                total += np.logaddexp(0, -gap)
        return float(total)

    found = minimize(loss, np.zeros(len(videos)), tol=1e-12).x
    ours = strengths(rankings, prior_deviation=0.7)
    assert [ours[v] for v in videos] == pytest.approx(found - found.mean(), abs=1e-5)


def test_a_video_seen_once_does_not_outrank_one_preferred_often() -> None:
    rankings = [Ranking("once", "ada", ("new", "poor"), (1, 2))]
    for number in range(5):
        rankings.append(Ranking(f"r{number}", "ada", ("good", f"o{number}", "poor"), (1, 2, 3)))
    strength = strengths(rankings)
    assert strength["good"] > strength["new"] > strength["poor"]
    assert np.isfinite(list(strength.values())).all()


def test_the_set_from_150_triplets_is_well_above_the_average_video() -> None:
    rng = np.random.default_rng(2)
    truth = {f"e{i:03d}": float(rng.normal()) for i in range(300)}
    chosen = expert_set(rankings_of(truth, 150), size=10)
    assert len(set(chosen)) == 10
    assert np.mean([truth[e] for e in chosen]) > 1.0  # standard deviations


def test_the_set_does_not_depend_on_the_order_of_the_rankings() -> None:
    rankings = rankings_of({f"e{i}": float(i) for i in range(30)}, 40)
    assert expert_set(rankings) == expert_set(rankings[::-1])


def test_everything_ranked_often_gives_the_true_order() -> None:
    truth = {f"e{i:02d}": float(-i) for i in range(8)}
    rankings = rankings_of(truth, 400)
    assert expert_set(rankings, size=8) == sorted(truth, key=lambda e: -truth[e])


def test_too_few_ranked_videos_are_refused() -> None:
    with pytest.raises(RankingError, match="10 videos cannot be chosen from 3"):
        expert_set([Ranking("r", "ada", ("a", "b", "c"), (1, 2, 3))])


def test_no_ranking_gives_no_strength() -> None:
    assert strengths([]) == {}
