"""``make test`` tries twice what failed, and says at the end what that was."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FLAKY = """
from pathlib import Path

def test_that_fails_once():
    tried = Path(__file__).with_name("tried")
    first = not tried.exists()
    tried.touch()
    assert not first

def test_that_passes():
    pass
"""


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_what_failed_the_first_time_is_named_at_the_very_end(tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    stubs = {"setup/setup.sh": "", "bin/ruff": "", "bin/mypy": ""}
    stubs["bin/python"] = f'exec {shlex.quote(sys.executable)} "$@"'
    for name, line in stubs.items():
        script = tmp_path / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(f"#!/bin/sh\n{line}\n")
        script.chmod(0o755)
    (tmp_path / "setup" / "environment.sh").write_text(f'export PATH={tmp_path}/bin:"$PATH"\n')
    (tmp_path / "pyproject.toml").write_text(
        '[tool.pytest.ini_options]\nmarkers = ["slow: s", "browser: b"]\n'
    )
    (tmp_path / "test_it.py").write_text(FLAKY)
    (tmp_path / "test_other.py").write_text("def test_that_is_broken():\n    assert False\n")
    foreign = ("PYTEST", "MAKE", "MFLAGS")  # this test itself runs under make
    environment = {key: value for key, value in os.environ.items() if not key.startswith(foreign)}
    done = subprocess.run(
        ["make", "test"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100
    )
    assert done.returncode != 0
    _, _, names = done.stdout.partition("failed the first time:\n")
    assert sorted(names.splitlines()) == [
        "  test_it.py::test_that_fails_once",
        "  test_other.py::test_that_is_broken",
    ]
