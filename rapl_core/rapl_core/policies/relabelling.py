"""Rewards anew for the episodes that learning holds, once rewards come from another source."""

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RaplError
from rapl_core.policies.checkpoint import Part
from rapl_core.policies.learning import Learning
from rapl_core.policies.rewards import RewardSource

BATCH = 16
"""Episodes asked for at once."""


class Relabelling:
    """What is still to be asked for, and what has come of it.

    The driver asks somebody for the rewards of :meth:`next` and hands them to :meth:`take`, until
    :attr:`is_done`; or it gives up. All rewards are of one source: where another one answers in
    between, all are asked for anew. An episode that nobody can reward is asked for once more at the
    end, for its video may be on its way to the disk, and is lost then.

    :param lengths: T of each episode by id.
    """

    def __init__(self, lengths: Mapping[str, int], batch: int = BATCH) -> None:
        self._lengths = dict(lengths)
        self._open = deque(self._lengths)
        self._asked: tuple[str, ...] = ()
        self._missed: set[str] = set()
        self._batch = batch
        self.source: RewardSource | None = None
        """Of all rewards so far."""
        self.rewards: dict[str, NDArray[np.float64]] = {}
        """(T,) by episode id."""
        self.lost: dict[str, str] = {}
        """Reason by episode id."""

    @property
    def total(self) -> int:
        """Episodes to be rewarded."""
        return len(self._lengths)

    @property
    def is_done(self) -> bool:
        """Whether every episode is rewarded or lost."""
        return not self._open

    @property
    def asks_again(self) -> bool:
        """Whether all that is left was missing before: time may help."""
        return bool(self._open) and self._missed.issuperset(self._open)

    def next(self) -> tuple[str, ...]:
        """The episodes to ask for now; the same ones until they were taken."""
        self._asked = tuple(self._open)[: self._batch]
        return self._asked

    def take(
        self,
        source: RewardSource | None,
        rewards: Mapping[str, NDArray[np.float64]],
        missing: Mapping[str, str],
    ) -> None:
        """Take the answer to :meth:`next`.

        :param source: of these rewards; None where there are none.
        :param rewards: (T,) by episode id.
        :param missing: why there is none, by episode id.
        """
        asked, self._asked = self._asked, ()
        if source is not None and self.source not in (None, source):
            self._open.extend(self.rewards)
            self.rewards = {}
        self.source = source or self.source
        for episode_id in asked:
            self._open.remove(episode_id)
            problem = self._problem(episode_id, rewards.get(episode_id))
            if not problem:
                self.rewards[episode_id] = np.asarray(rewards[episode_id], dtype=np.float64)
            elif episode_id in rewards or episode_id in self._missed:
                self.lost[episode_id] = missing.get(episode_id, problem)
            else:
                self._missed.add(episode_id)
                self._open.append(episode_id)

    def give_up(self, reason: str) -> int:
        """Lose what is still open; returns how many that are."""
        left = len(self._open)
        self.lost |= dict.fromkeys(self._open, reason)
        self._open.clear()
        return left

    def _problem(self, episode_id: str, values: NDArray[np.float64] | None) -> str:
        """Why these are no rewards of the episode, or nothing."""
        steps = self._lengths[episode_id]
        if values is None:
            return "nobody could reward it"
        if values.shape != (steps,):
            return f"{values.size} rewards for {steps} transitions"
        return "" if np.isfinite(values).all() else "reward not finite"


class RewardLabels:
    """By which source each reward that learning holds was given.

    ``learning.reward_source`` is the one that counts; what another one gave is outdated and must
    be rewarded again before it is learnt from. The replay buffer is always of one source.
    """

    def __init__(self, learning: Learning) -> None:
        self._learning = learning
        self._replay: RewardSource | None = None
        self._staged: dict[str, RewardSource] = {}

    def note(self, episode_id: str, source: RewardSource) -> None:
        """A staged episode was rewarded by ``source``."""
        held = self._learning.stager.rewarded()
        self._staged = {name: s for name, s in self._staged.items() if name in held}
        if episode_id in held:
            self._staged[episode_id] = source

    def released(self) -> None:
        """Staged episodes go to the replay buffer; nothing may be outdated."""
        if self.outdated():
            raise RaplError(f"{len(self.outdated())} episodes have outdated rewards")
        self._replay = self._learning.reward_source

    def outdated(self) -> dict[str, int]:
        """T of every episode that must be rewarded again; those of the replay buffer first."""
        learning = self._learning
        lengths: dict[str, int] = {}
        if self._replay not in (None, learning.reward_source):
            lengths |= learning.trainer.replay.lengths()
        for name, steps in learning.stager.rewarded().items():
            if self._staged.get(name, self._replay) not in (None, learning.reward_source):
                lengths[name] = steps
        return lengths

    def apply(self, relabelling: Relabelling) -> None:
        """Put new rewards in place of outdated ones and drop what has none.

        Its source counts from now on. What was rewarded by yet another one meanwhile is outdated
        then, and the next relabelling asks for it. Gradient steps under way are waited for.

        :raises RaplError: if it is not done.
        """
        if not relabelling.is_done:
            raise RaplError("there are episodes that are neither rewarded again nor lost")
        learning = self._learning
        done = {
            **dict.fromkeys(relabelling.rewards, True),
            **dict.fromkeys(relabelling.lost, False),
        }
        held = learning.trainer.replay.lengths()
        if done.keys() & held.keys():
            learning.relabel({n: r for n, r in relabelling.rewards.items() if n in held})
            self._replay = relabelling.source
        for name in done.keys() & learning.stager.rewarded().keys():
            if done[name]:
                learning.stager.reward(name, True, relabelling.rewards[name])
                assert relabelling.source is not None
                self._staged[name] = relabelling.source
            else:
                learning.stager.drop(name, relabelling.lost[name])
        if relabelling.source is not None:
            learning.reward_source = relabelling.source
        elif not learning.trainer.replay.size():
            self._replay = learning.reward_source

    def clear(self) -> None:
        """Forget the replay buffer, and with it what is outdated there."""
        self._learning.relabel({})
        self._replay = self._learning.reward_source

    def state(self) -> Part:
        """Return what a checkpoint needs."""
        return Part(
            values={
                "replay": None if self._replay is None else asdict(self._replay),
                "staged": {name: asdict(source) for name, source in self._staged.items()},
            }
        )

    def restore(self, part: Part | None) -> None:
        """Go on where :meth:`state` was taken; None: all is of the source that counted then."""
        if part is None:
            self._replay, self._staged = self._learning.reward_source, {}
            return
        replay = part.values["replay"]
        self._replay = None if replay is None else RewardSource(**replay)
        self._staged = {name: RewardSource(**s) for name, s in part.values["staged"].items()}
