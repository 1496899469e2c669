"""What simulated people want: the reward r* of each, computed from an episode's logged states."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError, UnknownNameError

TO_GOAL = "_to_goal"
"""Ending of the state names that are distances of objects to the goal."""

Wish = Callable[[NDArray[np.float64], NDArray[np.float64], Sequence[str]], NDArray[np.float64]]
"""(human rewards (T + 1,), states (T + 1, S), state names) to rewards (T + 1,)."""


def _task(
    human: NDArray[np.float64], states: NDArray[np.float64], names: Sequence[str]
) -> NDArray[np.float64]:
    return human


def _opposite(
    human: NDArray[np.float64], states: NDArray[np.float64], names: Sequence[str]
) -> NDArray[np.float64]:
    return -human


def _progress(
    human: NDArray[np.float64], states: NDArray[np.float64], names: Sequence[str]
) -> NDArray[np.float64]:
    columns = [names.index(name) for name in _distances(names)]
    return np.asarray(-states[:, columns].max(axis=1))


def _apart(
    human: NDArray[np.float64], states: NDArray[np.float64], names: Sequence[str]
) -> NDArray[np.float64]:
    objects = [name.removesuffix(TO_GOAL) for name in _distances(names)]
    places = [
        states[:, [names.index(f"{thing}_{axis}") for axis in "xyz" if f"{thing}_{axis}" in names]]
        for thing in objects
    ]
    gaps = [
        np.linalg.norm(a - b, axis=1) for i, a in enumerate(places) for b in places[i + 1 :]
    ]  # each (T + 1,)
    if not gaps:
        raise RankingError("the wish 'apart' needs two objects in the state")
    return np.asarray(_progress(human, states, names) + np.max(gaps, axis=0))


_WISHES: dict[str, Wish] = {
    "task": _task,
    "opposite": _opposite,
    "progress": _progress,
    "apart": _apart,
}

WISH_MEANINGS = {
    "task": "the task's own r*",
    "opposite": "minus r*: likes what the task dislikes",
    "progress": "objects near the goal, together or not",
    "apart": "objects near the goal and far from each other",
}


@dataclass(frozen=True)
class Person:
    """A simulated person."""

    name: str
    wish: str = "task"

    def __post_init__(self) -> None:
        if self.wish not in _WISHES:
            raise UnknownNameError("wish", self.wish, _WISHES)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``name:wish``.

        :raises RankingError: if it is something else.
        :raises UnknownNameError: naming the known wishes.
        """
        name, colon, wish = text.partition(":")
        if not name or not colon:
            raise RankingError(f"{text!r} is no person, expected name:wish, e.g. ann:task")
        return cls(name, wish)


def persons_from(text: str) -> tuple[Person, ...]:
    """Read ``name:wish,name:wish``; none from an empty text.

    :raises RankingError: if a part is something else, or a name comes twice.
    """
    persons = tuple(Person.parse(part.strip()) for part in text.split(",") if part.strip())
    names = [person.name for person in persons]
    if len(set(names)) < len(names):
        raise RankingError(f"a name comes twice among {', '.join(names)}")
    return persons


def wish_names() -> list[str]:
    """What a simulated person may want."""
    return list(_WISHES)


def wish_rewards(
    wish: str,
    human_rewards: NDArray[np.float64] | None,
    states: NDArray[np.float64],
    state_names: Sequence[str],
) -> NDArray[np.float64]:
    """Return what a person of this wish feels at each instant.

    :param human_rewards: (T + 1,) the task's r*; None where the truth is unknown.
    :param states: (T + 1, S).
    :return: (T + 1,)
    :raises UnknownNameError: naming the known wishes.
    :raises RankingError: if the truth is unknown or the state lacks what the wish is about.
    """
    if wish not in _WISHES:
        raise UnknownNameError("wish", wish, _WISHES)
    if human_rewards is None:
        raise RankingError("the truth about the video is unknown")
    return _WISHES[wish](human_rewards, states, list(state_names))


def _distances(names: Sequence[str]) -> list[str]:
    found = [name for name in names if name.endswith(TO_GOAL)]
    if not found:
        raise RankingError(f"no object's distance to the goal among {', '.join(names)}")
    return found
