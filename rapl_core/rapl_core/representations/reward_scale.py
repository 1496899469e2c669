"""The number that brings an encoder's rewards to a size that suits the learner."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from rapl_core.types import RewardTrace

TARGET = -2.0
"""Mean reward of a step in the worse half of the training videos."""

_MOST_VIDEOS = 64


def fit_reward_scale(
    embeddings: Mapping[str, NDArray[np.float32]],
    reward: Callable[[NDArray[np.float32]], RewardTrace],
    rng: np.random.Generator,
) -> float:
    """The scale at which the worse half of the training videos earn -2 a step on average.

    Worse is judged by the reward itself, so that no true return is needed. At most 64 videos,
    drawn at random, are looked at.

    :param embeddings: (T, D) of each training video.
    :param reward: the encoder's reward at scale 1.
    :return: a positive number; 1 if the worse half's reward is not negative.
    """
    names = sorted(embeddings)
    if len(names) > _MOST_VIDEOS:
        names = [names[i] for i in sorted(rng.choice(len(names), _MOST_VIDEOS, replace=False))]
    means = np.sort([float(reward(embeddings[name]).values.mean()) for name in names])
    worse = float(means[: max(1, len(means) // 2)].mean())
    return TARGET / worse if worse < 0 else 1.0
