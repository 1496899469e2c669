"""States and embeddings of made-up episodes, as the streaming tests feed them."""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class State:
    """A state that satisfies StateSample."""

    episode_id: str
    step: int
    is_last: bool
    world: int = 0
    purpose: str = "train"
    human_reward: float | None = -1.0

    @property
    def stamp_ns(self) -> int:
        return 1_000 * self.step + 1

    @property
    def image(self) -> Hashable:
        return (self.episode_id, self.step)


@dataclass(frozen=True)
class Embedding:
    """An embedding that satisfies EmbeddingSample."""

    image: Hashable
    values: NDArray[np.float32]
    version: str = "aaaa"
    encoder: str = "rapl"


def states(episode_id: str, horizon: int, world: int = 0) -> list[State]:
    """The T + 1 states of an episode."""
    return [
        State(episode_id, step, step == horizon, world, human_reward=-float(step))
        for step in range(horizon + 1)
    ]


def embeddings(episode_id: str, horizon: int, version: str = "aaaa") -> list[Embedding]:
    """The T + 1 embeddings of an episode; those of step t are (t, 1)."""
    return [
        Embedding((episode_id, step), np.array([step, 1], np.float32), version)
        for step in range(horizon + 1)
    ]
