"""Online alignment without ROS: rankings about the learner's own videos while it learns.

The same queries, encoder and relabelling as ``./run_all.sh franka_group --online N``, but for the
robot, which waits here for each alignment.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.analysis.scenes import Scenes
from rapl_core.policies.in_process import LearningEvent, Revision
from rapl_core.policies.rewards import EncoderReward
from rapl_core.preferences import SimulatedHuman, expert_set, triplets_from
from rapl_core.preferences.own_videos import MOST_NEW, OwnQueries
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    Preset,
    align,
    find_parts,
    learn_reward,
    make_extractor,
)
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.types import EmbeddedEpisode, Episode, Ranking

METHODS = {"rapl": align, "rlhf": learn_reward}


class KeptReward(EncoderReward):
    """An encoder's reward that keeps the features of what it has rewarded.

    :param kept: (T, F) by episode id; shared by the rewards that come one after another.
    """

    def __init__(
        self,
        encoder: Encoder,
        experts: Sequence[EmbeddedEpisode],
        kept: dict[str, NDArray[np.float32]],
    ) -> None:
        super().__init__(encoder, experts)
        self._kept = kept

    def __call__(self, episode: Episode) -> NDArray[np.float64]:
        """As :class:`EncoderReward`."""
        if episode.episode_id not in self._kept:
            features = self._encoder.extractor.extract(episode.frames[1:], "float32")
            self._kept[episode.episode_id] = features.numpy()
        return self.again(episode.episode_id)

    def again(self, episode_id: str) -> NDArray[np.float64]:
        """The reward (T,) of an episode that this reward or one before has seen."""
        embedded = self._encoder.embed_features(self._kept[episode_id])
        return self._encoder.reward(embedded, self._experts).values


@dataclass
class AlignmentRounds:
    """Makes the reward, and makes it anew at each mark.

    :param videos: the pool; the learner's ranked videos join it.
    :param rankings: about the pool; those about the learner's videos join them.
    :param scenes: on which each reward is judged, for the report alone.
    :param marks: world steps of the alignments to come, in order.
    :param more: rankings for each of them.
    """

    videos: list[Episode]
    rankings: list[Ranking]
    method: str
    preset: Preset
    seed: int
    work: Path
    scenes: Scenes
    marks: Sequence[int] = ()
    more: int = 0
    report: list[dict[str, float]] = field(default_factory=list)
    """Of each alignment: world steps, rankings, successes among the ten experts and so on."""

    def __post_init__(self) -> None:
        self.marks = list(self.marks)
        self._new: list[Episode] = []
        self._kept: dict[str, NDArray[np.float32]] = {}
        self._rng = np.random.default_rng([self.seed, 202])
        self._human = SimulatedHuman(self._rng)
        extractor = make_extractor(DEFAULT_BACKBONE, self.preset.recipe)
        by_id = {video.episode_id: video.frames[1:] for video in self.videos}
        find_parts(extractor, list(by_id), by_id.__getitem__, self.seed)
        folder = self.work / "features"
        self._features = FeatureStore(extractor, folder, "bfloat16", mirror=self.preset.mirror)
        for video in self.videos:
            self._features.add_episode(video)

    def align(self, steps: int = 0) -> KeptReward:
        """A reward from all rankings so far."""
        by_id = {video.episode_id: video for video in self.videos}
        chosen = expert_set(self.rankings, 10)
        rng = np.random.default_rng(self.seed)
        began = time.monotonic()
        encoder, report = METHODS[self.method](
            self._features, triplets_from(self.rankings), chosen, self.preset, rng
        )
        seconds = time.monotonic() - began
        self.encoder = encoder
        self.experts = [encoder.embed_expert(n, by_id[n].frames) for n in encoder.expert_ids]
        self.judged = self.scenes.judge(encoder, self.experts).to_json()
        self.report.append(
            {
                "steps": steps,
                "rankings": len(self.rankings),
                "experts_successful": sum(bool(by_id[name].success) for name in chosen),
                "experts_own": sum(name.startswith("train") for name in chosen),
                "held_out_accuracy": report.held_out_accuracy,
                "best_epoch": report.best_epoch,
                "align_s": seconds,
                "scenes_spearman": self.judged["spearman"],
            }
        )
        self.reward = KeptReward(encoder, self.experts, self._kept)
        return self.reward

    def __call__(self, event: LearningEvent) -> Revision | None:
        """After each round of episodes: at a mark, ask, align and give the new reward."""
        if not self.marks:
            return None
        self._new = [*self._new, *event.episodes][-MOST_NEW:]
        if event.steps < self.marks[0]:
            return None
        self.marks = self.marks[1:]
        self._ask()
        self._new = []
        reward = self.align(event.steps)
        print(f"aligned again: {self.report[-1]}", flush=True)
        return Revision(reward, reward.again)

    def _ask(self) -> None:
        """Rankings about the learner's new videos, each query with one of the expert set."""
        shown = {video.episode_id: video for video in self._new}
        there = {video.episode_id: video for video in self.videos} | shown
        queries = OwnQueries(self._rng, list(shown), expert_set(self.rankings, 10))
        asked: dict[str, Episode] = {}
        for _ in range(self.more):
            query = queries.next(list(there), [r.episode_ids for r in self.rankings])
            ranks = self._human.rank([there[name].human_return for name in query])
            number = len(self.rankings)
            self.rankings.append(Ranking(f"r{number}", "simulated", query, ranks))
            asked |= {name: shown[name] for name in query if name in shown}
        for video in asked.values():
            self.videos.append(video)
            self._features.add_episode(video)
