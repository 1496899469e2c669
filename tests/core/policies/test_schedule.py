"""The schedule: gradient steps, evaluations and checkpoints at fixed step counts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rapl_core.errors import RaplError
from rapl_core.policies import LearningSchedule, ScheduleConfig


def run(schedule: LearningSchedule, rounds: int, horizon: int) -> list[tuple[int, str, int]]:
    """Drive ``rounds`` rounds and return (steps, what was due, how much)."""
    happened = []
    for _ in range(rounds):
        for _ in range(horizon):
            block = schedule.advance(schedule.config.worlds)
            if block is not None:
                happened.append((schedule.steps, "updates", block.updates))
        schedule.end_round()
        if schedule.evaluation_due:
            happened.append((schedule.steps, "evaluate", schedule.first_evaluation_episode))
            schedule.evaluated()
        if schedule.checkpoint_due:
            happened.append((schedule.steps, "save", 0))
            schedule.checkpointed()
    return happened


@given(
    worlds=st.integers(1, 5),
    block=st.integers(1, 70),
    ratio=st.floats(0, 3),
    random_steps=st.integers(0, 300),
)
def test_gradient_steps_follow_the_ratio_and_random_steps_earn_none(
    worlds: int, block: int, ratio: float, random_steps: int
) -> None:
    schedule = LearningSchedule(
        ScheduleConfig(
            worlds=worlds, block_steps=block, train_ratio=ratio, random_steps=random_steps
        )
    )
    total, counted_at = 0, 0
    for _ in range(400):
        explored = schedule.explores
        due = schedule.advance(worlds)
        assert explored == (schedule.steps - worlds < random_steps)
        if due is not None:
            total += due.updates
            counted_at = schedule.steps
    assert total == schedule.updates
    assert abs(total - ratio * max(0, counted_at - random_steps)) < 1 + 1e-6


def test_what_is_due_when() -> None:
    config = ScheduleConfig(
        steps=100,
        worlds=2,
        random_steps=20,
        block_steps=20,
        train_ratio=0.5,
        evaluate_every=50,
        evaluate_episodes=3,
        checkpoint_every=40,
    )
    schedule = LearningSchedule(config)
    assert run(schedule, 5, 10) == [
        (20, "updates", 0),
        (40, "updates", 10),
        (40, "save", 0),
        (60, "updates", 10),
        (60, "evaluate", 0),
        (80, "updates", 10),
        (80, "save", 0),
        (100, "updates", 10),
        (100, "evaluate", 2),
        (100, "save", 0),
    ]
    assert schedule.finished and schedule.next_episode == 5
    assert not schedule.evaluation_due and not schedule.checkpoint_due


def test_a_restored_schedule_goes_on_as_if_nothing_had_happened() -> None:
    config = ScheduleConfig(worlds=3, block_steps=17, train_ratio=0.7, evaluate_every=90)
    whole = run(LearningSchedule(config), 12, 11)
    first = LearningSchedule(config)
    begun = run(first, 5, 11)
    second = LearningSchedule(config)
    second.restore(first.state())
    assert begun + run(second, 7, 11) == whole


def test_the_end_is_evaluated_and_saved_whatever_the_intervals() -> None:
    config = ScheduleConfig(steps=30, worlds=1, evaluate_every=0, checkpoint_every=0)
    happened = [what for _, what, _ in run(LearningSchedule(config), 3, 10)]
    assert happened == ["evaluate", "save"]
    never = ScheduleConfig(steps=30, worlds=1, evaluate_episodes=0)
    assert "evaluate" not in [what for _, what, _ in run(LearningSchedule(never), 3, 10)]


def test_rewards_may_lag_as_many_episodes_as_configured() -> None:
    assert LearningSchedule(ScheduleConfig(reward_lag=1)).release_before(5) == 3
    assert LearningSchedule(ScheduleConfig(reward_lag=0)).release_before(5) == 4
    assert LearningSchedule(ScheduleConfig()).release_before(0) < 0


@pytest.mark.parametrize(
    "bad", [{"steps": 0}, {"worlds": 0}, {"block_steps": 0}, {"train_ratio": -1.0}]
)
def test_senseless_values_are_refused_by_name(bad: dict[str, float]) -> None:
    with pytest.raises(RaplError, match=next(iter(bad))):
        ScheduleConfig(**bad)  # type: ignore[arg-type]
    with pytest.raises(RaplError, match="cannot advance by 0"):
        LearningSchedule(ScheduleConfig()).advance(0)
