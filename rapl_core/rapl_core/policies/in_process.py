"""Learning without ROS: the same learner, schedule and seed streams as the graph."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import CorruptFileError
from rapl_core.policies.checkpoint import CheckpointFolder, Part
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.evaluation import EpisodeOutcome, Evaluation, summarise_evaluation
from rapl_core.policies.learning import Learning
from rapl_core.policies.learning_curve import LearningCurve
from rapl_core.policies.metrics_log import MetricsLog
from rapl_core.policies.observation import observation_size
from rapl_core.policies.rewards import EpisodeReward
from rapl_core.policies.rollout import Rollout
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import Episode

RECENT_EPISODES = 100


@dataclass(frozen=True)
class LearningEvent:
    """What :func:`train_in_process` reports after each round of episodes."""

    steps: int
    total: int
    updates: int
    steps_per_s: float
    reward_mean: float
    """Of the last 100 training episodes."""
    human_return_mean: float
    success_rate: float
    evaluation: Evaluation | None
    """Of the policy as of now, if one was due."""
    episodes: tuple[Episode, ...] = ()
    """The training episodes of the round; with pictures if the reward needs them."""


@dataclass(frozen=True)
class Revision:
    """Another reward while learning goes on; what is held for replay is rewarded again by it."""

    reward: EpisodeReward
    again: Callable[[str], NDArray[np.float64]]
    """Its rewards (T,) of an earlier training episode, by id."""


def train_in_process(
    task_name: str,
    reward: EpisodeReward,
    sac: SacConfig,
    schedule: ScheduleConfig,
    seed: int,
    folder: Path | str | None = None,
    resume: bool = False,
    on_event: Callable[[LearningEvent], None] | None = None,
    score_evaluations: bool = False,
    background: bool = False,
    stop: Callable[[LearningCurve], bool] | None = None,
    revise: Callable[[LearningEvent], Revision | None] | None = None,
) -> LearningCurve:
    """Train a policy and return what its evaluations found.

    :param folder: for checkpoints/, metrics/, curve.json and curve.csv; None: keep nothing.
    :param resume: go on from the newest checkpoint in ``folder``, if there is one.
    :param on_event: called after each round of episodes.
    :param score_evaluations: give evaluation episodes their reward too (costs their pictures).
    :param background: take gradient steps while the worlds go on; the result is the same.
    :param stop: asked after each round whether to end before the last step, e.g. at a plateau.
    :param revise: asked after each round for another reward to go on with. A run that was revised
        cannot be resumed: its checkpoints do not hold what the new reward was made of.
    :raises CorruptFileError: if the checkpoint is damaged, or of another config, seed or reward.
    """
    run = _Run(task_name, reward, sac, schedule, seed, folder, score_evaluations, background)
    try:
        if resume:
            run.resume()
        while not (run.learning.schedule.finished or (stop is not None and stop(run.curve))):
            event = run.round()
            if on_event is not None:
                on_event(event)
            revision = revise(event) if revise is not None else None
            if revision is not None:
                run.revise(revision)
        return run.curve
    finally:
        run.close()


class _Run:
    """The state of one training run."""

    def __init__(
        self,
        task_name: str,
        reward: EpisodeReward,
        sac: SacConfig,
        schedule: ScheduleConfig,
        seed: int,
        folder: Path | str | None,
        score_evaluations: bool,
        background: bool,
    ) -> None:
        task = get_task(task_name)
        self.reward = reward
        self.score_evaluations = score_evaluations
        self.simulation = Simulation(task, schedule.worlds, render=reward.needs_frames)
        self.rollout = Rollout(self.simulation, seed)
        self.learning = Learning(
            observation_size(task), len(task.action_names), sac, schedule, seed, background
        )
        self.learning.reward_source = reward.source
        self.folder = None if folder is None else Path(folder)
        self.log = None if self.folder is None else MetricsLog(self.folder / "metrics")
        self.curve = LearningCurve()
        self.recent: deque[tuple[float, float, float]] = deque(maxlen=RECENT_EPISODES)
        self._wall_before_s = 0.0
        self._began_s = time.monotonic()
        self._began_steps = 0

    @property
    def wall_s(self) -> float:
        return self._wall_before_s + time.monotonic() - self._began_s

    def resume(self) -> None:
        """Go on from the newest checkpoint, if there is one."""
        checkpoints = self._checkpoints()
        newest = None if checkpoints is None else checkpoints.latest()
        if newest is None:
            return
        driver = self.learning.restore(newest)["driver"].values
        if self.learning.reward_source != self.reward.source:
            raise CorruptFileError(
                f"{newest} learnt from {self.learning.reward_source}, expected {self.reward.source}"
            )
        self.curve = LearningCurve.from_rows(driver["curve"])
        self.recent.extend((float(a), float(b), float(c)) for a, b, c in driver["recent"])
        self._wall_before_s = float(driver["wall_s"])
        self._began_steps = self.learning.schedule.steps

    def round(self) -> LearningEvent:
        """One training episode of every world, and what is due after it."""
        learning, schedule = self.learning, self.learning.schedule
        learning.begin_round()
        number = schedule.next_episode
        stager = learning.stager

        def act(step: int, observations: NDArray[np.float32]) -> NDArray[np.float64]:
            actions = learning.act(observations)
            for world, episode_id in enumerate(self.rollout.ids("train", number)):
                stager.observe(episode_id, number, world, step, observations[world])
                stager.act(episode_id, step, actions[world])
            return actions

        ended = self.rollout.run(
            "train", number, act, frames=self.reward.needs_frames, stepped=learning.advance
        )
        for one in ended:
            episode = one.episode
            stager.observe(
                episode.episode_id,
                number,
                episode.world,
                episode.steps,
                one.last_observation,
                is_last=True,
                terminated=one.terminated,
            )
            values = self.reward(episode)
            stager.reward(episode.episode_id, True, values)
            self.recent.append(
                (float(values.sum()), episode.human_return, float(bool(episode.success)))
            )
        learning.end_round()
        evaluation = self._evaluate() if schedule.evaluation_due else None
        event = self._event(evaluation, tuple(one.episode for one in ended))
        self._record(event)
        if schedule.checkpoint_due:
            self._save()
        return event

    def revise(self, revision: Revision) -> None:
        """Go on with another reward: relabel the replay buffer and what is staged for it."""
        self.reward = revision.reward
        held = self.learning.trainer.replay.lengths()
        self.learning.relabel({name: revision.again(name) for name in held})
        for name in self.learning.stager.rewarded():
            self.learning.stager.reward(name, True, revision.again(name))
        self.learning.reward_source = revision.reward.source

    def _evaluate(self) -> Evaluation:
        """Episodes with the deterministic policy, from starts that no other evaluation had."""
        learning, schedule = self.learning, self.learning.schedule
        learning.settle()
        outcomes = []
        first = schedule.first_evaluation_episode
        for number in range(first, first + schedule.evaluation_rounds):
            ended = self.rollout.run(
                "evaluate",
                number,
                lambda step, observations: learning.trainer.act(observations, deterministic=True),
                frames=self.score_evaluations and self.reward.needs_frames,
            )
            for one in ended:
                scored = float(self.reward(one.episode).sum()) if self.score_evaluations else None
                outcomes.append(
                    EpisodeOutcome(
                        episode_id=one.episode.episode_id,
                        number=number,
                        world=one.episode.world,
                        success=one.episode.success,
                        human_return=one.episode.human_return,
                        reward_return=math.nan if scored is None else scored,
                    )
                )
        evaluation = summarise_evaluation(outcomes, schedule.config.evaluate_episodes)
        schedule.evaluated()
        self.curve = self.curve.with_evaluation(schedule.steps, evaluation, self.wall_s)
        return evaluation

    def _event(self, evaluation: Evaluation | None, episodes: tuple[Episode, ...]) -> LearningEvent:
        schedule = self.learning.schedule
        reward_mean, human_return_mean, success_rate = np.mean(list(self.recent), axis=0).tolist()
        elapsed_s = max(time.monotonic() - self._began_s, 1e-9)
        return LearningEvent(
            steps=schedule.steps,
            total=schedule.config.steps,
            updates=self.learning.trainer.updates,
            steps_per_s=(schedule.steps - self._began_steps) / elapsed_s,
            reward_mean=reward_mean,
            human_return_mean=human_return_mean,
            success_rate=success_rate,
            evaluation=evaluation,
            episodes=episodes,
        )

    def _record(self, event: LearningEvent) -> None:
        if self.log is None:
            return
        self.log.rollout(
            steps=event.steps,
            reward_mean=event.reward_mean,
            length_mean=float(np.mean([episode.steps for episode in event.episodes])),
            human_return_mean=event.human_return_mean,
            success_rate=event.success_rate,
            steps_per_s=event.steps_per_s,
            episodes=self.learning.stager.released,
        )
        if self.learning.metrics is not None:
            self.log.update(event.steps, self.learning.metrics)
        if event.evaluation is not None:
            self.log.evaluation(event.steps, event.evaluation)

    def _save(self) -> None:
        checkpoints = self._checkpoints()
        if checkpoints is None or self.folder is None:
            return
        driver = Part(
            values={
                "curve": self.curve.rows(),
                "recent": [list(values) for values in self.recent],
                "wall_s": self.wall_s,
            }
        )
        self.learning.save(checkpoints, {"driver": driver})
        for name in ("curve.json", "curve.csv"):
            self.curve.save(self.folder / name)

    def _checkpoints(self) -> CheckpointFolder | None:
        return None if self.folder is None else CheckpointFolder(self.folder / "checkpoints")

    def close(self) -> None:
        """Free what the run holds."""
        self.learning.close()
        if self.log is not None:
            self.log.close()
        self.simulation.close()
