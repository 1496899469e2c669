"""The node ``conductor``: runs the stages of the main job by calling the other nodes."""

import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rapl_msgs.msg import Progress

from rapl_core.analysis.stages import StageBook
from rapl_core.errors import RaplError
from rapl_ros import conversions, qos, topics
from rapl_ros.calls import pause
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.progress import ProgressMeter, StageProgress
from rapl_ros.run_config import RunConfig, load_config
from rapl_ros.run_lock import RunLock
from rapl_ros.stage_context import StageContext
from rapl_ros.stages import STAGES, Stage
from rapl_ros.supervisor import UNFINISHED

ATTEMPTS = 4
"""Of a stage; another one is made only when a node has died and was restarted meanwhile."""
RETRY_PAUSE_S = 2.5
"""Longer than the lease of a heartbeat, so that it is known who has died."""
RETURN_S = 30.0
"""For a node that died to come back."""
PROGRESS_PERIOD_S = 0.5


class StageFailedError(RaplError):
    """A stage failed for good."""


@dataclass(frozen=True)
class ConductorConfig:
    """Parameters of the conductor."""

    run_folder: Path = Path("runs/untitled")
    """Folder of the run; its config.yaml says what to do."""


class ConductorNode(RaplNode):
    """Runs the stages in order and goes on where an earlier process stopped.

    Publishes ``progress`` (rapl_msgs/Progress). Calls ``demonstrator/collect``,
    ``preference/get_progress``, ``preference/align``, ``learner/train`` and ``learner/evaluate``,
    and sets parameters of ``encoder``, ``simulated_human`` and ``preference``. The process ends
    with 0 after the last stage, with 1 when a stage fails for good, and as if killed when a signal
    ends it before.
    """

    def __init__(self, **options: Any) -> None:
        peers = (
            topics.SIMULATOR,
            topics.ENCODER,
            topics.OT_REWARD,
            topics.RECORDER,
            topics.PREFERENCE,
            topics.DEMONSTRATOR,
            topics.LEARNER,
        )
        super().__init__(topics.CONDUCTOR, peers=peers, **options)
        self.exit_code = UNFINISHED
        self.folder = declare_config(self, ConductorConfig()).run_folder
        self.run = load_config(self.folder)
        # run_all, where it is the parent, holds the lock for all of its nodes.
        self._lock = RunLock(self.folder, or_by=os.getppid())
        self.watch(topics.WEB if self.run.asks_people else topics.SIMULATED_HUMAN)
        self._book = StageBook(self.folder)
        self._progress = self.publish_to(Progress, topics.PROGRESS, qos.progress())
        self._published_s = -math.inf
        self._stage = ""
        self._needed = needed_stages(self.run)
        self._meter = self._meter_of(self._needed[0])
        self._stage_context = StageContext(
            self, self.run, self.folder, self._advance, self._wait_for
        )
        self._start = self.steady_timer(0.1, self._begin)

    def close(self) -> None:
        """Let another run into the folder."""
        self._lock.close()

    def _begin(self) -> None:
        self._start.cancel()
        assert self.executor is not None
        self.executor.create_task(self._conduct)

    async def _conduct(self) -> None:
        for stage in STAGES:
            if stage in self._needed:
                self._meter = self._meter_of(stage)
                await self._run_stage(stage)
            else:
                self._book.skip(stage.name, f"--reward {self.run.reward} does without")
        self.exit_code = 0
        await pause(self, 1.0)  # the last message must leave before the process does
        rclpy.try_shutdown()

    def _meter_of(self, stage: Stage) -> ProgressMeter:
        """Only what this run needs is numbered."""
        return ProgressMeter(stage.name, self._needed.index(stage) + 1, len(self._needed))

    async def _run_stage(self, stage: Stage) -> None:
        record = self._book[stage.name]
        if record.status == "done" and not stage.is_stale(self.run, record.result):
            self._publish(self._meter.ended("done", "earlier"))
            return
        self._book.forget(later.name for later in STAGES[STAGES.index(stage) + 1 :])
        for attempt in range(1, ATTEMPTS + 1):
            self._book.begin(stage.name)
            self._stage = stage.name
            self._published_s = -math.inf  # its first word, however soon after the last stage's
            self.heartbeat.report("active", stage.name)
            began_s, peers = time.monotonic(), self._incarnations()
            try:
                result = await stage.perform(self._stage_context)
            except RaplError as error:
                self._book.spend(stage.name, time.monotonic() - began_s)
                self.get_logger().warning(f"{stage.name}, attempt {attempt}: {error}")
                self._wait_for(f"to try again: {error}")
                await pause(self, RETRY_PAUSE_S)
                if attempt == ATTEMPTS or not await self._peers_came_back(peers):
                    self._give_up(stage, str(error))
                    raise StageFailedError(f"stage {stage.name} failed: {error}") from error
            else:
                self._book.spend(stage.name, time.monotonic() - began_s)
                self._book.finish(stage.name, result)
                self._publish(self._meter.ended("done", stage.summary(result)))
                return

    def _incarnations(self) -> dict[str, str]:
        return {name: peer.incarnation for name, peer in self.peers.items()}

    async def _peers_came_back(self, before: dict[str, str]) -> bool:
        """Whether a peer has been replaced since, so that another attempt may go better."""
        waited_s = 0.0
        while self.missing_peers() and waited_s < RETURN_S:
            await pause(self, 0.2)
            waited_s += 0.2
        return self._incarnations() != before and not self.missing_peers()

    def _give_up(self, stage: Stage, reason: str) -> None:
        self._book.fail(stage.name, reason)
        self.heartbeat.report("failed", f"{stage.name}: {reason}")
        self._publish(self._meter.ended("failed", reason))

    def _advance(self, done: int, total: int, unit: str, detail: str = "") -> None:
        progress = self._meter.at(done, total, unit, detail)
        if time.monotonic() - self._published_s > PROGRESS_PERIOD_S:
            self._publish(progress)

    def _wait_for(self, what: str) -> None:
        if what:
            self.heartbeat.report("waiting", what)
            self._publish(self._meter.waiting(what))
        else:
            self.heartbeat.report("active", self._stage)

    def _publish(self, progress: StageProgress) -> None:
        self._published_s = time.monotonic()
        self._progress.publish(conversions.progress_to_ros(progress, time.time_ns()))


def needed_stages(run: RunConfig) -> list[Stage]:
    """The stages of a run, in order."""
    return [stage for stage in STAGES if stage.is_needed(run)]


if __name__ == "__main__":
    main(ConductorNode)
