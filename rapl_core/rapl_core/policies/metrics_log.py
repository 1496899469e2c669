"""TensorBoard metrics under the names that users of stable-baselines3 know."""

import math
from pathlib import Path

from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

from rapl_core.errors import RaplError
from rapl_core.policies.evaluation import Evaluation
from rapl_core.policies.sac_trainer import UpdateMetrics


class MetricsLog:
    """Writes metrics to a folder that TensorBoard opens; what is NaN (unknown) is left out.

    :raises RaplError: if the folder cannot be written.
    """

    def __init__(self, folder: Path | str) -> None:
        try:
            self._logger = Logger(str(folder), [TensorBoardOutputFormat(str(folder))])
        except OSError as error:
            raise RaplError(f"cannot write metrics to {folder}: {error}") from error

    def rollout(
        self,
        steps: int,
        reward_mean: float,
        length_mean: float,
        human_return_mean: float,
        success_rate: float,
        steps_per_s: float,
        episodes: int,
    ) -> None:
        """Write what the last 100 training episodes were like."""
        self._record("rollout/ep_rew_mean", reward_mean)
        self._record("rollout/ep_len_mean", length_mean)
        self._record("rollout/human_return_mean", human_return_mean)
        self._record("rollout/success_rate", success_rate)
        self._record("time/fps", steps_per_s)
        self._record("time/episodes", episodes)
        self._record("time/total_timesteps", steps)
        self._logger.dump(steps)

    def update(self, steps: int, metrics: UpdateMetrics) -> None:
        """Write what gradient steps saw."""
        self._record("train/actor_loss", metrics.actor_loss)
        self._record("train/critic_loss", metrics.critic_loss)
        self._record("train/ent_coef", metrics.entropy_coefficient)
        self._record("train/ent_coef_loss", metrics.entropy_loss)
        self._record("train/n_updates", metrics.updates)
        self._logger.dump(steps)

    def evaluation(self, steps: int, evaluation: Evaluation) -> None:
        """Write what an evaluation found."""
        self._record("eval/success_rate", evaluation.success_rate)
        self._record("eval/mean_reward", evaluation.reward_mean)
        self._record("eval/human_return_mean", evaluation.human_return_mean)
        self._logger.dump(steps)

    def close(self) -> None:
        """Flush and close."""
        self._logger.close()

    def _record(self, name: str, value: float) -> None:
        if not math.isnan(value):
            self._logger.record(name, value)
