"""The learner's session without ROS: rewards in any order, deadlines, encoder swaps."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rapl_core.errors import RaplError
from rapl_core.policies import Relabelling, RewardSource, SacConfig, ScheduleConfig
from rapl_core.tasks import get_task
from rapl_core.types import RewardTrace
from rapl_ros.learner_session import AfterSwap, LearnerSession, fresh_or_refuse
from rapl_ros.players import TrainingPlayer
from rapl_ros.wire import EpisodeReward, Instant, JoinKey, World

pytestmark = pytest.mark.ros

TASK = get_task("franka_group")
STEPS, WORLDS = 5, 2


def make_session(folder: Path, after_swap: AfterSwap = "empty") -> LearnerSession:
    world = World(
        task="franka_group",
        worlds=WORLDS,
        period_s=0.08,
        max_steps=STEPS,
        lockstep=True,
        state_names=TASK.state_names,
        state_units=TASK.state_units,
        action_names=TASK.action_names,
        camera_frames=(),
        seed=0,
    )
    schedule = ScheduleConfig(steps=1000, worlds=WORLDS, random_steps=1000, evaluate_episodes=0)
    sac = SacConfig(hidden=(8,), batch_size=4, buffer_size=100)
    return LearnerSession(world, sac, schedule, 0, folder, after_swap)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[LearnerSession]:
    made = make_session(tmp_path)
    yield made
    made.close()


@pytest.fixture
def successor(tmp_path: Path) -> Iterator[LearnerSession]:
    """Of the process that takes over."""
    made = make_session(tmp_path)
    yield made
    made.close()


@pytest.fixture
def relabelling_session(tmp_path: Path) -> Iterator[LearnerSession]:
    made = make_session(tmp_path, "relabel")
    yield made
    made.close()


def play(session: LearnerSession, number: int) -> TrainingPlayer:
    """One round: an episode of every world."""
    player = session.begin_round()
    names = [f"train-{world}-{number}" for world in range(WORLDS)]
    player.begin(names)
    for step in range(STEPS + 1):
        instants = [
            Instant(
                key=JoinKey("world", step),
                image=JoinKey("camera", step),
                world=world,
                episode_id=name,
                purpose="train",
                controller="learner",
                step=step,
                is_last=step == STEPS,
                terminated=False,
                values=np.full(len(TASK.state_names), 0.1 * (step + 1)),
                human_reward=-1.0,
                success=step == STEPS,
            )
            for world, name in enumerate(names)
        ]
        player.act(instants)
        if step < STEPS:
            player.acted(WORLDS)
    session.end_round(player)
    return player


def give(session: LearnerSession, name: str, version: str = "aaaa", valid: bool = True) -> None:
    whose = EpisodeReward(JoinKey("world", 1), name, 0, "train", "rapl", version)
    trace = RewardTrace(np.full(STEPS, -2.0), "", 0.0, True, 0, 0.0, 1.0) if valid else None
    session.reward(whose, trace, "" if valid else "image missing at step 3")


def size(session: LearnerSession) -> int:
    return session.learning.trainer.replay.size()


def test_no_third_round_begins_without_the_rewards_of_the_first(session: LearnerSession) -> None:
    play(session, 0)
    assert session.may_begin
    play(session, 1)
    assert not session.may_begin and session.unrewarded == 4
    give(session, "train-1-0")
    give(session, "train-0-0")
    assert session.may_begin
    session.begin_round()
    assert size(session) == 2 * STEPS, "the first round is learnt from, the second not yet"


def test_a_dropped_episode_is_not_learnt_from_and_not_waited_for(session: LearnerSession) -> None:
    play(session, 0)
    play(session, 1)
    give(session, "train-0-0", valid=False)
    give(session, "train-1-0")
    assert session.may_begin
    session.begin_round()
    assert size(session) == STEPS
    assert session.metrics().dropped_episodes == 1


def test_a_drop_that_comes_before_the_round_has_ended_is_not_forgotten(
    session: LearnerSession,
) -> None:
    give(session, "train-0-0", valid=False)
    play(session, 0)
    assert session.unrewarded == 1


def test_an_overdue_reward_is_given_up_and_named(session: LearnerSession) -> None:
    play(session, 0)
    assert session.expire_rewards(60.0) == []
    assert session.expire_rewards(0.0) == ["train-0-0", "train-1-0"]
    assert session.unrewarded == 0
    give(session, "train-0-0")  # too late
    session.begin_round()
    assert size(session) == 0


def test_after_an_encoder_swap_the_replay_buffer_is_emptied(session: LearnerSession) -> None:
    for number in range(3):
        play(session, number)
        for world in range(WORLDS):
            give(session, f"train-{world}-{number}", "aaaa")
    session.begin_round()
    assert size(session) == 2 * WORLDS * STEPS
    play(session, 3)
    give(session, "train-0-3", "bbbb")
    give(session, "train-1-3", "bbbb")
    assert session.swaps == 1
    play(session, 4)
    assert size(session) == 0, "nothing rewarded by the first encoder is left"
    play(session, 5)
    session.begin_round()
    assert size(session) == WORLDS * STEPS, "only what the second encoder has rewarded"
    source = session.learning.reward_source
    assert source is not None and source.version == "bbbb"


def swap_after_four_rounds(session: LearnerSession) -> None:
    """Six episodes to learn from by aaaa; two are staged by aaaa and two by bbbb."""
    for number in range(4):
        play(session, number)
        for world in range(WORLDS):
            give(session, f"train-{world}-{number}", "aaaa")
    play(session, 4)
    give(session, "train-0-4", "bbbb")
    give(session, "train-1-4", "bbbb")


def answer(relabelling: Relabelling, version: str) -> None:
    source = RewardSource("rapl", version, 1.0)
    while not relabelling.is_done:
        asked = relabelling.next()
        relabelling.take(source, {name: np.full(STEPS, -7.0) for name in asked}, {})


def test_a_relabelled_buffer_keeps_its_size_and_holds_the_new_rewards(
    relabelling_session: LearnerSession,
) -> None:
    session = relabelling_session
    swap_after_four_rounds(session)
    before = size(session)
    assert session.swaps == 1 and session.needs_relabelling and before == 6 * STEPS
    with pytest.raises(RaplError, match="outdated"):
        session.begin_round()
    relabelling = session.begin_relabelling()
    assert relabelling.total == 8, "what the new encoder has rewarded is not asked for"
    answer(relabelling, "bbbb")
    session.end_relabelling(relabelling)
    assert not session.needs_relabelling and session.relabelled == 8 and size(session) == before
    session.begin_round()
    rewards = session.learning.trainer.replay.rewards[: size(session), 0]
    assert set(rewards.tolist()) == {-7.0}
    assert session.metrics().dropped_episodes == 0


def test_a_checkpoint_before_the_relabelling_is_relabelled_by_who_takes_over(
    relabelling_session: LearnerSession, tmp_path: Path
) -> None:
    swap_after_four_rounds(relabelling_session)
    successor = make_session(tmp_path, "relabel")
    successor.resume(relabelling_session.save())
    assert size(successor) == 6 * STEPS and successor.needs_relabelling
    relabelling = successor.begin_relabelling()
    answer(relabelling, "bbbb")
    successor.end_relabelling(relabelling)
    successor.begin_round()
    rewards = successor.learning.trainer.replay.rewards[: size(successor), 0]
    assert set(rewards.tolist()) == {-7.0}
    successor.close()


def test_a_checkpoint_brings_everything_back_and_is_not_overwritten_by_accident(
    session: LearnerSession, successor: LearnerSession
) -> None:
    fresh_or_refuse(session)
    for number in range(3):
        play(session, number)
        for world in range(WORLDS):
            give(session, f"train-{world}-{number}", valid=(world, number) != (1, 0))
    session.begin_round()
    path = session.save()
    with pytest.raises(RaplError, match="resume it"):
        fresh_or_refuse(session)
    assert successor.metrics().steps == 0
    successor.resume(path)
    before, after = session.metrics(), successor.metrics()
    assert (after.steps, after.episodes, after.reward_mean, after.success_rate) == (
        before.steps,
        before.episodes,
        before.reward_mean,
        1.0,
    )
    assert after.dropped_episodes == 1
    assert size(successor) == size(session) == 3 * STEPS
    replays = session.learning.trainer.replay, successor.learning.trainer.replay
    np.testing.assert_array_equal(replays[0].observations[:15], replays[1].observations[:15])
    assert successor.learning.schedule.next_episode == 3


def test_a_checkpoint_after_a_swap_holds_nothing_of_the_encoder_before(
    session: LearnerSession, successor: LearnerSession
) -> None:
    for number in range(3):
        play(session, number)
        for world in range(WORLDS):
            give(session, f"train-{world}-{number}", "aaaa")
    session.begin_round()
    assert size(session) > 0
    play(session, 3)
    for world in range(WORLDS):
        give(session, f"train-{world}-3", "bbbb")
    successor.resume(session.save())
    source = successor.learning.reward_source
    assert source is not None and source.version == "bbbb"
    assert size(successor) == 0


def test_an_episode_is_lost_once_however_often_it_is_said(session: LearnerSession) -> None:
    play(session, 0)
    session.expire_rewards(0.0)
    give(session, "train-0-0", valid=False)
    assert session.metrics().dropped_episodes == WORLDS
