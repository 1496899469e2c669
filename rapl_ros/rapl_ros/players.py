"""Who plays a round: the policy that learns, and the one that is evaluated."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.policies import Learning, SacTrainer
from rapl_core.policies.observation import observe
from rapl_core.tasks import Task
from rapl_ros.wire import Instant


@dataclass
class EpisodeTally:
    """What is known of an episode without its reward."""

    episode_id: str
    world: int
    purpose: str = ""
    steps: int = 0
    human_return: float = 0.0
    """Sum of r* over the states arrived in; NaN where the truth is unknown."""
    success: bool | None = None
    ended: bool = False
    state: NDArray[np.float64] | None = None
    """(S,) of the last instant."""

    def add(self, instant: Instant) -> None:
        """Take the next instant."""
        self.steps, self.purpose = instant.step, instant.purpose
        self.state = instant.values
        if instant.step > 0:
            known = instant.human_reward is not None
            self.human_return += float(instant.human_reward) if known else math.nan
        if instant.is_last:
            self.ended, self.success = True, instant.success


class _Tallying:
    """Counts what every episode of the round brings."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self.tallies: dict[str, EpisodeTally] = {}

    def begin(self, episode_ids: Sequence[str]) -> None:
        """A round begins."""
        self.tallies = {name: EpisodeTally(name, world) for world, name in enumerate(episode_ids)}

    def _observe(self, instants: Sequence[Instant]) -> NDArray[np.float32]:
        observations = []
        for instant in instants:
            tally = self.tallies[instant.episode_id]
            observations.append(observe(self._task, instant.values, tally.state))
            tally.add(instant)
        return np.stack(observations)  # (W, F)


class TrainingPlayer(_Tallying):
    """Acts as the policy under training and stages what it sees.

    :param number: of the episode, the same in every world.
    """

    def __init__(self, task: Task, learning: Learning, number: int) -> None:
        super().__init__(task)
        self._learning = learning
        self._number = number
        explores = learning.schedule.explores
        self.behaviour = "random" if explores else f"sac-{learning.schedule.steps:09d}"

    def act(self, instants: Sequence[Instant]) -> Sequence[NDArray[np.float64]]:
        """Stage the instants and choose actions."""
        stager = self._learning.stager
        observations = self._observe(instants)
        for instant, observation in zip(instants, observations, strict=True):
            stager.observe(
                instant.episode_id,
                self._number,
                instant.world,
                instant.step,
                observation,
                instant.is_last,
                instant.terminated,
            )
        on = [i for i, instant in enumerate(instants) if not instant.is_last]
        if not on:
            return []
        actions = self._learning.act(observations[on])
        for i, action in zip(on, actions, strict=True):
            stager.act(instants[i].episode_id, instants[i].step, action)
        return list(actions)

    def acted(self, actions: int) -> None:
        """Count the steps; at a block's end this waits for the gradient steps of the last one."""
        self._learning.advance(actions)


class EvaluationPlayer(_Tallying):
    """Acts as a policy would without noise."""

    def __init__(self, task: Task, trainer: SacTrainer, behaviour: str) -> None:
        super().__init__(task)
        self._trainer = trainer
        self.behaviour = behaviour

    def act(self, instants: Sequence[Instant]) -> Sequence[NDArray[np.float64]]:
        """Choose the most likely actions."""
        observations = self._observe(instants)
        on = [i for i, instant in enumerate(instants) if not instant.is_last]
        return list(self._trainer.act(observations[on], deterministic=True)) if on else []

    def acted(self, actions: int) -> None:
        """Nothing follows."""
