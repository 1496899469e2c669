"""What the streaming logic takes in (by shape, so that a node's own types fit) and gives out."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class StateSample(Protocol):
    """One instant of one world."""

    @property
    def episode_id(self) -> str: ...
    @property
    def world(self) -> int: ...
    @property
    def purpose(self) -> str: ...
    @property
    def step(self) -> int:
        """0..T."""

    @property
    def stamp_ns(self) -> int: ...
    @property
    def image(self) -> Hashable:
        """Header of the image that shows this instant: the join key."""

    @property
    def is_last(self) -> bool: ...
    @property
    def human_reward(self) -> float | None:
        """r* of arriving in this state; None where the truth is unknown."""


class EmbeddingSample(Protocol):
    """One image through an encoder."""

    @property
    def image(self) -> Hashable:
        """Header copied from the image: the join key."""

    @property
    def encoder(self) -> str: ...
    @property
    def version(self) -> str: ...
    @property
    def values(self) -> NDArray[np.float32]:
        """(D,)"""


@dataclass(frozen=True)
class JoinedEpisode:
    """A complete episode: every state, and every embedding where they were asked for."""

    last: StateSample
    """The state that it ended in."""
    human_rewards: NDArray[np.float64] | None
    """(T,) r* of the states arrived in; None where the truth is unknown."""
    embeddings: NDArray[np.float32] | None
    """(T, D) of the frames arrived in; None where none were asked for."""
    encoder: str = ""
    version: str = ""


@dataclass(frozen=True)
class DroppedEpisode:
    """An episode that began and can have no reward."""

    last: StateSample
    """The last state received."""
    reason: str
