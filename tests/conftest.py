"""What every test process needs: a ROS domain of its own, and nothing left behind at the end."""

import importlib.abc
import os
import sys
import time
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

import psutil
import pytest

TESTS = Path(__file__).parent
SESSION_VARIABLE = "RAPL_TEST_SESSION"
WITHOUT_ROS_VARIABLE = "RAPL_TEST_WITHOUT_ROS"
ROS_MODULES = {"rclpy", "rapl_msgs", "rapl_ros", "sensor_msgs", "std_msgs", "diagnostic_msgs"}
GRACE_S = 10.0
ORDER = ("system", "core", "setup", "ros")
"""Of the folders. Two processes of tests end together when the longest file comes first, and while
the whole graph has the machine the other process does what has no deadlines."""

# Before rclpy, torch or MuJoCo are imported; child processes inherit all of it.
os.environ[SESSION_VARIABLE] = uuid.uuid4().hex
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.pop("ROS_STATIC_PEERS", None)

# Helper modules beside the tests are imported by their bare names.
sys.path += [str(path) for path in TESTS.rglob("*") if path.is_dir() and path.name[0] not in "_."]


class _NoRos(importlib.abc.MetaPathFinder):
    """Lets imports of ROS fail, as on a machine without it."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> None:
        if name.partition(".")[0] in ROS_MODULES:
            raise ModuleNotFoundError(f"{name}: {WITHOUT_ROS_VARIABLE} is set", name=name)


if os.environ.get(WITHOUT_ROS_VARIABLE):
    sys.meta_path.insert(0, _NoRos())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what needs ROS by where it lies, and put the folders in ORDER."""
    for item in items:
        if _folder(item) in ("ros", "system"):
            item.add_marker(pytest.mark.ros)
    items.sort(key=lambda item: ORDER.index(_folder(item)) if _folder(item) in ORDER else 0)


def _folder(item: pytest.Item) -> str:
    return item.path.relative_to(TESTS).parts[0]


def _started_here() -> list[psutil.Process]:
    """Return the processes that these tests started and that still run, orphans included."""
    token = f"{SESSION_VARIABLE}={os.environ[SESSION_VARIABLE]}".encode()
    found = {process.pid: process for process in psutil.Process().children(recursive=True)}
    for process in psutil.process_iter():
        try:
            if token in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                found[process.pid] = process
        except OSError:
            continue  # gone, or another user's
    found.pop(os.getpid(), None)
    return [process for process in found.values() if not _is_excused(process)]


def _is_excused(process: psutil.Process) -> bool:
    """Tell whether a process is dead or one that Python ends together with this one."""
    try:
        if process.status() == psutil.STATUS_ZOMBIE:
            return True
        return "multiprocessing.resource_tracker" in " ".join(process.cmdline())
    except psutil.Error:
        return True


@pytest.fixture(scope="module", autouse=True)
def domain_of_the_module() -> None:
    """No module meets the nodes of another; tests that kill nodes have one each, see own_domain."""
    if not os.environ.get(WITHOUT_ROS_VARIABLE):
        from own_domain import enter_own_domain

        enter_own_domain()


@pytest.fixture(scope="session", autouse=True)
def no_process_survives() -> Iterator[None]:
    """Fail when a process that a test started outlives the tests; end it all the same."""
    yield
    deadline = time.monotonic() + GRACE_S
    while (survivors := _started_here()) and time.monotonic() < deadline:
        time.sleep(0.2)
    described = []
    for process in survivors:
        try:
            described.append(f"{process.pid}: {' '.join(process.cmdline())}")
            process.kill()
        except psutil.Error:
            continue
    if described:
        pytest.fail("processes outlived the tests:\n" + "\n".join(described), pytrace=False)
