"""Fixtures of the node tests: rclpy, a probe and processes that end with their test."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ros_harness import NodeProcess, Probe, ros


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
