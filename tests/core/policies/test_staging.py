"""Staging: an episode is learnt from entirely and in order, or not at all."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rapl_core.policies import EpisodeStager

T, F, A = 4, 3, 2


def observation(number: int, world: int, step: int) -> np.ndarray:
    return np.array([number, world, step], dtype=np.float32)


def feed(
    stager: EpisodeStager,
    number: int,
    world: int = 0,
    steps: range = range(T + 1),
    terminated: bool = False,
) -> str:
    """Observations and actions of an episode, without its reward."""
    episode_id = f"w{world}-{number}"
    for step in steps:
        stager.observe(
            episode_id,
            number,
            world,
            step,
            observation(number, world, step),
            is_last=step == T,
            terminated=terminated and step == T,
        )
        if step < T:
            stager.act(episode_id, step, np.full(A, step / 10))
    return episode_id


def rewards(value: float = -1.0) -> np.ndarray:
    return np.full(T, value)


def test_a_complete_rewarded_episode_is_released_with_t_transitions() -> None:
    stager = EpisodeStager()
    episode_id = feed(stager, 3, world=1, terminated=True)
    assert stager.unrewarded == 1
    assert stager.reward(episode_id, True, np.arange(T, dtype=float))
    (episode,) = stager.release(3)
    assert (episode.episode_id, episode.number, episode.world) == ("w1-3", 3, 1)
    assert episode.observations.shape == (T + 1, F) and episode.actions.shape == (T, A)
    assert episode.observations[:, 2].tolist() == [0, 1, 2, 3, 4]
    assert episode.actions[:, 0] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert episode.rewards.tolist() == [0, 1, 2, 3]
    assert episode.terminated
    assert stager.release(3) == [] and stager.released == 1


@given(st.randoms(use_true_random=False))
def test_release_order_is_number_then_world_whenever_rewards_come(shuffle: random.Random) -> None:
    stager = EpisodeStager()
    for number in range(3):
        for world in range(3):
            feed(stager, number, world)
    ids = [f"w{world}-{number}" for number in range(3) for world in range(3)]
    arriving = list(ids)
    shuffle.shuffle(arriving)
    for episode_id in arriving:
        stager.reward(episode_id, True, rewards())
    assert [e.episode_id for e in stager.release(1)] == ids[:6]
    assert [e.episode_id for e in stager.release(9)] == ids[6:]


@pytest.mark.parametrize("missing", range(T + 1))
def test_an_episode_that_lacks_a_state_is_dropped(missing: int) -> None:
    stager = EpisodeStager()
    steps = [s for s in range(T + 1) if s != missing]
    for step in steps:
        feed(stager, 0, steps=range(step, step + 1))
    stager.reward("w0-0", True, rewards())
    assert stager.release(0) == []
    if missing < T:
        assert stager.dropped == {"w0-0": f"state missing at step {missing}"}
    else:  # the last one may still come
        assert stager.unresolved() == ["w0-0"]


def test_an_episode_that_lacks_an_action_is_dropped() -> None:
    stager = EpisodeStager()
    for step in range(T + 1):
        stager.observe("e", 0, 0, step, observation(0, 0, step), is_last=step == T)
        if step not in (2, T):
            stager.act("e", step, np.zeros(A))
    stager.reward("e", True, rewards())
    assert stager.release(0) == []
    assert stager.dropped == {"e": "action missing at step 2"}


def test_an_episode_cut_short_by_the_next_is_dropped() -> None:
    stager = EpisodeStager()
    feed(stager, 0, steps=range(2))
    feed(stager, 0, world=1, steps=range(2))
    feed(stager, 1)
    assert stager.dropped == {"w0-0": "ended at step 1"}
    assert stager.unresolved(0) == ["w1-0"]  # another world goes on


def test_an_invalid_reward_drops_the_episode_and_says_why() -> None:
    stager = EpisodeStager()
    feed(stager, 0)
    assert not stager.reward("w0-0", False, None, "image missing at step 2")
    assert stager.dropped == {"w0-0": "image missing at step 2"}
    assert stager.unresolved() == [] and stager.release(0) == []


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (np.zeros(T - 1), "3 rewards for 4 transitions"),
        (np.array([0, np.nan, 0, 0]), "reward not finite"),
    ],
)
@pytest.mark.parametrize("early", [False, True])
def test_rewards_that_do_not_fit_drop_the_episode(
    values: np.ndarray, reason: str, early: bool
) -> None:
    stager = EpisodeStager()
    feed(stager, 0, steps=range(T if early else T + 1))
    stager.reward("w0-0", True, values)
    feed(stager, 0, steps=range(T, T + 1))
    assert stager.dropped == {"w0-0": reason}


def test_repeated_messages_change_nothing_and_a_later_reward_replaces() -> None:
    stager = EpisodeStager()
    feed(stager, 0, steps=range(3))
    assert not stager.observe("w0-0", 0, 0, 1, np.full(F, 9, dtype=np.float32))
    stager.act("w0-0", 1, np.ones(A))
    feed(stager, 0, steps=range(3, T + 1))
    feed(stager, 0)
    stager.reward("w0-0", True, rewards(-1))
    stager.reward("w0-0", True, rewards(-2))
    (episode,) = stager.release(0)
    assert episode.rewards.tolist() == [-2] * T
    assert episode.observations[1].tolist() == [0, 0, 1]
    assert episode.actions[1, 0] == pytest.approx(0.1)
    assert not stager.reward("w0-0", True, rewards(-3))
    feed(stager, 0)  # a replay of a released episode
    assert stager.unresolved() == [] and stager.release(9) == []


def test_a_reward_that_comes_before_the_last_state_counts() -> None:
    stager = EpisodeStager()
    feed(stager, 0, steps=range(T))
    stager.reward("w0-0", True, rewards())
    assert stager.release(0) == []
    feed(stager, 0, steps=range(T, T + 1))
    assert len(stager.release(0)) == 1


def test_what_is_missing_is_named() -> None:
    stager = EpisodeStager()
    for number in range(3):
        feed(stager, number)
    stager.reward("w0-1", True, rewards())
    assert stager.unresolved(1) == ["w0-0"]
    assert stager.unresolved() == ["w0-0", "w0-2"]
    stager.drop("w0-0", "no reward within 5 s")
    assert stager.unresolved(1) == []
    assert stager.dropped == {"w0-0": "no reward within 5 s"}


def test_rewards_can_be_taken_back() -> None:
    stager = EpisodeStager()
    feed(stager, 0)
    stager.reward("w0-0", True, rewards())
    assert stager.forget_rewards() == ["w0-0"]
    assert stager.release(0) == [] and stager.unresolved() == ["w0-0"]


def test_a_restored_stager_releases_the_same() -> None:
    stager = EpisodeStager()
    for number in range(3):
        feed(stager, number, terminated=number == 1)
        stager.reward(f"w0-{number}", True, rewards(-number))
    stager.release(0)
    restored = EpisodeStager()
    restored.restore(stager.state())
    assert not restored.reward("w0-0", True, rewards())
    for one, other in zip(stager.release(9), restored.release(9), strict=True):
        assert np.array_equal(one.observations, other.observations)
        assert np.array_equal(one.actions, other.actions)
        assert np.array_equal(one.rewards, other.rewards)
        assert (one.episode_id, one.terminated) == (other.episode_id, other.terminated)
    assert restored.released == 3
