"""A scripted robot: one behaviour in one episode, with noise."""

import numpy as np
from numpy.typing import NDArray

from rapl_core.demonstrators.behaviour import Actor, Behaviour
from rapl_core.demonstrators.clutter import clutter_behaviours
from rapl_core.demonstrators.grouping import grouping_behaviours
from rapl_core.demonstrators.planar_avoiding import avoiding_behaviours
from rapl_core.demonstrators.planar_grouping import planar_grouping_behaviours
from rapl_core.demonstrators.planar_sweeping import sweeping_behaviours
from rapl_core.errors import UnknownNameError
from rapl_core.tasks.base import Task
from rapl_core.tasks.clutter import TabletopClutter
from rapl_core.tasks.registry import task_names
from rapl_core.tasks.tabletop import TabletopGroup
from rapl_core.tasks.xmagical import AvoidTask, GroupTask
from rapl_core.tasks.xmagical_sweep import SweepTask

SMOOTHNESS = 0.8
"""Share of the wander that stays from one step to the next."""


class Demonstrator:
    """Acts one behaviour through one episode.

    :param noise: standard deviation of independent noise added to each action.
    """

    def __init__(
        self, task: Task, behaviour: Behaviour, rng: np.random.Generator, noise: float
    ) -> None:
        self.behaviour = behaviour.name
        self._begin = behaviour.begin
        self._wander = behaviour.wander
        self._noise = noise
        self._rng = rng
        self._size = len(task.action_names)
        self._unit = np.array(behaviour.unit or [1.0] * self._size)
        self._drift = np.zeros(self._size)
        self._actor: Actor | None = None

    def act(self, state: NDArray[np.float64], step: int) -> NDArray[np.float64]:
        """Return the action (A,) in [-1, 1] at a state (S,).

        :param step: step of the episode; 0 makes a new plan from the state.
        """
        if step == 0 or self._actor is None:
            self._actor = self._begin(self._rng, state)
            self._drift = np.zeros(self._size)
        action = self._actor.act(state)
        if self._wander:
            kick = np.sqrt(1 - SMOOTHNESS**2) * self._rng.normal(size=self._size)
            self._drift = SMOOTHNESS * self._drift + kick
            action = action + self._wander * self._unit * self._drift
        if self._noise:
            action = action + self._noise * self._unit * self._rng.normal(size=self._size)
        return np.clip(action, -1.0, 1.0)


def behaviours_of(task: Task) -> dict[str, Behaviour]:
    """Return the behaviours that a task has, by name.

    :raises UnknownNameError: if nobody has scripted the task.
    """
    # each family of tasks adds its scripts here
    if isinstance(task, TabletopGroup):
        behaviours = grouping_behaviours(task)
    elif isinstance(task, AvoidTask):
        behaviours = avoiding_behaviours(task)
    elif isinstance(task, GroupTask):
        behaviours = planar_grouping_behaviours(task)
    elif isinstance(task, SweepTask):
        behaviours = sweeping_behaviours(task)
    elif isinstance(task, TabletopClutter):
        behaviours = clutter_behaviours(task)
    else:
        known = [name for name in task_names() if name != task.name]
        raise UnknownNameError("scripted task", task.name, known)
    return {behaviour.name: behaviour for behaviour in behaviours}


def behaviour_names(task: Task) -> list[str]:
    """Return the names of a task's behaviours."""
    return list(behaviours_of(task))


def preferred_behaviours(task: Task) -> list[str]:
    """Return the names of those that show how it should be done."""
    return [name for name, behaviour in behaviours_of(task).items() if behaviour.preferred]


def make_demonstrator(
    task: Task, behaviour: str, rng: np.random.Generator, noise: float = 0.0
) -> Demonstrator:
    """Return a demonstrator for one episode.

    :raises UnknownNameError: if the task has no such behaviour.
    """
    known = behaviours_of(task)
    if behaviour not in known:
        raise UnknownNameError("behaviour", behaviour, known)
    return Demonstrator(task, known[behaviour], rng, noise)


def draw_behaviours(
    task: Task, episodes: int, rng: np.random.Generator, only: tuple[str, ...] = ()
) -> list[str]:
    """Return which behaviour each of ``episodes`` shows, in proportion to their shares.

    :param only: names to draw from; empty for all.
    """
    known = behaviours_of(task)
    names = list(only) or list(known)
    for name in names:
        if name not in known:
            raise UnknownNameError("behaviour", name, known)
    shares = np.array([known[name].share for name in names])
    exact = shares / shares.sum() * episodes
    counts = np.floor(exact).astype(int)
    for index in np.argsort(counts - exact)[: episodes - counts.sum()]:
        counts[index] += 1
    drawn = [name for name, count in zip(names, counts, strict=True) for _ in range(count)]
    return [drawn[i] for i in rng.permutation(len(drawn))]
