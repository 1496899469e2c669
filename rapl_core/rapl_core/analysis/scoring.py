"""Videos of a run seen through its encoder: rewards, plans, and how they agree with the human."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.analysis import measures
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError
from rapl_core.transport.config import TransportConfig
from rapl_core.transport.costs import pairwise_cost
from rapl_core.transport.solvers import solve
from rapl_core.types import EmbeddedEpisode, EncoderInfo, Episode, RewardTrace


class RewardingEncoder(Protocol):
    """What is needed of an encoder here."""

    @property
    def info(self) -> EncoderInfo: ...

    @property
    def transport(self) -> TransportConfig: ...

    @property
    def reward_kind(self) -> str: ...

    @property
    def expert_ids(self) -> tuple[str, ...]: ...

    @property
    def experts(self) -> tuple[EmbeddedEpisode, ...]: ...

    def embed(self, frames: NDArray[np.uint8]) -> NDArray[np.float32]: ...

    def embed_expert(self, episode_id: str, frames: NDArray[np.uint8]) -> EmbeddedEpisode: ...

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace: ...


SHOWN_EPSILON = 0.03
"""Share of the mean cost, for the plan that is drawn in place of a uniform one."""


@dataclass(frozen=True)
class ScoredVideo:
    """A video and what the reward says of it."""

    episode: Episode
    reward: NDArray[np.float64]
    """(T,)."""
    embedding: EmbeddedEpisode | None
    """None when the reward needs no pictures."""
    expert_id: str = ""

    @property
    def human(self) -> NDArray[np.float64] | None:
        """(T,) r* of the states arrived in; None where unknown."""
        truth = self.episode.human_rewards
        return None if truth is None else truth[1:]


class Scorer:
    """Scores videos by an encoder, or by r* itself when there is none.

    :param store: the videos.
    :param encoder: None: the ground truth is the reward.
    :param expert_ids: the preferred videos D+; not looked for where the encoder brings its own.
    """

    def __init__(
        self, store: EpisodeStore, encoder: RewardingEncoder | None, expert_ids: Sequence[str]
    ) -> None:
        self._store = store
        self._encoder = encoder
        self._known: dict[str, ScoredVideo] = {}
        self.experts: tuple[EmbeddedEpisode, ...] = ()
        if encoder is not None:
            self.experts = encoder.experts or tuple(
                encoder.embed_expert(e, store.frames(e)) for e in expert_ids
            )
        self._whole_experts: tuple[EmbeddedEpisode, ...] = ()

    def score(self, episode_id: str) -> ScoredVideo:
        """Return the video and its reward; kept for a second call.

        A preferred video is scored by the other ones: it is its own best match.
        """
        if episode_id not in self._known:
            self._known[episode_id] = self._score(self._store.load(episode_id))
        return self._known[episode_id]

    @property
    def has_plans(self) -> bool:
        """Whether the reward is one of transport to preferred videos, which are here."""
        if self._encoder is None or self._encoder.reward_kind != "ot" or len(self.experts) < 2:
            return False
        return all(e.episode_id in self._store for e in self.experts)

    def plan(self, video: ScoredVideo) -> tuple[NDArray[np.float64], str, str]:
        """Return the coupling of a video with its closest expert.

        A uniform coupling shows nothing, so an entropic one stands in for it.

        :return: (T, S) plan, id of the expert, and in words how it was found.
        """
        encoder = self._encoder
        if encoder is None or video.embedding is None or not self.has_plans:
            raise RaplError("this reward is not one of transport: it has no plan")
        config = encoder.transport
        x = torch.from_numpy(video.embedding.values.astype(np.float64))
        found = []
        self._whole_experts = self._whole_experts or tuple(
            self._embed(self._store.load(e.episode_id)) for e in self.experts
        )
        for expert in self._whole_experts:
            if expert.episode_id == video.episode.episode_id:
                continue  # a video is its own best match
            cost = pairwise_cost(
                x, torch.from_numpy(expert.values.astype(np.float64)), config.cost
            )  # (T, S)
            if config.solver == "uniform":
                epsilon = SHOWN_EPSILON * float(cost.mean())
                shown = TransportConfig(
                    cost=config.cost,
                    solver="sinkhorn",
                    epsilon=epsilon,
                    tolerance=1e-3,
                    max_iterations=500,
                )
            else:
                shown = config
            found.append((solve(cost, shown), expert.episode_id))
        result, expert_id = min(found, key=lambda f: float(f[0].cost))
        words = f"{config.cost} cost, solver {config.solver}"
        if config.solver == "uniform":
            words += f" (shown: sinkhorn with epsilon at {SHOWN_EPSILON:.0%} of the mean cost)"
        elif config.solver == "sinkhorn":
            words += f" with epsilon {config.epsilon:g}"
        return result.plan.numpy(), expert_id, words

    def agreement(self, episode_ids: Sequence[str]) -> measures.Agreement:
        """Measure the reward against r* on these videos."""
        videos = [v for v in map(self.score, episode_ids) if v.human is not None]
        rewards = [v.reward for v in videos]
        human = [v.human for v in videos if v.human is not None]
        return measures.agreement(rewards, human)

    def _embed(self, episode: Episode) -> EmbeddedEpisode:
        assert self._encoder is not None
        return EmbeddedEpisode(episode.episode_id, self._encoder.embed(episode.frames[1:]))

    def _score(self, episode: Episode) -> ScoredVideo:
        if self._encoder is None:
            truth = episode.human_rewards
            reward = np.full(episode.steps, np.nan) if truth is None else truth[1:]
            return ScoredVideo(episode, reward, None)
        embedding = self._embed(episode)
        others = [e for e in self.experts if e.episode_id != episode.episode_id]
        trace = self._encoder.reward(embedding.values, others)
        return ScoredVideo(episode, trace.values, embedding, trace.expert_id)


def choose_examples(
    strengths: Mapping[str, float],
    behaviours: Mapping[str, str],
    expert_ids: Sequence[str],
    each: int = 2,
) -> tuple[list[str], list[str]]:
    """Choose videos to show: the most preferred outside the expert set, and disliked ones.

    The disliked ones are of different behaviours, since ten alike say no more than one.

    :param strengths: preference of each ranked video.
    :param behaviours: behaviour of each video.
    :return: (preferred, disliked) ids, the clearest case first.
    """
    order = sorted(strengths, key=lambda e: (-strengths[e], e))
    preferred = [e for e in order if e not in expert_ids][:each]
    disliked: list[str] = []
    for episode_id in reversed(order):
        seen = {behaviours.get(d, "") for d in disliked}
        if len(disliked) < each and behaviours.get(episode_id, "") not in seen:
            disliked.append(episode_id)
    return preferred, [d for d in disliked if d not in preferred]
