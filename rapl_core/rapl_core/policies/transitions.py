"""A complete episode as the replay buffer takes it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.types import check_episode_id, check_shape


@dataclass(frozen=True)
class EpisodeTransitions:
    """T transitions from T + 1 observations of one episode."""

    episode_id: str
    number: int
    """How many episodes this world had before."""
    world: int
    observations: NDArray[np.float32]
    """(T + 1, F)."""
    actions: NDArray[np.float32]
    """(T, A), each in [-1, 1]."""
    rewards: NDArray[np.float64]
    """(T,) rewards[t] belongs to the transition t -> t + 1."""
    terminated: bool
    """The task ended: nothing is earned afterwards. False: the time limit, so bootstrap."""

    def __post_init__(self) -> None:
        check_episode_id(self.episode_id)
        steps = len(self.actions)
        if steps < 1:
            raise ShapeError(f"episode {self.episode_id} has no transition")
        check_shape("observations", self.observations, (steps + 1, None))
        check_shape("actions", self.actions, (steps, None))
        check_shape("rewards", self.rewards, (steps,))
        for name in ("observations", "actions", "rewards"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ShapeError(f"{name} of episode {self.episode_id} are not all finite")
