"""run_all.sh on a bare clone: questions and slips are answered before anything is fetched."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone without a virtual environment; its set-up only says that it was called."""
    shutil.copy(ROOT / "run_all.sh", tmp_path)
    (tmp_path / "setup").mkdir()
    for name in ("help.txt", "list.txt"):
        shutil.copy(ROOT / "setup" / name, tmp_path / "setup")
    setup = tmp_path / "setup" / "setup.sh"
    setup.write_text("#!/bin/sh\necho fetching gigabytes\nexit 7\n")
    setup.chmod(0o755)
    return tmp_path


def call(clone: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(clone / "run_all.sh"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


@pytest.mark.parametrize(
    ("arguments", "file"),
    [
        (["--help"], "help.txt"),
        (["franka_group", "--quick", "-h"], "help.txt"),
        (["--list"], "list.txt"),
    ],
)
def test_questions_are_answered_at_once(clone: Path, arguments: list[str], file: str) -> None:
    done = call(clone, *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (ROOT / "setup" / file).read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "a task is missing"),
        (["franka_group", "--stesp", "5"], "unrecognized argument: --stesp;"),
        (["franka_group", "--step", "5"], "unrecognized argument: --step;"),
        (["franka_group", "-q"], "unrecognized argument: -q;"),
    ],
)
def test_slips_are_refused_at_once(clone: Path, arguments: list[str], words: str) -> None:
    done = call(clone, *arguments)
    assert done.returncode == 2
    assert words in done.stderr and "fetching" not in done.stdout


def test_every_option_goes_on_to_the_set_up(clone: Path) -> None:
    options = pytest.importorskip("rapl_ros.options", exc_type=ImportError)
    known = {o for action in options.build_parser()._actions for o in action.option_strings}
    for option in known - {"-h", "--help", "--list"}:
        done = call(clone, "franka_group", f"{option}=1")
        assert (done.returncode, done.stdout) == (7, "fetching gigabytes\n"), option


@pytest.mark.parametrize("question", ["help", "list"])
def test_the_kept_answers_are_those_of_the_program(question: str) -> None:
    pytest.importorskip("rapl_ros.options", exc_type=ImportError)
    done = subprocess.run(
        [sys.executable, "-m", "rapl_ros.run_all", f"--{question}"],
        env={**os.environ, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    command = f"COLUMNS=100 python -m rapl_ros.run_all --{question} > setup/{question}.txt"
    kept = (ROOT / "setup" / f"{question}.txt").read_text()
    # Other versions of Python fold the lines elsewhere.
    assert done.stdout.split() == kept.split(), f"write it anew: {command}"
