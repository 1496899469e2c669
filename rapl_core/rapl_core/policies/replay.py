"""Replay of complete episodes: the buffer of stable-baselines3, filled an episode at a time."""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from rapl_core.errors import ShapeError
from rapl_core.policies.checkpoint import Part
from rapl_core.policies.transitions import EpisodeTransitions

_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones")


class _Span(NamedTuple):
    """Where an episode lies; it may run over the end of the buffer to its beginning."""

    episode_id: str
    start: int
    length: int


class EpisodeReplay(ReplayBuffer):
    """A ring of transitions that knows which episode each belongs to.

    Samples with a generator of its own instead of numpy's global one, so that learning follows
    from its seed whatever else the process does.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        rng: np.random.Generator,
        **options: Any,
    ) -> None:
        super().__init__(
            buffer_size, observation_space, action_space, handle_timeout_termination=False,
            **options,
        )  # fmt: skip
        self.rng = rng
        self._spans: deque[_Span] = deque()

    def extend(self, episode: EpisodeTransitions) -> None:
        """Append the transitions of an episode; the oldest make room.

        :raises ShapeError: if its sizes are not the buffer's.
        """
        steps = len(episode.actions)
        observed = episode.observations.shape[1:], episode.actions.shape[1:]
        if observed != (self.obs_shape, (self.action_dim,)) or steps > self.buffer_size:
            raise ShapeError(
                f"episode {episode.episode_id} has {steps} transitions of shapes {observed}; "
                f"expected at most {self.buffer_size} of {(self.obs_shape, (self.action_dim,))}"
            )
        at = (self.pos + np.arange(steps)) % self.buffer_size  # (T,)
        self.observations[at, 0] = episode.observations[:-1]
        self.next_observations[at, 0] = episode.observations[1:]
        self.actions[at, 0] = episode.actions
        self.rewards[at, 0] = episode.rewards
        self.dones[at, 0] = 0.0  # a time limit is no end: the critic bootstraps through it
        self.dones[at[-1], 0] = float(episode.terminated)
        self._forget_overwritten(steps)
        self._spans.append(_Span(episode.episode_id, self.pos, steps))
        self.full = self.full or self.pos + steps >= self.buffer_size
        self.pos = (self.pos + steps) % self.buffer_size

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """Return transitions drawn uniformly, with replacement."""
        return self._get_samples(self.rng.integers(self.size(), size=batch_size), env)

    def episode_ids(self) -> list[str]:
        """Return the episodes that are held entirely, the oldest first."""
        return [span.episode_id for span in self._spans]

    def lengths(self) -> dict[str, int]:
        """Return T of the episodes that are held entirely, the oldest first."""
        return {span.episode_id: span.length for span in self._spans}

    def relabel(self, rewards: Mapping[str, NDArray[np.float64]]) -> int:
        """Give episodes new rewards, drop those that have none, and return how many are left.

        :param rewards: (T,) by episode id.
        :raises ShapeError: if rewards are of another number; nothing has changed then.
        """
        kept = [span for span in self._spans if span.episode_id in rewards]
        for span in kept:
            if rewards[span.episode_id].shape != (span.length,):
                raise ShapeError(
                    f"new rewards of episode {span.episode_id} have shape "
                    f"{rewards[span.episode_id].shape}, expected ({span.length},)"
                )
        at = np.concatenate(
            [(s.start + np.arange(s.length)) % self.buffer_size for s in kept]
            or [np.zeros(0, dtype=np.int64)]
        )
        for name in _ARRAYS:
            array = getattr(self, name)
            array[: len(at)] = array[at]
        self.clear()
        for span in kept:
            self.rewards[self.pos : self.pos + span.length, 0] = rewards[span.episode_id]
            self._spans.append(span._replace(start=self.pos))
            self.pos += span.length
        self.full = self.pos == self.buffer_size
        self.pos %= self.buffer_size
        return len(kept)

    def clear(self) -> None:
        """Drop all transitions."""
        self.reset()
        self._spans.clear()

    def state(self) -> Part:
        """Return what a checkpoint needs."""
        return Part(
            arrays={name: getattr(self, name)[: self.size()] for name in _ARRAYS},
            values={
                "pos": self.pos,
                "full": self.full,
                "spans": [list(span) for span in self._spans],
                "rng": self.rng.bit_generator.state,
            },
        )

    def restore(self, part: Part) -> None:
        """Go on where :meth:`state` was taken."""
        self.clear()
        for name in _ARRAYS:
            getattr(self, name)[: len(part.arrays[name])] = part.arrays[name]
        self.pos = int(part.values["pos"])
        self.full = bool(part.values["full"])
        self._spans.extend(_Span(str(i), int(s), int(n)) for i, s, n in part.values["spans"])
        self.rng.bit_generator.state = part.values["rng"]

    def _forget_overwritten(self, steps: int) -> None:
        """Drop the spans of which ``steps`` new transitions overwrite some."""
        while self._spans:
            oldest = self._spans[0]
            free = (oldest.start - self.pos) % self.buffer_size
            if not self.full and oldest.start < self.pos:
                free = self.buffer_size - self.pos + oldest.start
            if steps <= free:
                return
            self._spans.popleft()
