"""Set-up: what is asked of the system, stamps, interruption. The long parts run in CI itself."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture()
def system_check() -> ModuleType:
    spec = importlib.util.spec_from_file_location("system_check", ROOT / "setup/system_check.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_this_machine_has_is_not_asked_for(system_check: ModuleType) -> None:
    gl = "egl" if system_check.egl_works() else "osmesa" if system_check.osmesa_works() else ""
    assert gl, "these tests render, so one of them works"
    assert system_check.missing_packages(gl) == []


def test_missing_parts_are_named_as_debian_packages(
    system_check: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(system_check.sysconfig, "get_path", lambda name: str(tmp_path))
    monkeypatch.setattr(system_check.importlib.util, "find_spec", lambda name: None)
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    assert system_check.missing_packages("") == [
        "g++", f"{python}-venv", f"{python}-dev", "libegl1", "libgl1", "libgl1-mesa-dri",
    ]  # fmt: skip


def test_gl_that_cannot_be_loaded_does_not_work(
    system_check: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(name: str) -> None:
        raise OSError(name)

    monkeypatch.setattr(system_check.ctypes, "CDLL", refuse)
    assert not system_check.egl_works()
    assert not system_check.osmesa_works()


def names(requirements: Path) -> set[str]:
    found = re.findall(r"^([A-Za-z0-9._-]+)\s*[=<>]", requirements.read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower() for name in found}


def test_the_lock_pins_every_requirement_exactly_and_names_no_host() -> None:
    lock = ROOT / "setup/requirements.lock"
    assert names(ROOT / "setup/requirements.in") <= names(lock)
    for line in lock.read_text().splitlines():
        assert line.startswith("#") or re.match(r"[a-z0-9.-]+==[^ ]+( ;.*)?$", line), line
    assert "://" not in lock.read_text()


@pytest.fixture()
def checkout(tmp_path: Path) -> Iterator[Path]:
    """A copy of what set-up reads, with a Python that records what is asked of it in place of the
    long downloads and builds."""
    for folder in ("setup", "ros_ws/src/rapl_msgs"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    for package in ("rapl_core", "rapl_ros"):
        (tmp_path / package / package).mkdir(parents=True)
        for name in ("setup.py", "setup.cfg"):
            shutil.copy(ROOT / package / name, tmp_path / package)
    (tmp_path / "rapl_ros/rapl_ros/simulator_node.py").touch()
    python = tmp_path / "fake" / "python3"
    python.parent.mkdir()
    python.write_text(
        f"""#!/bin/bash
case "$*" in
  "-m venv"*)
    mkdir -p "${{@: -1}}/bin"
    cp "$0" "${{@: -1}}/bin/python"
    echo venv >>{tmp_path}/did;;
  *"pip install"*requirements.lock)
    echo pip >>{tmp_path}/did
    if [ -e {tmp_path}/slow ]; then echo downloading; sleep 60; fi
    [ ! -e {tmp_path}/broken ] || {{ echo "no space left"; exit 3; }};;
  *"pip install"*) echo own >>{tmp_path}/did;;
  -c*base_executable*) echo "$0";;
  -c*) exit 0;;
  *) exec {sys.executable} "$@";;
esac
"""
    )
    python.chmod(0o755)
    (tmp_path / "setup/build_messages.sh").write_text(
        f"#!/bin/bash\necho messages >>{tmp_path}/did\n"
    )
    yield tmp_path


def start(checkout: Path) -> subprocess.Popen[str]:
    environment = {
        key: value for key, value in os.environ.items() if key not in ("ROS_DISTRO", "PYTHONPATH")
    }
    return subprocess.Popen(
        [str(checkout / "setup/setup.sh")],
        env=environment | {"RAPL_PYTHON": str(checkout / "fake/python3")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def done(checkout: Path) -> tuple[int, str, str, list[str]]:
    """Run set-up; return its exit code, output, errors and what it did."""
    record = checkout / "did"
    record.unlink(missing_ok=True)
    process = start(checkout)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err, record.read_text().split() if record.exists() else []


def wait_for_download(process: subprocess.Popen[str], log: Path) -> None:
    """Wait until set-up is in its long part; the test's own deadline bounds it."""
    while process.poll() is None and not (log.exists() and "downloading" in log.read_text()):
        time.sleep(0.02)


def test_a_second_set_up_does_nothing(checkout: Path) -> None:
    code, out, err, did = done(checkout)
    assert (code, did) == (0, ["venv", "pip", "own", "messages"]), out + err
    assert done(checkout) == (0, "", "", [])


def test_a_changed_message_rebuilds_the_messages_only(checkout: Path) -> None:
    done(checkout)
    with (checkout / "ros_ws/src/rapl_msgs/msg/Reward.msg").open("a") as file:
        file.write("# changed\n")
    assert done(checkout)[3] == ["messages"]


@pytest.mark.parametrize(
    ("pin", "expected"),
    [("six==1.17.0", ["pip", "own"]), ("ros-extra==1.0", ["pip", "own", "messages"])],
)
def test_a_changed_lock_renews_in_place_what_depends_on_it(
    checkout: Path, pin: str, expected: list[str]
) -> None:
    done(checkout)
    with (checkout / "setup/requirements.lock").open("a") as file:
        file.write(pin + "\n")
    assert done(checkout)[3] == expected


def test_a_moved_checkout_is_set_up_anew(checkout: Path) -> None:
    done(checkout)
    moved = checkout / "moved"
    moved.mkdir()
    for name in ("setup", "ros_ws", "rapl_core", "rapl_ros", ".venv", "build"):
        shutil.move(checkout / name, moved / name)
    shutil.copytree(checkout / "fake", moved / "fake")
    (checkout / "did").unlink()
    process = start(moved)
    process.communicate(timeout=60)
    assert (checkout / "did").read_text().split() == ["venv", "pip", "own", "messages"]


def test_a_failure_shows_the_end_of_the_log_and_names_it(checkout: Path) -> None:
    (checkout / "broken").touch()
    code, _, err, did = done(checkout)
    assert (code, did) == (1, ["venv", "pip"])
    assert "no space left" in err
    assert f"all output: {checkout}/build/setup.log" in err
    (checkout / "broken").unlink()
    assert done(checkout)[3] == ["venv", "pip", "own", "messages"]


def test_an_interrupted_set_up_ends_its_child_and_is_not_taken_for_finished(
    checkout: Path,
) -> None:
    (checkout / "slow").touch()
    process = start(checkout)
    assert process.stdout is not None
    log = checkout / "build/setup.log"
    wait_for_download(process, log)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted; start it again to go on" in err
    (checkout / "slow").unlink()
    code, _, _, did = done(checkout)
    assert (code, did) == (0, ["venv", "pip", "own", "messages"])


def test_two_set_ups_do_not_run_at_once(checkout: Path) -> None:
    (checkout / "slow").touch()
    first = start(checkout)
    log = checkout / "build/setup.log"
    wait_for_download(first, log)
    second = start(checkout)
    assert second.stdout is not None
    assert "another set-up is at work here" in second.stdout.readline()
    (checkout / "slow").unlink()
    first.terminate()
    first.communicate(timeout=20)
    second.communicate(timeout=60)
    assert (first.returncode, second.returncode) == (130, 0)


def test_an_unsuitable_python_is_refused_by_name(checkout: Path) -> None:
    python = checkout / "fake/python3"
    python.write_text("#!/bin/bash\nexit 1\n")
    code, _, err, _ = done(checkout)
    assert code == 1
    assert f"RAPL_PYTHON={python} is no Python 3.11, 3.12 or 3.13" in err
