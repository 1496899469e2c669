"""The learner: policy, staged episodes and schedule, driven by the ROS node or in-process."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import CorruptFileError
from rapl_core.policies.checkpoint import CheckpointFolder, Part, read_checkpoint
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.rewards import RewardSource
from rapl_core.policies.sac_trainer import SacTrainer, UpdateMetrics
from rapl_core.policies.schedule import LearningSchedule
from rapl_core.policies.staging import EpisodeStager

_FIXED = ("worlds", "random_steps", "block_steps", "train_ratio", "reward_lag")
"""What a resumed run may not change about its schedule."""


class Learning:
    """What the learner does and when; who steps the worlds is another's affair.

    A round is one episode of every world. The driver, for each round:

    1. waits until :meth:`missing` is empty, then calls :meth:`begin_round`;
    2. for each control period: :meth:`act` on the states of all worlds at once, in order;
       :attr:`stager` takes observations and actions; then :meth:`advance` by as many worlds;
    3. :meth:`end_round`; evaluates when ``schedule.evaluation_due`` (after :meth:`settle`,
       then ``schedule.evaluated()``); saves when ``schedule.checkpoint_due``.

    Rewards reach :attr:`stager` whenever they come. Gradient steps run on a thread of their own
    while the worlds go on; what is learnt is the same with ``background=False``.

    :param observation_size: F.
    :param action_size: A.
    :param background: take gradient steps on a thread of their own.
    :param timed: entered around gradient steps, on their thread, to tell what they cost.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        sac: SacConfig,
        schedule: ScheduleConfig,
        seed: int,
        background: bool = False,
        timed: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self.seed = seed
        self.trainer = SacTrainer(observation_size, action_size, sac, seed)
        self.stager = EpisodeStager()
        self.schedule = LearningSchedule(schedule)
        self.reward_source: RewardSource | None = None
        """Where the rewards come from; set by the driver, kept in checkpoints."""
        self.metrics: UpdateMetrics | None = None
        """Of the last block of gradient steps; None before the first."""
        self._timed = timed
        self._thread = ThreadPoolExecutor(1, "gradient-steps") if background else None
        self._running: Future[UpdateMetrics] | None = None

    def missing(self) -> list[str]:
        """Return the episodes that must be rewarded or dropped before the next round begins."""
        return self.stager.unresolved(self.schedule.release_before(self.schedule.next_episode))

    def begin_round(self) -> list[str]:
        """Release what is due to the replay buffer and return the ids."""
        self._join()
        number = self.schedule.next_episode
        episodes = self.stager.release(self.schedule.release_before(number))
        for episode in episodes:
            self.trainer.add_episode(episode)
        return [episode.episode_id for episode in episodes]

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return actions (W, A) for training, random ones at first.

        :param observations: (W, F) of all worlds in order.
        """
        if self.schedule.explores:
            return self.trainer.random_actions(len(observations))
        return self.trainer.act(observations)

    def advance(self, world_steps: int) -> None:
        """Count world steps; at a block boundary refresh the policy and take gradient steps."""
        block = self.schedule.advance(world_steps)
        if block is None:
            return
        self.settle()
        if block.updates < 1 or not self.trainer.can_update:
            return
        if self._thread is None:
            self.metrics = self._update(block.updates)
        else:
            self._running = self._thread.submit(self._update, block.updates)

    def _update(self, steps: int) -> UpdateMetrics:
        with self._timed():
            return self.trainer.update(steps)

    def end_round(self) -> None:
        """Note that an episode of every world has ended."""
        self.schedule.end_round()

    def settle(self) -> None:
        """Wait for the gradient steps under way and act as learnt: before an evaluation."""
        self._join()
        self.trainer.refresh()

    def relabel(self, rewards: Mapping[str, NDArray[np.float64]]) -> int:
        """Give what is in the replay buffer new rewards (T,) by episode id and drop the rest.

        Between two rounds, when the gradient steps under way have ended.

        :return: how many episodes are left.
        """
        self._join()
        return self.trainer.relabel(rewards)

    def save(self, folder: CheckpointFolder, more: Mapping[str, Part] | None = None) -> Path:
        """Write a checkpoint, at the end of a round.

        An episode whose reward is still missing is not in it, so the driver waits first until
        ``stager.unresolved()`` is empty.

        :param more: parts of the driver.
        """
        self._join()
        self.schedule.checkpointed()
        parts = {
            "trainer": self.trainer.state(),
            "stager": self.stager.state(),
            "schedule": self.schedule.state(),
            "run": Part(
                values={
                    "seed": self.seed,
                    "schedule": asdict(self.schedule.config),
                    "reward": None if self.reward_source is None else asdict(self.reward_source),
                }
            ),
        }
        return folder.save(self.schedule.steps, {**parts, **(more or {})})

    def restore(self, checkpoint: Path) -> dict[str, Part]:
        """Go on where a checkpoint was written and return its parts.

        :raises CorruptFileError: if it is damaged, or of another config or seed.
        """
        self._join()
        parts = read_checkpoint(checkpoint)
        absent = {"trainer", "stager", "schedule", "run"} - set(parts)
        if absent:
            raise CorruptFileError(f"{checkpoint} lacks {', '.join(sorted(absent))}")
        run = parts["run"].values
        if run["seed"] != self.seed:
            raise CorruptFileError(f"{checkpoint} is of seed {run['seed']}, expected {self.seed}")
        config = self.schedule.config
        changed = [n for n in _FIXED if run["schedule"][n] != getattr(config, n)]
        if changed:
            raise CorruptFileError(
                f"{checkpoint} was written with another schedule: "
                + "; ".join(f"{n}: {run['schedule'][n]} != {getattr(config, n)}" for n in changed)
            )
        self.reward_source = None if run["reward"] is None else RewardSource(**run["reward"])
        self.trainer.restore(parts["trainer"])
        self.stager.restore(parts["stager"])
        self.schedule.restore(parts["schedule"])
        return parts

    def close(self) -> None:
        """End the thread, after the gradient steps under way."""
        if self._thread is not None:
            self._thread.shutdown()

    def _join(self) -> None:
        """Wait for the gradient steps under way; what went wrong in them is raised here."""
        if self._running is not None:
            running, self._running = self._running, None
            self.metrics = running.result()
