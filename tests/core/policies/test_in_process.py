"""Learning on the real world, without ROS: it follows from its seed, resumed or not."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from rapl_core.errors import CorruptFileError
from rapl_core.policies import (
    CheckpointFolder,
    GroundTruthReward,
    LearningCurve,
    SacConfig,
    ScheduleConfig,
    read_checkpoint,
)
from rapl_core.policies.in_process import LearningEvent, Revision, train_in_process
from rapl_core.policies.rollout import Rollout
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import Episode

TASK = "franka_group"
HORIZON = get_task(TASK).horizon
SAC = SacConfig(hidden=(16, 16), batch_size=32)
ROUND = 2 * HORIZON
SCHEDULE = ScheduleConfig(
    steps=6 * ROUND,
    worlds=2,
    random_steps=ROUND,
    block_steps=50,
    train_ratio=0.25,
    evaluate_every=3 * ROUND,
    evaluate_episodes=3,
    checkpoint_every=3 * ROUND,
)
REWARD = GroundTruthReward(3.0)


def learn(
    folder: Path | None = None, schedule: ScheduleConfig = SCHEDULE, **options: object
) -> tuple[LearningCurve, list[LearningEvent]]:
    events: list[LearningEvent] = []
    curve = train_in_process(
        TASK, REWARD, SAC, schedule, 5, folder, on_event=events.append, **options
    )  # type: ignore[arg-type]
    return curve, events


def outcomes(curve: LearningCurve) -> list[tuple[object, ...]]:
    """Everything but the wall time."""
    return [(p.steps, p.success_rate, p.human_return_mean, p.episodes) for p in curve.points]


def actions(events: list[LearningEvent]) -> list[np.ndarray]:
    return [episode.actions for event in events for episode in event.episodes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LearningCurve, list]:
    folder = tmp_path_factory.mktemp("whole")
    return folder, *learn(folder)


def test_gradient_steps_evaluations_and_files_are_as_scheduled(
    whole: tuple[Path, LearningCurve, list[LearningEvent]],
) -> None:
    folder, curve, events = whole
    assert [p.steps for p in curve.points] == [3 * ROUND, 6 * ROUND]
    assert all(p.episodes == 3 and p.human_return_mean < 0 for p in curve.points)
    assert [e.steps for e in events] == [ROUND * k for k in range(1, 7)]
    assert 0.25 * 5 * ROUND - 50 <= events[-1].updates <= 0.25 * 5 * ROUND
    for name in ("curve.json", "curve.csv"):  # by their text: NaN is not equal to NaN
        assert repr(LearningCurve.load(folder / name)) == repr(curve)
    assert len(list((folder / "checkpoints").iterdir())) == 2


def test_tensorboard_finds_the_familiar_names(
    whole: tuple[Path, LearningCurve, list[LearningEvent]],
) -> None:
    folder, curve, _ = whole
    log = EventAccumulator(str(folder / "metrics"))
    log.Reload()
    assert {
        "rollout/ep_rew_mean",
        "rollout/ep_len_mean",
        "train/actor_loss",
        "train/critic_loss",
        "train/ent_coef",
        "eval/success_rate",
        "time/fps",
    } <= set(log.Tags()["scalars"])
    assert [s.step for s in log.Scalars("eval/success_rate")] == [p.steps for p in curve.points]


def test_a_run_follows_from_its_seed_with_or_without_a_thread_for_gradient_steps(
    whole: tuple[Path, LearningCurve, list[LearningEvent]],
) -> None:
    _, curve, events = whole
    again, repeated = learn(background=True)
    assert outcomes(again) == outcomes(curve)
    for one, other in zip(actions(events), actions(repeated), strict=True):
        assert np.array_equal(one, other)


def test_a_resumed_run_equals_one_that_was_never_stopped(
    whole: tuple[Path, LearningCurve, list[LearningEvent]], tmp_path: Path
) -> None:
    folder, curve, events = whole
    begun, first = learn(tmp_path, replace(SCHEDULE, steps=3 * ROUND))
    assert len(begun.points) == 1
    resumed, second = learn(tmp_path, resume=True)
    assert outcomes(resumed) == outcomes(curve)
    for one, other in zip(actions(events), actions(first + second), strict=True):
        assert np.array_equal(one, other)
    newest = f"{6 * ROUND:09d}"
    mine = read_checkpoint(tmp_path / "checkpoints" / newest)
    theirs = read_checkpoint(folder / "checkpoints" / newest)
    for part in ("trainer", "stager"):
        assert mine[part].arrays.keys() == theirs[part].arrays.keys()
        for name, array in mine[part].arrays.items():
            assert np.array_equal(array, theirs[part].arrays[name]), name


def test_a_checkpoint_of_another_run_is_refused(
    whole: tuple[Path, LearningCurve, list[LearningEvent]],
) -> None:
    folder = whole[0]
    with pytest.raises(CorruptFileError, match="is of seed 5, expected 6"):
        train_in_process(TASK, REWARD, SAC, SCHEDULE, 6, folder, resume=True)
    with pytest.raises(CorruptFileError, match=r"scale=3.0\), expected .*scale=4.0"):
        train_in_process(TASK, GroundTruthReward(4.0), SAC, SCHEDULE, 5, folder, resume=True)
    with pytest.raises(CorruptFileError, match="another schedule: train_ratio: 0.25 != 0.5"):
        learn(folder, replace(SCHEDULE, train_ratio=0.5), resume=True)
    with pytest.raises(CorruptFileError, match="another config: discount"):
        train_in_process(TASK, REWARD, replace(SAC, discount=0.5), SCHEDULE, 5, folder, resume=True)


def test_learning_sees_the_rewards_given() -> None:
    class Length:
        """Rewards that say which step they are of, and look at pictures."""

        source = REWARD.source
        needs_frames = True
        seen: list[Episode] = []

        def __call__(self, episode: Episode) -> np.ndarray:
            self.seen.append(episode)
            return np.arange(episode.steps, dtype=np.float64)

    reward = Length()
    events: list[LearningEvent] = []
    schedule = replace(SCHEDULE, steps=ROUND, evaluate_episodes=0)
    train_in_process(TASK, reward, SAC, schedule, 0, on_event=events.append)
    assert events[-1].reward_mean == sum(range(HORIZON))
    size = get_task(TASK).image_size
    assert [e.frames.shape for e in reward.seen] == [(HORIZON + 1, size, size, 3)] * 2


def test_starts_of_training_and_evaluation_are_disjoint_and_do_not_recur() -> None:
    simulation = Simulation(get_task(TASK), worlds=2, render=False)
    rollout = Rollout(simulation, seed=0)

    def still(step: int, observations: np.ndarray) -> np.ndarray:
        return np.zeros((2, len(simulation.task.action_names)))

    starts = set()
    for purpose in ("train", "evaluate", "demonstrate", "test"):
        for number in range(3):
            for ended in rollout.run(purpose, number, still, frames=False):
                starts.add(tuple(ended.episode.states[0].round(9)))
    assert len(starts) == 4 * 3 * 2


def test_after_a_revision_all_that_is_held_has_the_new_reward(tmp_path: Path) -> None:
    doubled = GroundTruthReward(2 * REWARD.source.scale)
    seen: dict[str, Episode] = {}

    def revise(event: LearningEvent) -> Revision | None:
        seen.update((episode.episode_id, episode) for episode in event.episodes)
        wanted = event.steps == 3 * ROUND
        return Revision(doubled, lambda name: doubled(seen[name])) if wanted else None

    learn(tmp_path, revise=revise)
    newest = CheckpointFolder(tmp_path / "checkpoints").latest()
    assert newest is not None
    parts = read_checkpoint(newest)
    assert parts["run"].values["reward"] == asdict(doubled.source)
    rewards = parts["trainer"].arrays["replay.rewards"][:, 0]
    spans = parts["trainer"].values["replay"]["spans"]
    numbers = {int(name.split("-")[3]) for name, *_ in spans}
    assert numbers == {0, 1, 2, 3}, "episodes before and after it"
    for name, start, steps in spans:
        expected = doubled(seen[name])
        np.testing.assert_allclose(rewards[start : start + steps], expected, rtol=1e-6)
    with pytest.raises(CorruptFileError, match=r"learnt from .*scale=6\.0"):
        learn(tmp_path, resume=True)
