"""Metrics: what cannot be written is lost and said, and training goes on."""

import math
import time
from pathlib import Path

import pytest
from full_disk import full_disk
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from rapl_core.policies import MetricsLog

DEADLINE_S = 20.0


def write(log: MetricsLog, steps: int) -> None:
    log.rollout(steps, 1.0, 50.0, math.nan, 0.5, 40.0, steps // 50)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_full_disk_is_said_and_a_free_one_is_used_again(tmp_path: Path) -> None:
    log = MetricsLog(tmp_path, retry_s=0.5)
    write(log, 50)
    assert log.failure == ""
    steps, deadline = 100, time.monotonic() + DEADLINE_S
    with full_disk():
        while not log.failure and time.monotonic() < deadline:
            write(log, steps)
            steps += 50
    assert f"cannot write metrics to {tmp_path}: [Errno 27] File too large" in log.failure
    write(log, 1_000)
    assert log.failure, "a new file at every step would fill the folder with empty ones"
    assert len(list(tmp_path.iterdir())) == 1
    time.sleep(0.5)
    write(log, 1_000_000)
    assert log.failure == ""
    log.close()
    newest = max(tmp_path.glob("events.*"), key=lambda path: path.stat().st_size)
    read = EventAccumulator(str(newest)).Reload()
    assert [e.step for e in read.Scalars("rollout/success_rate")] == [1_000_000]
    assert "rollout/human_return_mean" not in read.Tags()["scalars"]
