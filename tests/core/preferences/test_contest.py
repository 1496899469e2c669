"""The contest: uniform at first, then the strongest among themselves."""

import numpy as np
import pytest

from rapl_core.errors import RankingError
from rapl_core.preferences import ContestQueries, SimulatedHuman, expert_set, strengths
from rapl_core.types import Ranking

WANTED = 60
RETURNS = {f"v{i:02d}": float(i) for i in range(80)}


def ask(wanted: int, count: int, seed: int = 0) -> tuple[list[Ranking], list[str]]:
    """Rankings of a simulated human, and the strategy of each query."""
    rng = np.random.default_rng(seed)
    human = SimulatedHuman(rng)
    rankings: list[Ranking] = []
    names = []
    for number in range(count):
        queries = ContestQueries(rng, rankings, wanted)
        shown = queries.next(list(RETURNS), [r.episode_ids for r in rankings])
        ranks = human.rank([RETURNS[video] for video in shown])
        rankings.append(Ranking(f"r{number}", "ada", shown, ranks))
        names.append(queries.name)
    return rankings, names


def test_it_begins_uniformly_and_then_shows_the_strongest_alone() -> None:
    rankings, names = ask(WANTED, WANTED)
    assert names == ["uniform"] * 36 + ["contest"] * 24
    for number in range(36, WANTED):
        strength = strengths(rankings[:number])
        field = 30 if number < 48 else 15
        strongest = sorted(strength, key=lambda video: (-strength[video], video))[:field]
        assert set(rankings[number].episode_ids) <= set(strongest)


def test_every_competitor_gets_its_turn_and_no_query_comes_twice() -> None:
    rankings, _ = ask(WANTED, WANTED)
    assert len({frozenset(r.episode_ids) for r in rankings}) == WANTED
    turns = [video for r in rankings[48:] for video in r.episode_ids]
    assert len(set(turns)) >= 12  # of the fifteen, which change as strengths do


def test_the_expert_set_is_better_than_after_uniform_asking() -> None:
    def worth(wanted: int, seed: int) -> float:
        rankings, _ = ask(wanted, WANTED, seed)
        return float(np.mean([RETURNS[video] for video in expert_set(rankings, 10)]))

    gains = [worth(WANTED, seed) - worth(0, seed) for seed in range(8)]
    assert np.mean(gains) > 2 * np.std(gains, ddof=1) / np.sqrt(len(gains))


def test_without_a_number_wanted_or_rankings_every_query_is_uniform() -> None:
    assert set(ask(0, 30)[1]) == {"uniform"}
    skipped = Ranking("r", "ada", ("v00", "v01", "v02"), (), verdict="skipped")
    queries = ContestQueries(np.random.default_rng(0), [skipped] * WANTED, WANTED)
    queries.next(list(RETURNS))
    assert queries.name == "uniform"


def test_videos_that_are_gone_do_not_compete() -> None:
    rankings, _ = ask(WANTED, 40)
    best = expert_set(rankings, 10)
    left = [video for video in RETURNS if video not in best]
    queries = ContestQueries(np.random.default_rng(0), rankings, WANTED)
    assert not set(queries.next(left)) & set(best)
    with pytest.raises(RankingError, match="no query: 2 of 3 episodes"):
        queries.next(left[:2])
