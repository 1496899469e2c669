"""CI's script leaves neither processes nor shared-memory files behind, and touches no others."""

import os
import subprocess
import uuid
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).parents[2]
SHARED_MEMORY = Path("/dev/shm")


@pytest.mark.skipif(not SHARED_MEMORY.is_dir(), reason="no /dev/shm")
def test_what_a_run_leaves_behind_is_removed_and_nothing_else(tmp_path: Path) -> None:
    token = uuid.uuid4().hex
    mine, older, foreign = (
        SHARED_MEMORY / f"{prefix}{token}"
        for prefix in ("fastrtps_mine", "fastrtps_older", "other_")
    )
    (tmp_path / ".ci").mkdir()
    (tmp_path / ".ci" / "run").write_text((ROOT / ".ci" / "run").read_text())
    make = tmp_path / "bin" / "make"
    make.parent.mkdir()
    make.write_text(
        f"#!/bin/bash\ntouch {mine} {foreign}\n"
        f"setsid sleep 600 </dev/null >/dev/null 2>&1 &\necho $! >{tmp_path}/pid\nexit 3\n"
    )
    make.chmod(0o755)
    older.touch()
    try:
        done = subprocess.run(
            ["bash", str(tmp_path / ".ci" / "run")],
            env={**os.environ, "PATH": f"{make.parent}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 3
        pid = int((tmp_path / "pid").read_text())
        assert f"ending process {pid}" in done.stderr
        assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == "zombie"
        assert [path.exists() for path in (mine, older, foreign)] == [False, True, True]
    finally:
        for path in (mine, older, foreign):
            path.unlink(missing_ok=True)
