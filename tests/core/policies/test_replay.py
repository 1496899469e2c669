"""The replay buffer holds what it was given, by episode, and no more than fits."""

from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_cases import SMALL, A, F, transitions

from rapl_core.errors import ShapeError
from rapl_core.policies import EpisodeTransitions, SacConfig, SacTrainer
from rapl_core.policies.replay import EpisodeReplay


def replay_of(size: int) -> EpisodeReplay:
    return SacTrainer(F, A, SacConfig(hidden=(4,), batch_size=4, buffer_size=size), 0).replay


def rows(episode: EpisodeTransitions) -> list[tuple[float, ...]]:
    """Each transition as numbers."""
    steps = len(episode.actions)
    return [
        (
            *episode.observations[t].tolist(),
            *episode.observations[t + 1].tolist(),
            *episode.actions[t].tolist(),
            float(np.float32(episode.rewards[t])),
            float(episode.terminated and t == steps - 1),
        )
        for t in range(steps)
    ]


def held(replay: EpisodeReplay) -> list[tuple[float, ...]]:
    n = replay.size()
    return [
        (
            *replay.observations[i, 0].tolist(),
            *replay.next_observations[i, 0].tolist(),
            *replay.actions[i, 0].tolist(),
            float(replay.rewards[i, 0]),
            float(replay.dones[i, 0]),
        )
        for i in range(n)
    ]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=14))
def test_the_newest_transitions_are_held_and_whole_episodes_known(lengths: list[int]) -> None:
    size = 20
    replay = replay_of(size)
    newest: deque[tuple[str, tuple[float, ...]]] = deque(maxlen=size)
    for number, steps in enumerate(lengths):
        episode = transitions(number, steps=steps, terminated=number % 2 == 0)
        replay.extend(episode)
        newest.extend((episode.episode_id, row) for row in rows(episode))
    assert sorted(held(replay)) == sorted(row for _, row in newest)
    counts = {f"w0-{n}": steps for n, steps in enumerate(lengths)}
    whole = [i for i, n in counts.items() if sum(episode_id == i for episode_id, _ in newest) == n]
    assert replay.episode_ids() == whole


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=14), st.sets(st.integers(0, 13)))
def test_relabelling_keeps_what_has_a_reward_and_changes_only_that(
    lengths: list[int], chosen: set[int]
) -> None:
    replay = replay_of(20)
    episodes = {}
    for number, steps in enumerate(lengths):
        episode = transitions(number, steps=steps)
        replay.extend(episode)
        episodes[episode.episode_id] = episode
    whole = replay.episode_ids()
    rewards = {f"w0-{n}": np.full(lengths[n], -float(n)) for n in chosen if n < len(lengths)}
    kept = replay.relabel(rewards)
    assert replay.episode_ids() == [i for i in whole if i in rewards]
    assert kept == len(replay.episode_ids())
    expected = [
        (*row[:-2], float(rewards[i][0]), row[-1])
        for i in replay.episode_ids()
        for row in rows(episodes[i])
    ]
    assert held(replay) == expected
    replay.extend(transitions(99, steps=3))  # and it goes on
    assert replay.size() == min(20, len(expected) + 3)


def test_relabelling_with_wrong_lengths_changes_nothing() -> None:
    replay = replay_of(50)
    for number in range(3):
        replay.extend(transitions(number))
    before = held(replay)
    with pytest.raises(ShapeError, match=r"w0-1 have shape \(4,\), expected \(10,\)"):
        replay.relabel({"w0-0": np.zeros(10), "w0-1": np.zeros(4)})
    assert held(replay) == before


def test_a_cleared_buffer_is_empty() -> None:
    trainer = SacTrainer(F, A, SMALL, 0)
    trainer.add_episode(transitions(0, steps=40))
    assert trainer.can_update
    trainer.clear_buffer()
    assert not trainer.can_update and trainer.replay.episode_ids() == []


def test_samples_come_from_the_whole_buffer_and_its_own_generator(tmp_path: Path) -> None:
    one, two = replay_of(40), replay_of(40)
    for replay in (one, two):
        replay.extend(transitions(0, steps=30))
    np.random.seed(0)
    first = one.sample(500).rewards.numpy()
    np.random.seed(1)
    assert np.array_equal(first, two.sample(500).rewards.numpy())
    assert len(np.unique(first)) == 30


def test_episodes_of_other_sizes_or_with_nan_are_refused() -> None:
    replay = replay_of(20)
    with pytest.raises(ShapeError, match="has 21 transitions"):
        replay.extend(transitions(0, steps=21))
    good = transitions(0)
    with pytest.raises(ShapeError, match="rewards has shape"):
        EpisodeTransitions(
            "e", 0, 0, good.observations, good.actions, good.rewards[:-1], terminated=False
        )
    with pytest.raises(ShapeError, match="rewards of episode e are not all finite"):
        EpisodeTransitions(
            "e", 0, 0, good.observations, good.actions, good.rewards * np.nan, terminated=False
        )
