"""What a scripted behaviour is, whatever the world."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Actor(Protocol):
    """Acts through one episode."""

    def act(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the action (A,) in [-1, 1] at a state (S,)."""


@dataclass(frozen=True)
class Behaviour:
    """A scripted way of handling the objects of one task."""

    name: str
    begin: Callable[[np.random.Generator, NDArray[np.float64]], Actor]
    """Makes the actor of an episode from its first state (S,)."""
    share: float
    """Of a pool that spreads the human's reward."""
    preferred: bool = False
    wander: float = 0.0
    """Size of smooth random motion added to the script."""
    telling: bool = False
    """Stands for the preferred or the disliked ones where a gallery shows one of each."""
    unit: tuple[float, ...] = ()
    """(A,) what random motion of size 1 is in each action; empty: 1."""
