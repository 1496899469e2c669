"""Rewards of the oracle, scales, evaluations and curve files."""

import math
from pathlib import Path

import numpy as np
import pytest

from rapl_core.errors import CorruptFileError, RaplError, ShapeError
from rapl_core.policies import (
    CheckpointFolder,
    CurvePoint,
    EpisodeOutcome,
    GroundTruthReward,
    LearningCurve,
    Part,
    fit_scale,
    summarise_evaluation,
)
from rapl_core.representations.reward_scale import fit_reward_scale
from rapl_core.types import Episode, RewardTrace


def episode(human_rewards: list[float] | None) -> Episode:
    return Episode(
        "e",
        "t",
        0,
        "train",
        "c",
        np.zeros((4, 1, 1, 3), dtype=np.uint8),
        np.zeros((4, 2)),
        np.zeros((3, 1)),
        np.arange(4),
        None if human_rewards is None else np.array(human_rewards),
    )


def test_ground_truth_is_the_scaled_reward_of_the_states_arrived_in() -> None:
    reward = GroundTruthReward(2.0)
    assert reward(episode([9.0, -1.0, -2.0, -3.0])).tolist() == [-2.0, -4.0, -6.0]
    assert reward.source.name == "ground_truth" and reward.source.scale == 2.0
    with pytest.raises(ShapeError, match="episode e has no human rewards"):
        reward(episode(None))


def test_the_scale_follows_the_rule_of_the_encoders() -> None:
    rng = np.random.default_rng(0)
    unscaled = {f"v{i}": -rng.uniform(0, 1e-3 * (i + 1), 50) for i in range(9)}

    def trace(embedding: np.ndarray) -> RewardTrace:
        return RewardTrace(embedding[:, 0].astype(np.float64), "", 0.0, True, 0, 0.0, 1.0)

    embeddings = {name: values[:, None].astype(np.float32) for name, values in unscaled.items()}
    scale = fit_scale(unscaled.values())
    assert scale == pytest.approx(fit_reward_scale(embeddings, trace, rng), rel=1e-5)
    worse = sorted(values.mean() for values in unscaled.values())[:4]
    assert scale * np.mean(worse) == pytest.approx(-2.0)
    for bad in ([], [np.zeros(5)], [np.ones(5)]):
        with pytest.raises(ShapeError, match="expected below 0"):
            fit_scale(bad)


def outcome(number: int, world: int, success: bool | None, value: float) -> EpisodeOutcome:
    return EpisodeOutcome(f"w{world}-{number}", number, world, success, value, math.nan)


def test_an_evaluation_counts_the_first_episodes_in_order() -> None:
    outcomes = [
        outcome(1, 1, True, -100.0),  # one too many
        outcome(1, 0, True, -1.0),
        outcome(0, 1, False, -2.0),
        outcome(0, 0, True, -3.0),
    ]
    evaluation = summarise_evaluation(outcomes, 3)
    assert evaluation.episode_ids == ("w0-0", "w1-0", "w0-1")
    assert evaluation.success_rate == pytest.approx(2 / 3)
    assert evaluation.human_return_mean == pytest.approx(-2.0)
    assert math.isnan(evaluation.reward_mean)


def test_success_is_unknown_where_the_truth_is() -> None:
    evaluation = summarise_evaluation([outcome(0, 0, None, math.nan)], 1)
    assert math.isnan(evaluation.success_rate) and math.isnan(evaluation.human_return_mean)


@pytest.mark.parametrize("name", ["curve.json", "curve.csv"])
def test_a_curve_comes_back_from_its_file(tmp_path: Path, name: str) -> None:
    points = [CurvePoint(k * 5000, k / 10, -20.5, math.nan, 50, 1.5 * k) for k in range(1, 5)]
    curve = LearningCurve(tuple(points))
    curve.save(tmp_path / name)
    assert repr(LearningCurve.load(tmp_path / name)) == repr(curve)
    assert curve.last(3) == pytest.approx(0.3)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_bad_curves_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RaplError, match="0 evaluations, expected 3"):
        LearningCurve().last()
    with pytest.raises(RaplError, match="not curve.txt"):
        LearningCurve().save(tmp_path / "curve.txt")
    with pytest.raises(RaplError, match="cannot write the curve /proc/self/curve.json"):
        LearningCurve().save("/proc/self/curve.json")
    (tmp_path / "curve.json").write_text('{"points": [{"steps": 1}]}')
    with pytest.raises(CorruptFileError, match="curve.json"):
        LearningCurve.load(tmp_path / "curve.json")


def test_only_the_newest_checkpoints_are_kept(tmp_path: Path) -> None:
    folder = CheckpointFolder(tmp_path / "policies", keep=2)
    assert folder.latest() is None
    for steps in (100, 2000, 30000):
        folder.save(steps, {"x": Part(arrays={"a": np.arange(3)}, values={"steps": steps})})
    assert [p.name for p in folder.all()] == ["000002000", "000030000"]
    (folder.folder / ".writing-x").mkdir()
    (folder.folder / "000040000").mkdir()  # no card: never completed
    assert folder.latest() == folder.folder / "000030000"
