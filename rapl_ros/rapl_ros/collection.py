"""Collecting demonstrations: which episode shows what, and which are still to be recorded.

Knows neither ROS nor wall clock; the node gives it states and tells it what was recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rapl_core.demonstrators import (
    Demonstrator,
    behaviour_names,
    draw_behaviours,
    make_demonstrator,
)
from rapl_core.demonstrators.collecting import NOISES
from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.simulation.simulation import STREAMS
from rapl_core.tasks.base import Task
from rapl_ros.wire import Command, Instant, answer

UNRECORDED_EPISODES = 2
"""A world; while more lack their recording no new episode begins."""


@dataclass(frozen=True)
class CollectionGoal:
    """What is to be collected (goal of Collect.action)."""

    episodes: int
    """To be recorded, over all worlds."""
    behaviours: tuple[str, ...] = ()
    """Drawn in their shares; empty: all that the task has."""
    noise: float = 0.0
    """Standard deviation of action noise; negative: drawn for each episode."""
    seed: int = 0
    purpose: str = "demonstrate"
    first_episode: int = 0
    """Number of the first one in each world."""


@dataclass(frozen=True)
class Batch:
    """One reset: so many episodes in each of these worlds."""

    worlds: tuple[int, ...]
    episodes: int
    first_episode: int


@dataclass
class _Slot:
    """One world's part of the collection."""

    number: int
    remaining: int
    episode_id: str
    """Empty between two episodes."""
    demonstrator: Demonstrator | None = None
    behaviour: str = ""
    last: Command | None = None


class Collection:
    """One collection under way.

    :param goal: what is wanted.
    :param worlds: how many there are.
    :raises UnknownNameError: if a behaviour or the purpose is unknown.
    :raises RaplError: if no episode is asked for, or noise is negative.
    """

    def __init__(self, task: Task, goal: CollectionGoal, worlds: int) -> None:
        known = behaviour_names(task)
        unknown = [behaviour for behaviour in goal.behaviours if behaviour not in known]
        if unknown:
            raise UnknownNameError("behaviour", unknown[0], known)
        if goal.purpose not in STREAMS:
            raise UnknownNameError("purpose", goal.purpose, STREAMS)
        if goal.episodes < 1 or not np.isfinite(goal.noise):
            raise RaplError(
                f"cannot collect {goal.episodes} episodes with noise {goal.noise}: "
                "expected at least one episode and finite noise"
            )
        self.goal = goal
        self.recorded: list[str] = []
        self.dropped: list[str] = []
        self._task = task
        self._worlds = worlds
        self._behaviours: dict[tuple[int, int], str] = {}
        self._next_number = goal.first_episode
        self._slots: dict[int, _Slot] = {}
        self._unrecorded: dict[str, float] = {}
        self._held: dict[int, Instant] = {}

    @property
    def is_complete(self) -> bool:
        """Whether as many as wanted are recorded."""
        return len(self.recorded) >= self.goal.episodes

    @property
    def needs_reset(self) -> bool:
        """Whether nothing is under way or waits for its recording, and some are still wanted."""
        under_way = any(slot.remaining for slot in self._slots.values())
        return not (self.is_complete or under_way or self._unrecorded)

    @property
    def must_wait(self) -> bool:
        """Whether too many episodes lack their recording to begin another."""
        return len(self._unrecorded) > UNRECORDED_EPISODES * self._worlds

    def plan(self) -> list[Batch]:
        """Resets that bring the episodes still wanted; numbers are never used twice."""
        self._slots.clear()
        self._held.clear()
        wanted = self.goal.episodes - len(self.recorded)
        each, rest = divmod(wanted, self._worlds)
        first = self._next_number
        self._next_number += each + (rest > 0)
        rng = self._rng(first)
        drawn = draw_behaviours(self._task, wanted, rng, self.goal.behaviours)
        for index, behaviour in enumerate(drawn):
            number, world = divmod(index, self._worlds)
            self._behaviours[world, first + number] = behaviour
        batches = []
        if rest:
            batches.append(Batch(tuple(range(rest)), each + 1, first))
        if each:
            batches.append(Batch(tuple(range(rest, self._worlds)), each, first))
        return batches

    def begin(self, batch: Batch, episode_ids: Sequence[str]) -> None:
        """The simulator has begun ``batch``; ``episode_ids`` are the first ones."""
        for world, episode_id in zip(batch.worlds, episode_ids, strict=True):
            self._slots[world] = _Slot(batch.first_episode, batch.episodes, episode_id)

    def act(self, instant: Instant, now_s: float) -> Command | None:
        """The action that answers ``instant``; None if it needs none, or none yet."""
        slot = self._slots.get(instant.world)
        if slot is None or slot.remaining == 0:
            return None
        if not slot.episode_id and instant.step == 0 and not self._has_ended(instant.episode_id):
            slot.number, slot.episode_id, slot.last = slot.number + 1, instant.episode_id, None
        if instant.episode_id != slot.episode_id:
            return None
        if instant.is_last:
            self._unrecorded[instant.episode_id] = now_s
            slot.remaining -= 1
            slot.episode_id = ""
            return None
        if slot.last is not None and slot.last.step == instant.step:
            return slot.last  # repeated by the simulator: a demonstrator moves on when asked twice
        if instant.step == 0:
            if self.must_wait:
                self._held[instant.world] = instant
                return None
            self._start(slot, instant.world)
        if slot.demonstrator is None:
            return None  # it began before this collection knew it
        action = slot.demonstrator.act(instant.values, instant.step)
        slot.last = answer(instant, np.clip(action, -1.0, 1.0), slot.behaviour)
        return slot.last

    def record(self, episode_id: str, now_s: float) -> list[Command]:
        """An episode is on disk; returns the first actions that were held back for it."""
        if self._unrecorded.pop(episode_id, None) is None:
            return []
        self.recorded.append(episode_id)
        return self._release(now_s)

    def expire(self, now_s: float, deadline_s: float) -> list[Command]:
        """Give up episodes whose recording is late; returns actions that were held back."""
        late = [e for e, ended_s in self._unrecorded.items() if now_s - ended_s > deadline_s]
        for episode_id in late:
            del self._unrecorded[episode_id]
            self.dropped.append(episode_id)
        return self._release(now_s) if late else []

    def interrupt(self) -> None:
        """The simulator has gone: what was under way there is lost, what ended may be recorded."""
        self.dropped += [slot.episode_id for slot in self._slots.values() if slot.episode_id]
        self._slots.clear()
        self._held.clear()

    def _start(self, slot: _Slot, world: int) -> None:
        rng = self._rng(slot.number, world)
        noise = self.goal.noise if self.goal.noise >= 0 else float(rng.choice(NOISES))
        slot.behaviour = self._behaviours[world, slot.number]
        slot.demonstrator = make_demonstrator(self._task, slot.behaviour, rng, noise)

    def _rng(self, *key: int) -> np.random.Generator:
        """A stream of its own for ``key``; the last number keeps it apart from the starts'."""
        goal = self.goal
        return np.random.default_rng([goal.seed, STREAMS[goal.purpose], *key, len(key), 101])

    def _release(self, now_s: float) -> list[Command]:
        if self.must_wait:
            return []
        held, self._held = self._held, {}
        commands = [self.act(instant, now_s) for instant in held.values()]
        return [command for command in commands if command is not None]

    def _has_ended(self, episode_id: str) -> bool:
        return (
            episode_id in self._unrecorded
            or episode_id in self.recorded
            or episode_id in self.dropped
        )
