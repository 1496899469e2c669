"""The measures against hand-made cases and scipy."""

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import kendalltau, spearmanr

from rapl_core.analysis import measures
from rapl_core.analysis.measures import (
    gain_share,
    partial_spearman_given_time,
    spearman_per_step,
    video_mix,
    wishes,
)
from rapl_core.errors import ShapeError


@given(
    arrays(np.float64, 20, elements=st.integers(-5, 5)),
    arrays(np.float64, 20, elements=st.integers(-5, 5)),
)
def test_spearman_equals_scipy_with_ties(x: np.ndarray, y: np.ndarray) -> None:
    mine = measures.spearman(x, y)
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        assert np.isnan(mine)
    else:
        assert mine == pytest.approx(spearmanr(x, y).statistic, abs=1e-12)


def test_videos_with_a_constant_trace_are_counted_and_left_out_of_the_mean() -> None:
    rising, flat = [1.0, 2.0, 3.0], [1.0, 1.0, 1.0]
    result = measures.spearman_per_step([rising, rising, flat], [rising, flat, rising])
    assert result.mean == pytest.approx(1.0)
    assert result.undefined == 2
    assert np.isnan(measures.spearman_per_step([flat], [rising]).mean)


def test_concordance_without_a_gap_is_kendalls_tau_on_distinct_values() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=30), rng.normal(size=30)
    result = measures.concordance([x], [y], gap=0.0)
    assert result.value == pytest.approx(kendalltau(x, y).statistic)
    assert result.pairs == 30 * 29 // 2


def test_concordance_does_not_ask_about_frames_closer_than_the_gap() -> None:
    human = [0.0, 0.019, 0.1]
    # wrong only between the first two frames, which are 19 mm apart
    assert measures.concordance([[1.0, 0.0, 2.0]], [human]).value == 1.0
    assert measures.concordance([[1.0, 0.0, 2.0]], [human]).pairs == 2
    assert measures.concordance([[2.0, 1.0, 0.0]], [human]).value == -1.0
    assert np.isnan(measures.concordance([[1.0, 2.0]], [[0.0, 0.0]]).value)


def test_episode_rank_correlation_compares_sums() -> None:
    rewards = [[0.0, 1.0], [5.0, 5.0], [2.0, 2.0]]
    assert measures.episode_rank_correlation(rewards, [[1.0], [3.0], [2.0]]) == pytest.approx(1.0)
    assert measures.episode_rank_correlation(rewards, [[3.0], [1.0], [2.0]]) == pytest.approx(-1.0)


def test_arm_only_share_is_the_mimes_gain_over_the_experts() -> None:
    expert = np.linspace(-5.0, -1.0, 20)
    flat = np.full(20, -5.0)
    assert measures.arm_only_share([expert], [flat]) == pytest.approx(0.0)
    assert measures.arm_only_share([expert, expert], [expert]) == pytest.approx(1.0)
    half = np.linspace(-5.0, -3.0, 20)
    assert measures.arm_only_share([expert], [half]) == pytest.approx(0.5)
    assert np.isnan(measures.arm_only_share([flat], [expert]))
    assert np.isnan(measures.arm_only_share([], [expert]))


def test_triplet_accuracy_counts_ordered_pairs_and_skips_unknown_videos() -> None:
    returns = {"a": 3.0, "b": 2.0, "c": 1.0}
    assert measures.triplet_accuracy(returns, [("a", "b", "c")]) == 1.0
    assert measures.triplet_accuracy(returns, [("b", "a", "c")]) == pytest.approx(2 / 3)
    assert measures.triplet_accuracy(returns, [("a", "b", "gone"), ("a", "b", "c")]) == 1.0
    assert np.isnan(measures.triplet_accuracy(returns, []))


def test_traces_of_unequal_length_are_refused() -> None:
    with pytest.raises(ShapeError, match="expected two equal"):
        measures.spearman_per_step([[1.0, 2.0]], [[1.0, 2.0, 3.0]])
    with pytest.raises(ShapeError, match="NaN"):
        measures.concordance([[1.0, float("nan")]], [[1.0, 2.0]])


def test_what_is_left_without_the_clock() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(40.0)
    felt = [time + 6 * rng.normal(size=40) for _ in range(30)]
    clock = partial_spearman_given_time([time + 1e-9 * rng.normal(size=40) for _ in felt], felt)
    assert clock.undefined == 30  # a clock has nothing left
    noise = [time + 6 * rng.normal(size=40) for _ in felt]
    assert spearman_per_step(noise, felt).mean > 0.6
    assert abs(partial_spearman_given_time(noise, felt).mean) < 0.1
    assert partial_spearman_given_time(felt, felt).mean == pytest.approx(1.0)


def test_partial_correlation_is_that_of_the_residuals_of_ranks() -> None:
    rng = np.random.default_rng(1)
    x, y, t = rng.permutation(25).astype(float), rng.permutation(25).astype(float), np.arange(25.0)

    def residual(values: np.ndarray) -> np.ndarray:
        return values - np.polyval(np.polyfit(t, values, 1), t)

    expected = np.corrcoef(residual(x), residual(y))[0, 1]
    assert partial_spearman_given_time([x], [y]).mean == pytest.approx(expected)


def test_shares_of_gain_and_the_mix_of_videos() -> None:
    whole = [np.linspace(0, 10, 20)]
    assert gain_share(whole, [np.linspace(3, 8, 20)]) == pytest.approx(0.5)
    assert np.isnan(gain_share([np.zeros(20)], whole)) and np.isnan(gain_share(whole, []))
    assert video_mix(["b", "a", "b"]) == {"a": 1, "b": 2}


def test_a_landscape_gives_one_number_a_wish_in_shares_of_its_range() -> None:
    way = np.array([0.0, 2.0, 1.0, 3.0, 4.0])
    found = wishes(way, [0, 1, 2], [4.0, 1.0], [0.0, 0.4])
    assert found.rise == pytest.approx(0.9) and found.pit == pytest.approx(0.25)
    assert (found.over_alone, found.gap) == (0.5, 0.75) and found.arm == pytest.approx(0.1)
    larger = wishes(10 * way - 7, [-7, 3, 13], [33.0, 3.0], [-7.0, -3.0])
    assert astuple(larger) == pytest.approx(astuple(found))
    wrong = wishes([1.0, 0.0], [1.0], [0.0, 1.0], [1.0, 1.0])  # being done earns less than rest
    assert (wrong.rise, wrong.over_alone, wrong.gap) == pytest.approx((-1.0, -1.0, -1.0))
    assert np.isnan(wishes([2.0, 2.0], [2.0], [2.0], [2.0]).arm)


def test_agreement_is_the_measures_of_the_same_videos() -> None:
    rewards, human = [[0.0, 1.0, 2.0], [1.0, 1.0, 1.0]], [[0.0, 0.1, 0.2], [0.0, 0.1, 0.2]]
    found = measures.agreement(rewards, human)
    assert (found.videos, found.step, found.step_undefined) == (2, pytest.approx(1.0), 1)
    assert found.concordance == measures.concordance(rewards, human).value
    assert np.isnan(found.episode)  # both videos have the same sum of r*
