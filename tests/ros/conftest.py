"""Fixtures of the node tests: rclpy, a probe, processes that end with their test, the page."""

from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from ros_harness import NodeProcess, Probe, ros
from web_system import WebSystem, make_videos, web_system


@pytest.fixture(scope="module")
def rclpy_context() -> Iterator[None]:
    """rclpy for the tests of a module; a module that kills nodes has its own one."""
    with ros():
        yield


@pytest.fixture
def probe(rclpy_context: None) -> Iterator[Probe]:
    """A node that listens."""
    made = Probe()
    yield made
    made.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Starts nodes: ``start("rapl_ros.simulator_node", worlds=2)``; they end with the test."""
    running: list[NodeProcess] = []

    def start_node(module: str, **parameters: object) -> NodeProcess:
        log = tmp_path / f"{module.rpartition('.')[2]}-{len(running)}.log"
        running.append(NodeProcess(module, log, **parameters))
        return running[-1]

    yield start_node
    for node in reversed(running):
        node.stop()


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebSystem]:
    """The page for the tests of a module, on 30 videos of the module's own."""
    folder = tmp_path_factory.mktemp("run")
    make_videos(folder, 30, frames=5, size=32)
    with web_system(folder, preference_rankings_wanted=10) as running:
        yield running


@pytest.fixture
def client(system: WebSystem) -> Iterator[httpx.Client]:
    """A client of the page that has the token."""
    with system.client() as made:
        yield made
