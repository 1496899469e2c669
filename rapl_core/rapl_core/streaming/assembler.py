"""Join states and embeddings into episodes, by the header of the image that both name."""

import math
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np

from rapl_core.streaming.samples import (
    DroppedEpisode,
    EmbeddingSample,
    JoinedEpisode,
    StateSample,
)

Outcome = JoinedEpisode | DroppedEpisode


@dataclass(frozen=True)
class AssemblerLimits:
    """How long and how much the assembler waits for."""

    embedding_deadline_s: float = 5.0
    """Wall time without any embedding after which those of an ended episode are given up. An
    encoder that has fallen behind and works through its queue is not silent."""
    embedding_limit_s: float = 45.0
    """Wall time after an episode's last state in which its embeddings must arrive in any case."""
    state_deadline_s: float = 5.0
    """Wall time without any state after which an unfinished episode has stopped. A simulator in
    lockstep repeats a pending state every second, so waiting for an action is no stop."""
    spare_embeddings: int = 4096
    """Embeddings kept whose state has not come; the oldest go first."""
    closed_episodes: int = 4096
    """Finished episode ids remembered, so that late messages do not begin them again."""


@dataclass
class _OpenEpisode:
    first: StateSample
    latest: StateSample
    heard_s: float
    states: dict[int, StateSample] = field(default_factory=dict)
    embeddings: dict[int, EmbeddingSample] = field(default_factory=dict)
    last_step: int | None = None
    ended_s: float = 0.0


class EpisodeAssembler:
    """Turns every episode that began into exactly one outcome: joined, or dropped with a reason.

    Frame 0 needs no embedding: a reward belongs to the frame that a transition arrives in. Time is
    the caller's steady clock, in seconds.

    :param needs_embeddings: False joins states only.
    :param limits: deadlines and sizes.
    """

    def __init__(
        self, needs_embeddings: bool = True, limits: AssemblerLimits | None = None
    ) -> None:
        self.needs_embeddings = needs_embeddings
        self.limits = limits or AssemblerLimits()
        self.late_states = 0
        """States of episodes that already have their outcome."""
        self.evicted_embeddings = 0
        """Embeddings no state ever named."""
        self._embedding_s = -math.inf
        self._open: dict[str, _OpenEpisode] = {}
        self._closed: OrderedDict[str, None] = OrderedDict()
        self._awaited: dict[Hashable, tuple[str, int]] = {}
        self._spare: OrderedDict[Hashable, EmbeddingSample] = OrderedDict()
        self._spoiled: OrderedDict[Hashable, str] = OrderedDict()

    @property
    def open_episodes(self) -> list[str]:
        """Ids of the episodes that have no outcome yet, oldest first."""
        return list(self._open)

    def add_state(self, state: StateSample, now_s: float) -> list[Outcome]:
        """Take a state; repeats are harmless."""
        if state.episode_id in self._closed:
            self.late_states += 1
            return []
        outcomes = self._drop_superseded(state)
        episode = self._open.get(state.episode_id)
        if episode is None:
            episode = _OpenEpisode(first=state, latest=state, heard_s=now_s)
            self._open[state.episode_id] = episode
        episode.heard_s = now_s
        if state.step in episode.states:
            return outcomes
        episode.states[state.step] = state
        if state.step >= episode.latest.step:
            episode.latest = state
        if state.is_last:
            episode.last_step, episode.ended_s = state.step, now_s
        problem = self._await_embedding(episode, state)
        return outcomes + self._settle(episode, problem)

    def add_embedding(self, embedding: EmbeddingSample, now_s: float = -math.inf) -> list[Outcome]:
        """Take an embedding; of two for the same image the first counts."""
        self._embedding_s = max(self._embedding_s, now_s)
        place = self._awaited.pop(embedding.image, None)
        if place is None:
            self._spare.setdefault(embedding.image, embedding)
            while len(self._spare) > self.limits.spare_embeddings:
                self._spare.popitem(last=False)
                self.evicted_embeddings += 1
            return []
        episode_id, step = place
        episode = self._open[episode_id]
        return self._settle(episode, self._attach(episode, step, embedding))

    def spoil(self, image: Hashable, reason: str) -> list[Outcome]:
        """Drop the episode that ``image`` belongs to: it has no embedding and will get none."""
        place = self._awaited.pop(image, None)
        if place is None:
            self._spoiled[image] = reason
            while len(self._spoiled) > self.limits.spare_embeddings:
                self._spoiled.popitem(last=False)
            return []
        episode_id, step = place
        return [self._drop(self._open[episode_id], f"image of step {step}: {reason}")]

    def expire(self, now_s: float) -> list[Outcome]:
        """Drop the episodes whose deadline has passed."""
        outcomes: list[Outcome] = []
        for episode in list(self._open.values()):
            if episode.last_step is None:
                silent_s = now_s - episode.heard_s
                if silent_s > self.limits.state_deadline_s:
                    reason = (
                        f"stopped at step {episode.latest.step}: "
                        f"no state for {self.limits.state_deadline_s:g} s"
                    )
                    outcomes.append(self._drop(episode, reason))
                continue
            waited_s = now_s - episode.ended_s
            silent_s = now_s - max(episode.ended_s, self._embedding_s)
            if (
                silent_s > self.limits.embedding_deadline_s
                or waited_s > self.limits.embedding_limit_s
            ):
                outcomes.append(self._drop(episode, self._what_is_missing(episode)))
        return outcomes

    def _drop_superseded(self, state: StateSample) -> list[Outcome]:
        """A world has one episode at a time: a new one ends the unfinished one."""
        return [
            self._drop(other, f"stopped at step {other.latest.step}: {state.episode_id} began")
            for other in list(self._open.values())
            if other.first.world == state.world
            and other.first.episode_id != state.episode_id
            and other.last_step is None
        ]

    def _await_embedding(self, episode: _OpenEpisode, state: StateSample) -> str:
        if not self.needs_embeddings or state.step == 0:
            return ""
        if state.image in self._spoiled:
            return f"image of step {state.step}: {self._spoiled.pop(state.image)}"
        embedding = self._spare.pop(state.image, None)
        if embedding is None:
            self._awaited[state.image] = (state.episode_id, state.step)
            return ""
        return self._attach(episode, state.step, embedding)

    def _attach(self, episode: _OpenEpisode, step: int, embedding: EmbeddingSample) -> str:
        """Attach and return what is wrong with it, or nothing."""
        if not np.all(np.isfinite(embedding.values)):
            return f"embedding of step {step} has NaN or infinite values"
        for other_step, other in episode.embeddings.items():
            if other.version != embedding.version:
                return (
                    f"two encoder versions: {other.version} at step {other_step}, "
                    f"{embedding.version} at step {step}"
                )
            if other.values.shape != embedding.values.shape:
                return (
                    f"embedding of step {step} has {embedding.values.size} values, "
                    f"that of step {other_step} has {other.values.size}"
                )
            break
        episode.embeddings[step] = embedding
        return ""

    def _settle(self, episode: _OpenEpisode, problem: str) -> list[Outcome]:
        if problem:
            return [self._drop(episode, problem)]
        last = episode.last_step
        if last is None or len(episode.states) != last + 1:
            return []
        if self.needs_embeddings and len(episode.embeddings) != last:
            return []
        self._close(episode)
        return [self._join(episode, last)]

    def _join(self, episode: _OpenEpisode, last: int) -> Outcome:
        last_state = episode.latest
        if last == 0:
            return DroppedEpisode(last_state, "it has no transition")
        arrived = [episode.states[step] for step in range(1, last + 1)]
        truth = (
            np.array([state.human_reward for state in arrived], dtype=np.float64)  # (T,)
            if all(state.human_reward is not None for state in arrived)
            else None
        )
        if not self.needs_embeddings:
            return JoinedEpisode(last_state, truth, None)
        samples = [episode.embeddings[step] for step in range(1, last + 1)]
        values = np.stack([sample.values for sample in samples]).astype(np.float32)  # (T, D)
        return JoinedEpisode(last_state, truth, values, samples[0].encoder, samples[0].version)

    def _what_is_missing(self, episode: _OpenEpisode) -> str:
        last = episode.last_step or 0
        states = [step for step in range(last + 1) if step not in episode.states]
        if states:
            return f"state missing at step {states[0]} ({len(states)} of {last + 1} missing)"
        steps = [step for step in range(1, last + 1) if step not in episode.embeddings]
        if len(steps) == last:
            return "no embedding arrived: no encoder at work"
        return f"embedding missing at step {steps[0]} ({len(steps)} of {last} missing)"

    def _drop(self, episode: _OpenEpisode, reason: str) -> DroppedEpisode:
        self._close(episode)
        return DroppedEpisode(episode.latest, reason)

    def _close(self, episode: _OpenEpisode) -> None:
        del self._open[episode.first.episode_id]
        for state in episode.states.values():
            self._awaited.pop(state.image, None)
        self._closed[episode.first.episode_id] = None
        while len(self._closed) > self.limits.closed_episodes:
            self._closed.popitem(last=False)
