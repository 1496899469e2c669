"""Transitions on their way to the replay buffer: held by episode until the reward is there."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rapl_core.policies.checkpoint import Part
from rapl_core.policies.transitions import EpisodeTransitions


@dataclass
class _Staged:
    """An episode that began and is neither released nor dropped."""

    number: int
    world: int
    observations: list[NDArray[np.float32]] = field(default_factory=list)
    actions: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    complete: bool = False
    terminated: bool = False
    rewards: NDArray[np.float64] | None = None

    @property
    def order(self) -> tuple[int, int]:
        return self.number, self.world

    @property
    def resolved(self) -> bool:
        return self.complete and self.rewards is not None


class EpisodeStager:
    """Collects observations and actions by episode and releases what is complete and rewarded.

    Every episode that began ends in one of two ways: released, in the order of (number, world),
    or dropped, with the reason in :attr:`dropped`. A repeated observation or action is ignored;
    a later reward replaces an earlier one until the episode is released.
    """

    def __init__(self) -> None:
        self._staged: dict[str, _Staged] = {}
        self._settled: set[str] = set()
        self.released = 0
        """Episodes released so far."""
        self.dropped: dict[str, str] = {}
        """Reason by episode id."""

    def observe(
        self,
        episode_id: str,
        number: int,
        world: int,
        step: int,
        observation: NDArray[np.float32],
        is_last: bool = False,
        terminated: bool = False,
    ) -> bool:
        """Take the observation (F,) of one instant and return whether it is new.

        The first of an episode begins it and ends, incomplete, those before it in its world.
        """
        if episode_id in self._settled:
            return False
        staged = self._staged.get(episode_id)
        if staged is None:
            self._abandon_before(number, world)
            staged = self._staged[episode_id] = _Staged(number, world)
        seen = len(staged.observations)
        if step < seen:
            return False
        if step > seen:
            self._drop(episode_id, f"state missing at step {seen}")
            return False
        staged.observations.append(np.asarray(observation, dtype=np.float32))
        if is_last:
            self._complete(episode_id, staged, terminated)
        return True

    def act(self, episode_id: str, step: int, action: NDArray[np.float64]) -> None:
        """Take the action (A,) that answered the observation of ``step``."""
        staged = self._staged.get(episode_id)
        if staged is not None:
            staged.actions.setdefault(step, np.asarray(action, dtype=np.float32))

    def reward(
        self,
        episode_id: str,
        valid: bool,
        values: NDArray[np.float64] | None = None,
        reason: str = "",
    ) -> bool:
        """Take the reward (T,) of an episode and return whether it counts.

        :param valid: False: the episode is dropped for ``reason``.
        """
        staged = self._staged.get(episode_id)
        if staged is None:
            return False
        if not valid or values is None:
            self._drop(episode_id, reason or "reward not valid")
            return False
        staged.rewards = np.asarray(values, dtype=np.float64)
        return self._check_rewards(episode_id, staged)

    def unresolved(self, up_to_number: int | None = None) -> list[str]:
        """Return the episodes, numbered up to ``up_to_number``, that still lack something."""
        return sorted(
            episode_id
            for episode_id, staged in self._staged.items()
            if not staged.resolved and (up_to_number is None or staged.number <= up_to_number)
        )

    @property
    def unrewarded(self) -> int:
        """How many complete episodes wait for their reward."""
        return sum(s.complete and s.rewards is None for s in self._staged.values())

    def release(self, up_to_number: int) -> list[EpisodeTransitions]:
        """Return what is complete and rewarded, numbered up to so much, by (number, world)."""
        ready = sorted(
            (staged.order, episode_id)
            for episode_id, staged in self._staged.items()
            if staged.resolved and staged.number <= up_to_number
        )
        return [self._release(episode_id) for _, episode_id in ready]

    def rewarded(self) -> dict[str, int]:
        """Return T of the rewards of every staged episode that has some, by episode id."""
        return {
            episode_id: len(staged.rewards)
            for episode_id, staged in sorted(self._staged.items())
            if staged.rewards is not None
        }

    def forget_rewards(self) -> list[str]:
        """Take back the rewards of what is staged, e.g. after an encoder swap; return the ids."""
        held = sorted(i for i, staged in self._staged.items() if staged.rewards is not None)
        for episode_id in held:
            self._staged[episode_id].rewards = None
        return held

    def drop(self, episode_id: str, reason: str) -> None:
        """Give up an episode, e.g. because its reward is overdue."""
        if episode_id in self._staged:
            self._drop(episode_id, reason)

    def state(self) -> Part:
        """Return what a checkpoint needs: complete, rewarded episodes and the counts."""
        arrays: dict[str, NDArray[np.float32] | NDArray[np.float64]] = {}
        episodes = []
        ready = {i: s for i, s in self._staged.items() if s.resolved}
        for position, (episode_id, staged) in enumerate(ready.items()):
            rewards = staged.rewards
            assert rewards is not None
            arrays[f"{position}.observations"] = np.stack(staged.observations)
            arrays[f"{position}.actions"] = _stack_actions(staged)
            arrays[f"{position}.rewards"] = rewards
            episodes.append([episode_id, staged.number, staged.world, staged.terminated])
        return Part(
            arrays=arrays,
            values={
                "episodes": episodes,
                "settled": sorted(self._settled),
                "released": self.released,
                "dropped": self.dropped,
            },
        )

    def restore(self, part: Part) -> None:
        """Go on where :meth:`state` was taken; episodes that were under way then are gone."""
        self._staged = {}
        for position, (episode_id, number, world, terminated) in enumerate(part.values["episodes"]):
            self._staged[episode_id] = _Staged(
                number=number,
                world=world,
                observations=list(part.arrays[f"{position}.observations"]),
                actions=dict(enumerate(part.arrays[f"{position}.actions"])),
                complete=True,
                terminated=terminated,
                rewards=part.arrays[f"{position}.rewards"],
            )
        self._settled = set(part.values["settled"])
        self.released = int(part.values["released"])
        self.dropped = dict(part.values["dropped"])

    def _complete(self, episode_id: str, staged: _Staged, terminated: bool) -> None:
        missing = set(range(len(staged.observations) - 1)) - set(staged.actions)
        if missing:
            self._drop(episode_id, f"action missing at step {min(missing)}")
            return
        staged.complete = True
        staged.terminated = terminated
        self._check_rewards(episode_id, staged)

    def _check_rewards(self, episode_id: str, staged: _Staged) -> bool:
        """Drop the episode if its rewards do not fit; only a complete one can tell."""
        if staged.rewards is None:
            return False
        if not np.all(np.isfinite(staged.rewards)):
            self._drop(episode_id, "reward not finite")
            return False
        steps = len(staged.observations) - 1
        if staged.complete and staged.rewards.shape != (steps,):
            self._drop(episode_id, f"{staged.rewards.size} rewards for {steps} transitions")
            return False
        return True

    def _abandon_before(self, number: int, world: int) -> None:
        for episode_id, staged in list(self._staged.items()):
            if staged.world == world and staged.number < number and not staged.complete:
                self._drop(episode_id, f"ended at step {len(staged.observations) - 1}")

    def _drop(self, episode_id: str, reason: str) -> None:
        del self._staged[episode_id]
        self._settled.add(episode_id)
        self.dropped[episode_id] = reason

    def _release(self, episode_id: str) -> EpisodeTransitions:
        staged = self._staged.pop(episode_id)
        self._settled.add(episode_id)
        self.released += 1
        assert staged.rewards is not None
        return EpisodeTransitions(
            episode_id=episode_id,
            number=staged.number,
            world=staged.world,
            observations=np.stack(staged.observations),
            actions=_stack_actions(staged),
            rewards=staged.rewards,
            terminated=staged.terminated,
        )


def _stack_actions(staged: _Staged) -> NDArray[np.float32]:
    """Actions (T, A) in the order of steps."""
    return np.stack([staged.actions[step] for step in range(len(staged.observations) - 1)])
