"""One run at a time in a folder."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rapl_core.errors import RaplError
from rapl_ros.launching import ARGUMENTS, plan
from rapl_ros.options import parse
from rapl_ros.run_all import main
from rapl_ros.run_config import RunConfig, save_config
from rapl_ros.run_lock import LOCK_FILE, RunLock, is_running

HOLD = """
import sys, time
from pathlib import Path
from rapl_ros.run_lock import RunLock
lock = RunLock(Path(sys.argv[1]))
time.sleep(60)
"""
TASK = "franka_group"


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two unfinished runs; the newer one is called second."""
    for age_s, name in ((100, "first"), (50, "second")):
        folder = tmp_path / TASK / name
        folder.mkdir(parents=True)
        path = save_config(RunConfig(TASK), folder)
        os.utime(path, (time.time() - age_s,) * 2)
    return tmp_path


@pytest.fixture
def busy(runs: Path) -> Iterator[tuple[Path, subprocess.Popen[bytes]]]:
    """The second run is at work in another process."""
    folder = runs / TASK / "second"
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)])
    deadline = time.monotonic() + 30.0
    while not is_running(folder) and time.monotonic() < deadline:
        time.sleep(0.05)
    yield folder, process
    process.kill()
    process.wait()


def test_a_second_run_is_refused_by_the_process_of_the_first_until_that_is_killed(
    busy: tuple[Path, subprocess.Popen[bytes]], runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, process = busy
    words = f"process {process.pid} is at work in {folder}"
    assert main(["--resume", str(folder)]) == 1
    assert words in capsys.readouterr().err
    given = {argument.name: argument.default for argument in ARGUMENTS}
    with pytest.raises(RaplError, match=words):
        plan(given | {"run_folder": str(folder), "steps": "70000"})
    assert len(plan(given | {"run_folder": str(folder), "nodes": "encoder"})) == 1
    newest = ["--resume", TASK]
    assert parse(newest, [TASK], runs).folder == runs / TASK / "first"

    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not is_running(folder)
    assert parse(newest, [TASK], runs).folder == folder
    with RunLock(folder):
        assert (folder / LOCK_FILE).read_text() == f"{os.getpid()}\n"


def test_where_every_run_is_at_work_there_is_none_to_resume(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with (
        RunLock(runs / TASK / "first"),
        RunLock(runs / TASK / "second"),
        pytest.raises(SystemExit),
    ):
        parse(["--resume", TASK], [TASK], runs)
    assert "no unfinished run of franka_group" in (said := capsys.readouterr().err)
    assert "2 at work now" in said


def test_a_child_of_the_one_who_holds_it_may_work_there(tmp_path: Path) -> None:
    script = "import os, sys; from pathlib import Path; from rapl_ros.run_lock import RunLock\n"
    script += "RunLock(Path(sys.argv[1]), or_by=int(sys.argv[2]))"
    with RunLock(tmp_path):
        command = [sys.executable, "-c", script, str(tmp_path)]
        assert subprocess.run([*command, str(os.getpid())]).returncode == 0
        refused = subprocess.run([*command, "1"], capture_output=True, text=True)
        assert f"process {os.getpid()} is at work in {tmp_path}" in refused.stderr
