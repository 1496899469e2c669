"""A short-lived node that looks at the graph, and waiting for what discovery brings."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

import rclpy
from rclpy.node import Node

SETTLE_S: Final = 1.0
"""Quiet time after which the graph counts as discovered; without a daemon nothing knows sooner."""

ALONE_S: Final = 5.0
"""Quiet time after which nobody else is there; a loaded machine takes this long to answer."""

DISCOVERY_S: Final = 10.0
"""Longest wait for a graph that keeps changing, or for a name that was asked for."""


class NodeName(NamedTuple):
    """A node of the graph."""

    name: str
    namespace: str

    @property
    def full(self) -> str:
        """Namespace and name, e.g. ``/rapl/encoder``."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@contextmanager
def observer() -> Iterator[Node]:
    """Give a hidden node for the duration of a command."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(args=[])
    node = rclpy.create_node(f"_ros2cli_{os.getpid()}", start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def wait_for(node: Node, condition: Callable[[], bool], timeout_s: float = DISCOVERY_S) -> bool:
    """Let ``node`` work until ``condition`` holds; tell whether it came to hold in time."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline or not rclpy.ok():
            return condition()
        rclpy.spin_once(node, timeout_sec=0.05)
    return True


def settle(node: Node) -> None:
    """Wait until nothing new has appeared in the graph for a while."""
    seen: tuple[int, ...] = ()
    quiet_since = time.monotonic()

    def is_quiet() -> bool:
        nonlocal seen, quiet_since
        now = (
            len(node.get_node_names()),
            len(node.get_topic_names_and_types()),
            len(node.get_service_names_and_types()),
        )
        if now != seen:
            seen, quiet_since = now, time.monotonic()
        alone = now[0] <= 1
        return time.monotonic() - quiet_since > (ALONE_S if alone else SETTLE_S)

    wait_for(node, is_quiet)


def is_hidden(name: str) -> bool:
    """Tell whether a part of a topic's, service's or node's name starts with an underscore."""
    return any(part.startswith("_") for part in name.split("/"))


def node_names(node: Node, include_hidden: bool = False) -> list[NodeName]:
    """Return the nodes of the graph."""
    found = [NodeName(*entry) for entry in node.get_node_names_and_namespaces()]
    return [name for name in found if include_hidden or not name.name.startswith("_")]


def absolute(node_name: str) -> str:
    """Return the full name of a node given with or without its leading slash."""
    return node_name if node_name.startswith("/") else f"/{node_name}"


def require_node(node: Node, node_name: str, timeout_s: float) -> None:
    """Wait for a node.

    :raises RuntimeError: if it does not appear in time.
    """
    full = absolute(node_name)
    if not wait_for(node, lambda: full in {n.full for n in node_names(node, True)}, timeout_s):
        raise RuntimeError("Node not found")
