"""Episodes of all worlds in lockstep, without ROS."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.policies.observation import observe
from rapl_core.simulation.simulation import Simulation, Snapshot, episode_rng
from rapl_core.tasks import Task
from rapl_core.types import Episode

Act = Callable[[int, NDArray[np.float32]], NDArray[np.float64]]
"""Step and observations (W, F) of all worlds in order, to actions (W, A)."""


@dataclass(frozen=True)
class EndedEpisode:
    """An episode and what its last instant says to a learner."""

    episode: Episode
    last_observation: NDArray[np.float32]
    """(F,)."""
    terminated: bool


class Rollout:
    """Runs one episode of every world at a time.

    :param seed: with purpose, world and number of the episode it decides the start.
    """

    def __init__(self, simulation: Simulation, seed: int) -> None:
        self._simulation = simulation
        self._seed = seed

    def ids(self, purpose: str, number: int) -> list[str]:
        """Return the ids of the episodes ``number``, by world."""
        return [
            f"{purpose}-s{self._seed}-w{world}-{number:06d}"
            for world in range(self._simulation.worlds)
        ]

    def run(
        self,
        purpose: str,
        number: int,
        act: Act,
        frames: bool,
        stepped: Callable[[int], None] | None = None,
    ) -> list[EndedEpisode]:
        """Return episode ``number`` of every world, in order.

        :param act: asked once for each control period.
        :param frames: whether to draw pictures; without, they have no pixels: (T + 1, 0, 0, 3).
        :param stepped: called with the number of worlds after each control period.
        """
        simulation = self._simulation
        task = simulation.task
        worlds = range(simulation.worlds)
        tracks = [_Track() for _ in worlds]
        for world in worlds:
            rng = episode_rng(self._seed, purpose, world, number)
            tracks[world].add(simulation.reset(world, rng), self._picture(world, frames))
        for step in range(task.horizon):
            observations = np.stack([t.observe(task) for t in tracks])  # (W, F)
            actions = act(step, observations)
            for world in worlds:
                snapshot = simulation.step(world, actions[world])
                tracks[world].actions.append(actions[world])
                tracks[world].add(snapshot, self._picture(world, frames))
            if stepped is not None:
                stepped(len(worlds))
        ids = self.ids(purpose, number)
        return [self._ended(ids[w], purpose, w, number, tracks[w]) for w in worlds]

    def _picture(self, world: int, frames: bool) -> NDArray[np.uint8]:
        if not frames:
            return np.zeros((0, 0, 3), dtype=np.uint8)
        return self._simulation.render(world)

    def _ended(
        self, episode_id: str, purpose: str, world: int, number: int, track: "_Track"
    ) -> EndedEpisode:
        task: Task = self._simulation.task
        period_ns = round(task.period_s * 1e9)
        first = number * (task.horizon + 1)
        episode = Episode(
            episode_id=episode_id,
            task=task.name,
            world=world,
            purpose=purpose,
            controller="learner",
            frames=np.stack(track.pictures),
            states=np.stack([snapshot.state for snapshot in track.snapshots]),
            actions=np.stack(track.actions),
            stamps_ns=(first + np.arange(task.horizon + 1, dtype=np.int64)) * period_ns,
            human_rewards=np.array([snapshot.human_reward for snapshot in track.snapshots]),
            success=track.last.success,
            behaviour="policy",
        )
        return EndedEpisode(episode, track.observe(task), track.last.terminated)


class _Track:
    """An episode under way."""

    def __init__(self) -> None:
        self.snapshots: list[Snapshot] = []
        self.pictures: list[NDArray[np.uint8]] = []
        self.actions: list[NDArray[np.float64]] = []

    @property
    def last(self) -> Snapshot:
        return self.snapshots[-1]

    def observe(self, task: Task) -> NDArray[np.float32]:
        """What the policy sees of the last snapshot."""
        before = self.snapshots[-2].state if len(self.snapshots) > 1 else None
        return observe(task, self.last.state, before)

    def add(self, snapshot: Snapshot, picture: NDArray[np.uint8]) -> None:
        self.snapshots.append(snapshot)
        self.pictures.append(picture)
