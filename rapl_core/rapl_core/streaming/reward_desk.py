"""One reward for every episode that began, from whatever arrives in whatever order."""

import math
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RaplError
from rapl_core.streaming.assembler import AssemblerLimits, EpisodeAssembler, Outcome
from rapl_core.streaming.reward_rule import RewardRule, plain_reward
from rapl_core.streaming.samples import (
    DroppedEpisode,
    EmbeddingSample,
    JoinedEpisode,
    StateSample,
)
from rapl_core.types import ExpertSet, RewardTrace

RewardSource = Literal["embedding", "human_reward"]

_Value = TypeVar("_Value")
_VERSIONS_KEPT = 4


@dataclass(frozen=True)
class RewardDecision:
    """The one reward of an episode."""

    last: StateSample
    """The last state received."""
    trace: RewardTrace | None
    """None: dropped."""
    reason: str = ""
    """Why dropped."""
    encoder: str = ""
    version: str = ""


@dataclass(frozen=True)
class DeskConfig:
    """What the reward is made of, and how long is waited for it."""

    source: RewardSource = "embedding"
    """``embedding``: from the encoder, by its own rule. ``human_reward``: r* of the states, the
    oracle; needs a simulator that knows it."""
    human_reward_scale: float = field(default=1.0, metadata={"minimum": 0.0})
    """Factor on r*, only with ``human_reward``."""
    embedding_deadline_s: float = field(default=5.0, metadata={"minimum": 0.1, "maximum": 3600.0})
    """Seconds of wall time without any embedding after which those of an ended episode are given
    up, and in which the experts of a new encoder must arrive."""
    embedding_limit_s: float = field(default=45.0, metadata={"minimum": 0.1, "maximum": 3600.0})
    """Seconds of wall time after the last state in which embeddings must arrive in any case."""
    state_deadline_s: float = field(default=5.0, metadata={"minimum": 0.1, "maximum": 3600.0})
    """Seconds of wall time without any state after which an episode has stopped."""

    def __post_init__(self) -> None:
        for name in (
            "human_reward_scale",
            "embedding_deadline_s",
            "embedding_limit_s",
            "state_deadline_s",
        ):
            if not 0 < getattr(self, name) < math.inf:
                raise RaplError(f"{name} is {getattr(self, name)}, expected more than 0")


class RewardDesk:
    """Joins, waits for the experts of the version at hand, and decides.

    Time is the caller's steady clock, in seconds.
    """

    def __init__(self, config: DeskConfig) -> None:
        self.config = config
        self.assembler = EpisodeAssembler(
            needs_embeddings=config.source == "embedding",
            limits=AssemblerLimits(
                embedding_deadline_s=config.embedding_deadline_s,
                embedding_limit_s=config.embedding_limit_s,
                state_deadline_s=config.state_deadline_s,
            ),
        )
        self.rewarded = 0
        self.dropped = 0
        self._rules: OrderedDict[str, RewardRule] = OrderedDict()
        self._experts: OrderedDict[str, ExpertSet] = OrderedDict()
        self._waiting: list[tuple[JoinedEpisode, float]] = []

    @property
    def pending(self) -> int:
        """Episodes that began and have no reward yet."""
        return len(self.assembler.open_episodes) + len(self._waiting)

    def add_state(self, state: StateSample, now_s: float) -> list[RewardDecision]:
        """Take a state."""
        return self._decide(self.assembler.add_state(state, now_s), now_s)

    def add_embedding(self, embedding: EmbeddingSample, now_s: float) -> list[RewardDecision]:
        """Take an embedding."""
        return self._decide(self.assembler.add_embedding(embedding, now_s), now_s)

    def spoil(self, image: Hashable, reason: str, now_s: float) -> list[RewardDecision]:
        """The image has no usable embedding."""
        return self._decide(self.assembler.spoil(image, reason), now_s)

    def set_rule(self, version: str, rule: RewardRule) -> list[RewardDecision]:
        """An encoder took over: rewards of its version follow ``rule``."""
        _remember(self._rules, version, rule)
        return self._retry()

    def set_experts(self, experts: ExpertSet) -> list[RewardDecision]:
        """The expert videos through one version of an encoder."""
        _remember(self._experts, experts.version, experts)
        return self._retry()

    def tick(self, now_s: float) -> list[RewardDecision]:
        """Drop what has waited too long; call it several times a second."""
        decisions = self._decide(self.assembler.expire(now_s), now_s)
        waiting, self._waiting = self._waiting, []
        for episode, since_s in waiting:
            if now_s - since_s > self.config.embedding_deadline_s:
                what = "experts" if episode.version in self._rules else "description"
                reason = f"no {what} of encoder {episode.encoder} version {episode.version} came"
                decisions.append(self._dropped(DroppedEpisode(episode.last, reason), episode))
            else:
                self._waiting.append((episode, since_s))
        return decisions

    def reward_again(self, version: str, z: NDArray[np.float32]) -> RewardTrace:
        """Reward of an episode that had its one reward before, under another version.

        :param z: (T, D) embeddings of the frames arrived in, by the encoder of this version.
        :raises RaplError: if rewards come from r*, if the version or its experts are not known
            (yet), or the embeddings do not fit.
        """
        if self.config.source != "embedding":
            raise RaplError(f"rewards come from {self.config.source}: no encoder changes them")
        if not self._knows(version):
            raise RaplError(f"encoder version {version} is not known (yet)")
        return self._by_rule(version, z)

    def _decide(self, outcomes: list[Outcome], now_s: float) -> list[RewardDecision]:
        decisions = []
        for outcome in outcomes:
            if isinstance(outcome, DroppedEpisode):
                decisions.append(self._dropped(outcome))
            elif self._can_score(outcome):
                decisions.append(self._score(outcome))
            else:
                self._waiting.append((outcome, now_s))
        return decisions

    def _retry(self) -> list[RewardDecision]:
        ready = [episode for episode, _ in self._waiting if self._can_score(episode)]
        self._waiting = [entry for entry in self._waiting if not self._can_score(entry[0])]
        return [self._score(episode) for episode in ready]

    def _can_score(self, episode: JoinedEpisode) -> bool:
        if self.config.source == "human_reward":
            return True
        return self._knows(episode.version)

    def _knows(self, version: str) -> bool:
        rule = self._rules.get(version)
        return rule is not None and (not rule.needs_experts or version in self._experts)

    def _score(self, episode: JoinedEpisode) -> RewardDecision:
        try:
            trace = self._trace(episode)
        except RaplError as error:
            return self._dropped(DroppedEpisode(episode.last, str(error)), episode)
        self.rewarded += 1
        return RewardDecision(episode.last, trace, encoder=episode.encoder, version=episode.version)

    def _trace(self, episode: JoinedEpisode) -> RewardTrace:
        if episode.embeddings is None:
            if episode.human_rewards is None:
                raise RaplError("the true reward is unknown: the states have no truth")
            return plain_reward(episode.human_rewards, self.config.human_reward_scale)
        return self._by_rule(episode.version, episode.embeddings)

    def _by_rule(self, version: str, z: NDArray[np.float32]) -> RewardTrace:
        rule = self._rules[version]
        experts = self._experts[version].experts if rule.needs_experts else ()
        return rule.reward(z, experts)

    def _dropped(
        self, outcome: DroppedEpisode, episode: JoinedEpisode | None = None
    ) -> RewardDecision:
        self.dropped += 1
        encoder, version = (episode.encoder, episode.version) if episode else ("", "")
        return RewardDecision(outcome.last, None, outcome.reason, encoder, version)


def _remember(kept: OrderedDict[str, _Value], version: str, value: _Value) -> None:
    kept[version] = value
    kept.move_to_end(version)
    while len(kept) > _VERSIONS_KEPT:
        kept.popitem(last=False)
