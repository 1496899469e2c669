"""The in-process reward of an encoder is the encoder's own on the frames arrived in."""

from dataclasses import replace

import numpy as np
import pytest

from rapl_core.policies import EncoderReward
from rapl_core.representations import make_encoder
from rapl_core.types import Episode


def make_episode(name: str, seed: int) -> Episode:
    rng = np.random.default_rng(seed)
    return Episode(
        episode_id=name,
        task="t",
        world=0,
        purpose="train",
        controller="c",
        frames=rng.integers(0, 256, (6, 112, 112, 3), dtype=np.uint8),
        states=np.zeros((6, 2)),
        actions=np.zeros((5, 1)),
        stamps_ns=np.arange(6),
    )


def test_rewards_are_the_encoders_own_and_the_first_frame_does_not_count() -> None:
    encoder = make_encoder("imagenet")
    experts = [encoder.embed_episode(make_episode(f"expert-{i}", i)) for i in range(2)]
    reward = EncoderReward(encoder, experts)
    episode = make_episode("e", 9)
    values = reward(episode)
    trace = encoder.reward(encoder.embed_episode(episode).values, experts)
    assert values == pytest.approx(trace.values, rel=1e-6)
    assert values.shape == (5,) and reward.needs_frames
    assert reward.source.name == "imagenet"
    assert reward.source.version == encoder.info.version
    assert reward.source.scale == encoder.info.reward_scale
    frames = episode.frames.copy()
    frames[0] = 0
    assert np.array_equal(reward(replace(episode, frames=frames)), values)
