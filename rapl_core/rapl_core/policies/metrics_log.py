"""TensorBoard metrics under the names that users of stable-baselines3 know."""

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

from rapl_core.errors import RaplError
from rapl_core.policies.evaluation import Evaluation
from rapl_core.policies.sac_trainer import UpdateMetrics

RETRY_S = 60.0
"""Each try makes a file."""


class MetricsLog:
    """Writes metrics to a folder that TensorBoard opens; what is NaN (unknown) is left out.

    Training goes on without them: what cannot be written later is lost, see `failure`, and a new
    file is tried when some time has passed.

    :param retry_s: that time.
    :raises RaplError: if the folder cannot be written at the beginning.
    """

    def __init__(self, folder: Path | str, retry_s: float = RETRY_S) -> None:
        self._folder = str(folder)
        self._retry_s = retry_s
        self._failed_s = -math.inf
        self.failure = ""
        """Why the last metrics could not be written; empty when they were."""
        try:
            self._logger: Logger | None = self._open()
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
        self._write(
            steps,
            {
                "rollout/ep_rew_mean": reward_mean,
                "rollout/ep_len_mean": length_mean,
                "rollout/human_return_mean": human_return_mean,
                "rollout/success_rate": success_rate,
                "time/fps": steps_per_s,
                "time/episodes": episodes,
                "time/total_timesteps": steps,
            },
        )

    def update(self, steps: int, metrics: UpdateMetrics) -> None:
        """Write what gradient steps saw."""
        self._write(
            steps,
            {
                "train/actor_loss": metrics.actor_loss,
                "train/critic_loss": metrics.critic_loss,
                "train/ent_coef": metrics.entropy_coefficient,
                "train/ent_coef_loss": metrics.entropy_loss,
                "train/n_updates": metrics.updates,
            },
        )

    def evaluation(self, steps: int, evaluation: Evaluation) -> None:
        """Write what an evaluation found."""
        self._write(
            steps,
            {
                "eval/success_rate": evaluation.success_rate,
                "eval/mean_reward": evaluation.reward_mean,
                "eval/human_return_mean": evaluation.human_return_mean,
            },
        )

    def close(self) -> None:
        """Flush and close."""
        if self._logger is not None:
            with suppress(OSError):
                self._logger.close()

    def _open(self) -> Logger:
        return Logger(self._folder, [TensorBoardOutputFormat(self._folder)])

    def _write(self, steps: int, values: Mapping[str, float]) -> None:
        if self._logger is None and time.monotonic() - self._failed_s < self._retry_s:
            return
        try:
            if self._logger is None:
                self._logger = self._open()
            for name, value in values.items():
                if not math.isnan(value):
                    self._logger.record(name, value)
            self._logger.dump(steps)
        except OSError as error:  # of TensorBoard's own thread, which has ended with it
            self.failure = f"cannot write metrics to {self._folder}: {error}"
            self._failed_s = time.monotonic()
            self.close()
            self._logger = None
        else:
            self.failure = ""
