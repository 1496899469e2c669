"""After a swap every reward that is learnt from is of one source, whoever answers in what order."""

from pathlib import Path

import numpy as np
import pytest
from learning_cases import SMALL, A, F, transitions

from rapl_core.errors import RaplError
from rapl_core.policies import Learning, Relabelling, RewardLabels, RewardSource, ScheduleConfig
from rapl_core.policies.checkpoint import CheckpointFolder

OLD, NEW, NEWER = (RewardSource("rapl", version, 1.0) for version in ("aaaa", "bbbb", "cccc"))
T = 10


def rewards_of(source: RewardSource, episode_id: str) -> np.ndarray:
    """(T,) what ``source`` says of an episode; told apart by source and episode."""
    return -float(ord(source.version[0])) - np.arange(T) - len(episode_id) / 100


@pytest.fixture
def learning() -> Learning:
    """Four episodes to learn from and two staged, all rewarded by OLD."""
    made = Learning(F, A, SMALL, ScheduleConfig(steps=1000, worlds=1, reward_lag=1), 0)
    made.reward_source = OLD
    for number in range(6):
        stage(made, number, OLD)
        made.begin_round()
        made.end_round()
    return made


@pytest.fixture
def labels(learning: Learning) -> RewardLabels:
    made = RewardLabels(learning)
    made.restore(None)
    return made


def stage(learning: Learning, number: int, source: RewardSource) -> str:
    episode = transitions(number, steps=T)
    name = episode.episode_id
    for step, observation in enumerate(episode.observations):
        learning.stager.observe(name, number, 0, step, observation, step == T)
        if step < T:
            learning.stager.act(name, step, episode.actions[step])
    learning.stager.reward(name, True, rewards_of(source, name))
    return name


def drive(relabelling: Relabelling, answers: list[RewardSource], gone: tuple[str, ...] = ()) -> int:
    """Answer each batch by the next of ``answers``, the last one again and again."""
    asked = 0
    while not relabelling.is_done:
        source = answers[min(asked, len(answers) - 1)]
        batch = relabelling.next()
        relabelling.take(
            source,
            {name: rewards_of(source, name) for name in batch if name not in gone},
            dict.fromkeys(gone, "not recorded"),
        )
        asked += 1
    return asked


def held(learning: Learning) -> dict[str, np.ndarray]:
    """Rewards in the replay buffer, by episode."""
    replay = learning.trainer.replay
    return {s.episode_id: replay.rewards[s.start : s.start + T, 0] for s in replay._spans}


def test_all_that_is_held_is_rewarded_again_and_nothing_else_changes(
    learning: Learning, labels: RewardLabels
) -> None:
    assert len(held(learning)) == 4 and labels.outdated() == {}
    before = learning.trainer.replay.observations.copy()
    learning.reward_source = NEW
    assert list(labels.outdated()) == [f"w0-{n}" for n in range(6)], "the buffer's come first"
    with pytest.raises(RaplError, match="6 episodes have outdated rewards"):
        labels.released()
    relabelling = Relabelling(labels.outdated(), batch=4)
    assert drive(relabelling, [NEW]) == 2
    labels.apply(relabelling)
    labels.released()
    assert labels.outdated() == {} and learning.reward_source == NEW
    for name, values in held(learning).items():
        np.testing.assert_allclose(values, rewards_of(NEW, name), rtol=1e-6)
    np.testing.assert_array_equal(learning.trainer.replay.observations[:40], before[:40])
    released = {episode.episode_id: episode.rewards for episode in learning.stager.release(99)}
    assert list(released) == ["w0-4", "w0-5"]
    np.testing.assert_array_equal(released["w0-5"], rewards_of(NEW, "w0-5"))


def test_rewards_that_came_from_the_new_source_are_not_asked_for(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    labels.note(stage(learning, 6, NEW), NEW)
    assert list(labels.outdated()) == [f"w0-{n}" for n in range(6)]


def test_what_nobody_can_reward_is_asked_for_twice_and_then_dropped(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated())
    gone = ("w0-1", "w0-5")
    assert drive(relabelling, [NEW], gone) == 2
    assert relabelling.lost == dict.fromkeys(gone, "not recorded")
    labels.apply(relabelling)
    assert list(held(learning)) == ["w0-0", "w0-2", "w0-3"]
    assert learning.stager.dropped == {"w0-5": "not recorded"}


def test_rewards_of_another_length_or_not_finite_are_lost(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated())
    answers = {name: rewards_of(NEW, name) for name in relabelling.next()}
    answers["w0-2"] = answers["w0-2"][:7]
    answers["w0-3"] = np.full(T, np.nan)
    relabelling.take(NEW, answers, {})
    assert relabelling.is_done
    assert relabelling.lost == {
        "w0-2": "7 rewards for 10 transitions",
        "w0-3": "reward not finite",
    }


def test_another_swap_in_between_begins_anew_and_never_mixes(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated(), batch=2)
    drive(relabelling, [NEW, NEWER])
    assert relabelling.source == NEWER and len(relabelling.rewards) == 6
    labels.apply(relabelling)
    assert learning.reward_source == NEWER and labels.outdated() == {}
    for name, values in held(learning).items():
        np.testing.assert_allclose(values, rewards_of(NEWER, name), rtol=1e-6)


def test_a_reward_of_a_third_source_during_the_relabelling_is_outdated_afterwards(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated())
    learning.reward_source = NEWER
    labels.note(stage(learning, 6, NEWER), NEWER)
    drive(relabelling, [NEW])
    labels.apply(relabelling)
    assert labels.outdated() == {"w0-6": T}, "the answer's source counts"
    again = Relabelling(labels.outdated())
    drive(again, [NEWER])
    labels.apply(again)
    assert list(labels.outdated()) == [f"w0-{n}" for n in range(6)]
    last = Relabelling(labels.outdated())
    drive(last, [NEWER])
    labels.apply(last)
    assert labels.outdated() == {} and len(held(learning)) == 4


def test_giving_up_drops_what_is_left_and_keeps_what_came(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated(), batch=2)
    batch = relabelling.next()
    relabelling.take(NEW, {name: rewards_of(NEW, name) for name in batch}, {})
    with pytest.raises(RaplError, match="neither rewarded again nor lost"):
        labels.apply(relabelling)
    assert relabelling.give_up("no answer within 60 s") == 4
    labels.apply(relabelling)
    assert list(held(learning)) == ["w0-0", "w0-1"]
    assert labels.outdated() == {}


def test_giving_up_before_any_answer_leaves_nothing_outdated(
    learning: Learning, labels: RewardLabels
) -> None:
    learning.reward_source = NEW
    relabelling = Relabelling(labels.outdated())
    relabelling.give_up("nobody there")
    labels.apply(relabelling)
    assert held(learning) == {} and labels.outdated() == {}
    labels.released()


def test_a_checkpoint_written_in_between_knows_what_is_outdated(
    learning: Learning, labels: RewardLabels, tmp_path: Path
) -> None:
    learning.reward_source = NEW
    labels.note(stage(learning, 6, NEW), NEW)
    path = learning.save(CheckpointFolder(tmp_path), {"labels": labels.state()})
    second = Learning(F, A, SMALL, learning.schedule.config, 0)
    parts = second.restore(path)
    again = RewardLabels(second)
    again.restore(parts["labels"])
    assert again.outdated() == labels.outdated() != {}
    assert "w0-6" not in again.outdated()
