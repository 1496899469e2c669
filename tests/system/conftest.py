"""One whole run for the tests of a module: begun, stopped by Ctrl-C, resumed, left running."""

from collections.abc import Iterator

import pytest
from graph_run import RUN_DEADLINE_S, TINY, WORLDS, FinishedRun, GraphProbe, GraphRun
from ros_harness import ros


@pytest.fixture(scope="module")
def rclpy_up() -> Iterator[None]:
    with ros():
        yield


@pytest.fixture(scope="module")
def finished(rclpy_up: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[FinishedRun]:
    """Run, press Ctrl-C while it learns, resume, wait for the last stage."""
    folder = tmp_path_factory.mktemp("system") / "run"
    probe = GraphProbe(WORLDS)
    run = GraphRun([*TINY, "--out", str(folder)], folder.parent / "first.txt")
    try:
        probe.until_stage("train", 240, run, RUN_DEADLINE_S)
        stop_s, left = run.interrupt()
        seen_before = frozenset(probe.states)
        first = run
        run = GraphRun(["--resume", str(folder), "--keep-running"], folder.parent / "second.txt")
        probe.progress.clear()
        probe.until_stage("report", 1, run, RUN_DEADLINE_S)
        probe.until(lambda: "All stages are done" in run.text(), 60.0, "the report is written")
        yield FinishedRun(
            folder, probe, run, first.text(), stop_s, left, first.process.returncode, seen_before
        )
    finally:
        run.close()
        probe.close()
