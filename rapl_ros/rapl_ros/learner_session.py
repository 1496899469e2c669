"""One training as the node sees it: learning, episodes without reward, curve, checkpoints."""

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Literal

import numpy as np

from rapl_core.errors import RaplError
from rapl_core.policies import (
    CheckpointFolder,
    Evaluation,
    Learning,
    LearningCurve,
    MetricsLog,
    Part,
    Relabelling,
    RewardLabels,
    RewardSource,
    SacConfig,
    ScheduleConfig,
)
from rapl_core.policies.evaluation import EpisodeOutcome, summarise_evaluation
from rapl_core.policies.observation import observation_size
from rapl_core.tasks import get_task
from rapl_core.types import RewardTrace
from rapl_ros.players import EpisodeTally, TrainingPlayer
from rapl_ros.wire import EpisodeReward, LearnerMetrics, World

POLICIES = "policies"
RECENT_EPISODES = 100
AfterSwap = Literal["empty", "relabel"]
"""What becomes of the rewards that learning holds when they come from another source."""
UNREWARDED_EPISODES = 2
"""A world; while more lack their reward no new episode begins."""


_TOTALS_KEPT = 4096


class LearnerSession:
    """The state of one training.

    :param world: what is to be controlled.
    :param run_folder: gets policies/ (checkpoints, curve) and metrics/ (TensorBoard).
    :param after_swap: ``empty``: the replay buffer is emptied. ``relabel``: no round begins until
        what is held was rewarded again.
    :param timed: entered around gradient steps, on their thread.
    """

    def __init__(
        self,
        world: World,
        sac: SacConfig,
        schedule: ScheduleConfig,
        seed: int,
        run_folder: Path,
        after_swap: AfterSwap = "empty",
        timed: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self.task = get_task(world.task)
        self.worlds = world.worlds
        self.folder = run_folder / POLICIES
        self.checkpoints = CheckpointFolder(self.folder)
        observation = observation_size(self.task)
        actions = len(self.task.action_names)
        self.learning = Learning(observation, actions, sac, schedule, seed, True, timed)
        self.curve = LearningCurve()
        self.dropped = 0
        self.swaps = 0
        """Times that the source of rewards became another."""
        self.relabelled = 0
        """Episodes that were rewarded again."""
        self._after_swap = after_swap
        self._labels = RewardLabels(self.learning)
        self._log = MetricsLog(run_folder / "metrics")
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=RECENT_EPISODES)
        self._tallies: dict[str, EpisodeTally] = {}
        self._waiting_s: dict[str, float] = {}
        self._totals: dict[str, float] = {}
        """Sum of rewards by episode id; NaN for an episode that was dropped."""
        self._wall_before_s = 0.0
        self._began_s = time.monotonic()
        self._pace: deque[tuple[float, int]] = deque(maxlen=50)

    @property
    def metrics_failure(self) -> str:
        """Why the last metrics could not be written; empty when they were."""
        return self._log.failure

    # Checkpoints

    @property
    def policy_id(self) -> str:
        """Of the policy as of now."""
        return f"{self.learning.schedule.steps:09d}"

    def resume(self, checkpoint: Path) -> None:
        """Go on where ``checkpoint`` was written.

        :raises CorruptFileError: if it is damaged, or of another config or seed.
        """
        parts = self.learning.restore(checkpoint)
        self._labels.restore(parts.get("labels"))
        driver = parts["driver"].values
        self.curve = LearningCurve.from_rows(driver["curve"])
        self._recent.extend((float(a), float(b), float(c)) for a, b, c in driver["recent"])
        self._wall_before_s = float(driver["wall_s"])
        self.dropped = int(driver["dropped"])

    def save(self) -> Path:
        """Write a checkpoint and the curve."""
        self._clear_if_due()
        values = {
            "curve": self.curve.rows(),
            "recent": [list(entry) for entry in self._recent],
            "wall_s": self._wall_s,
            "dropped": self.dropped,
        }
        more = {"driver": Part(values=values), "labels": self._labels.state()}
        path = self.learning.save(self.checkpoints, more)
        for name in ("curve.json", "curve.csv"):
            self.curve.save(self.folder / name)
        return path

    # Rounds

    def begin_round(self) -> TrainingPlayer:
        """Release what is due to the replay buffer; the player of the next round."""
        self._clear_if_due()
        self._labels.released()
        self.learning.begin_round()
        return TrainingPlayer(self.task, self.learning, self.learning.schedule.next_episode)

    def end_round(self, player: TrainingPlayer) -> None:
        """Every episode of the round has ended."""
        self.learning.end_round()
        self.expect_rewards(list(player.tallies.values()))
        schedule = self.learning.schedule
        self._pace.append((time.monotonic(), schedule.steps))
        metrics = self.metrics()
        self._log.rollout(
            steps=schedule.steps,
            reward_mean=metrics.reward_mean,
            length_mean=float(np.mean([tally.steps for tally in player.tallies.values()])),
            human_return_mean=metrics.human_return_mean,
            success_rate=metrics.success_rate,
            steps_per_s=metrics.steps_per_s,
            episodes=metrics.episodes,
        )
        if self.learning.metrics is not None:
            self._log.update(schedule.steps, self.learning.metrics)

    def lose_round(self, episode_ids: list[str], reason: str) -> None:
        """The round's episodes will never end."""
        for episode_id in episode_ids:
            self._drop(episode_id, reason)

    # Rewards

    def expect_rewards(self, tallies: list[EpisodeTally]) -> None:
        """These episodes have ended: their rewards are under way, or were here first."""
        now_s = time.monotonic()
        for tally in tallies:
            self._tallies[tally.episode_id] = tally
            if tally.episode_id in self._totals:
                self._count(tally.episode_id)
            else:
                self._waiting_s[tally.episode_id] = now_s

    @property
    def unrewarded(self) -> int:
        """Episodes that have ended and lack their reward."""
        return len(self._waiting_s)

    @property
    def keeps_up(self) -> bool:
        """Back-pressure: whether rewards keep up, so that new episodes may begin."""
        return self.unrewarded <= UNREWARDED_EPISODES * self.worlds

    @property
    def may_begin(self) -> bool:
        """Whether the next round of training may begin: every reward that it needs is there."""
        return self.keeps_up and not self.learning.missing()

    def reward(self, whose: EpisodeReward, trace: RewardTrace | None, reason: str) -> None:
        """The reward of an episode, or why it has none."""
        name = whose.episode_id
        if trace is None:
            self._drop(name, reason or "reward not valid")
            return
        source = RewardSource(whose.encoder or "human_reward", whose.version, trace.scale)
        self._note_source(source)
        self.learning.stager.reward(name, True, trace.values)
        self._labels.note(name, source)
        self._settle(name, trace.total)

    def expire_rewards(self, deadline_s: float) -> list[str]:
        """Give up the episodes whose reward is overdue; return their ids."""
        now_s = time.monotonic()
        late = [name for name, since in self._waiting_s.items() if now_s - since > deadline_s]
        for name in late:
            self._drop(name, f"no reward within {deadline_s:g} s")
        return late

    def hold_deadlines(self) -> None:
        """Nobody is there who could send rewards: their deadlines begin anew."""
        now_s = time.monotonic()
        self._waiting_s = dict.fromkeys(self._waiting_s, now_s)

    def _note_source(self, source: RewardSource) -> None:
        """Rewards of another source mean something else, and what is held must not be mixed."""
        known = self.learning.reward_source
        self.learning.reward_source = source
        if known in (None, source):
            return
        self.swaps += 1
        if self._after_swap == "relabel":
            return
        for name in self.learning.stager.forget_rewards():
            self.learning.stager.drop(name, f"rewarded by {known} before the swap")
            self.dropped += 1

    # After a swap

    @property
    def needs_relabelling(self) -> bool:
        """Whether episodes must be rewarded again before the next round."""
        return self._after_swap == "relabel" and bool(self._labels.outdated())

    def begin_relabelling(self) -> Relabelling:
        """What is to be rewarded again; no gradient step goes on meanwhile."""
        self.learning.settle()
        return Relabelling(self._labels.outdated())

    def end_relabelling(self, relabelling: Relabelling) -> None:
        """Learn from the new rewards; what could not be rewarded again is dropped and counted."""
        self._labels.apply(relabelling)
        self.relabelled += len(relabelling.rewards)
        self.dropped += len(relabelling.lost)

    def _clear_if_due(self) -> None:
        if self._after_swap == "empty" and self._labels.outdated():
            self._labels.clear()

    def _drop(self, name: str, reason: str) -> None:
        if math.isnan(self._totals.get(name, 0.0)):  # given up before; ot_reward says so too
            return
        self.learning.stager.drop(name, reason)
        self.dropped += 1
        self._settle(name, math.nan)

    def _settle(self, name: str, total: float) -> None:
        self._waiting_s.pop(name, None)
        self._totals[name] = total
        while len(self._totals) > _TOTALS_KEPT:
            self._totals.pop(next(iter(self._totals)))
        self._count(name)

    def _count(self, name: str) -> None:
        """Training episodes enter the running means; those of evaluations have their own."""
        tally, total = self._tallies.pop(name, None), self._totals[name]
        if tally is not None and tally.purpose == "train" and not math.isnan(total):
            success = math.nan if tally.success is None else float(tally.success)
            self._recent.append((total, tally.human_return, success))

    # Evaluation and metrics

    def summarise(self, tallies: list[tuple[int, EpisodeTally]], episodes: int) -> Evaluation:
        """What an evaluation found.

        :param tallies: with the number of each episode.
        """
        outcomes = [
            EpisodeOutcome(
                episode_id=tally.episode_id,
                number=number,
                world=tally.world,
                success=tally.success,
                human_return=tally.human_return,
                reward_return=self._totals.get(tally.episode_id, math.nan),
            )
            for number, tally in tallies
        ]
        return summarise_evaluation(outcomes, episodes)

    def evaluated(self, evaluation: Evaluation) -> None:
        """An evaluation that the schedule asked for has ended."""
        schedule = self.learning.schedule
        schedule.evaluated()
        self.curve = self.curve.with_evaluation(schedule.steps, evaluation, self._wall_s)
        self._log.evaluation(schedule.steps, evaluation)
        self._pace.clear()  # the pause is not the pace of training

    def metrics(self) -> LearnerMetrics:
        """How learning stands."""
        learning = self.learning
        recent = np.array(self._recent, dtype=np.float64).reshape(-1, 3)
        reward, human, success = recent.mean(axis=0) if len(recent) else [math.nan] * 3
        last = learning.metrics
        return LearnerMetrics(
            steps=learning.schedule.steps,
            updates=last.updates if last else 0,
            episodes=learning.stager.released,
            dropped_episodes=self.dropped,
            unrewarded_episodes=self.unrewarded,
            steps_per_s=self._steps_per_s,
            reward_mean=float(reward),
            human_return_mean=float(human),
            success_rate=float(success),
            actor_loss=last.actor_loss if last else math.nan,
            critic_loss=last.critic_loss if last else math.nan,
            entropy_coefficient=last.entropy_coefficient if last else math.nan,
        )

    @property
    def _steps_per_s(self) -> float:
        if len(self._pace) < 2:
            return 0.0
        (then_s, before), (now_s, after) = self._pace[0], self._pace[-1]
        return (after - before) / max(now_s - then_s, 1e-9)

    @property
    def _wall_s(self) -> float:
        return self._wall_before_s + time.monotonic() - self._began_s

    def close(self) -> None:
        """End the gradient steps under way and close the log."""
        self.learning.close()
        self._log.close()


def fresh_or_refuse(session: LearnerSession) -> None:
    """Refuse to begin anew where another training has left checkpoints.

    :raises RaplError: naming the newest.
    """
    newest = session.checkpoints.latest()
    if newest is not None:
        raise RaplError(
            f"{newest} is of a training begun before: resume it, or take another run folder"
        )
