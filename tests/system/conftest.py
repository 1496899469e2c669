"""A browser, and one whole run for the tests of a module: begun, stopped by Ctrl-C, resumed, left
running."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from graph_run import RUN_DEADLINE_S, TINY, WORLDS, FinishedRun, GraphProbe, GraphRun
from ros_harness import ros

from rapl_ros import topics

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A real browser; without one the tests are skipped."""
    sync_api = pytest.importorskip("playwright.sync_api")
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def rclpy_up() -> Iterator[None]:
    with ros():
        yield


@pytest.fixture(scope="module")
def finished(rclpy_up: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[FinishedRun]:
    """Run, press Ctrl-C while it learns, resume, kill the simulator, wait for the last stage."""
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
        probe.until_stage("train", 240, run, RUN_DEADLINE_S)
        run.kill_node(topics.SIMULATOR)
        missed_s = probe.until_missed(topics.SIMULATOR)
        probe.until_stage("report", 1, run, RUN_DEADLINE_S)
        probe.until(lambda: "All stages are done" in run.text(), 60.0, "the report is written")
        yield FinishedRun(
            folder=folder,
            probe=probe,
            run=run,
            first_text=first.text(),
            stop_s=stop_s,
            left=left,
            stop_code=first.process.returncode,
            seen_before=seen_before,
            missed_s=missed_s,
        )
    finally:
        run.close()
        probe.close()
