"""Real nodes in processes of their own, and a probe that listens to them; all with deadlines."""

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from own_domain import enter_own_domain
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future

from rapl_ros import topics

DISCOVERY_S = 60.0
"""For a node to start and to be discovered: 1 s on a quiet machine, 20 on one with ten processes a
core. What a test claims about time has a deadline of its own."""

ASK_AGAIN_S = 3.0


class NodeProcess:
    """One node in its own process."""

    def __init__(self, module: str, log: Path, **parameters: Any) -> None:
        self.module = module
        self.log = log
        self._parameters = parameters
        self.process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        arguments = []
        for name, value in self._parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
        ros = ["--ros-args", *arguments] if arguments else []
        with self.log.open("ab") as output:
            return subprocess.Popen(
                [sys.executable, "-m", self.module, *ros],
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ | {"PYTHONUNBUFFERED": "1"},
            )

    def kill(self) -> None:
        """End it as a crash would."""
        self.process.kill()
        self.process.wait(timeout=10)

    def restart(self) -> None:
        """Start it again with the same parameters."""
        self.process = self._start()

    def signal(self, number: int) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(timeout=10)

    def stop(self) -> None:
        """End it; by force if need be."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(timeout=8)
            except subprocess.TimeoutExpired:
                self.kill()

    def text(self) -> str:
        """What it has said so far."""
        return self.log.read_text(errors="replace")


class Probe:
    """A node of the test, spun by the test itself."""

    def __init__(self, name: str = "probe") -> None:
        self.node = Node(name, namespace=topics.NAMESPACE)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.received: defaultdict[str, list[Any]] = defaultdict(list)

    def listen(
        self,
        kind: type,
        topic: str,
        profile: QoSProfile,
        callback: Callable[[Any], None] | None = None,
    ) -> list[Any]:
        """Keep what comes on a topic; returns the list that grows."""
        messages = self.received[topic]

        def on_message(msg: Any) -> None:
            messages.append(msg)
            if callback is not None:
                callback(msg)

        self.node.create_subscription(kind, topic, on_message, profile)
        return messages

    def until(self, condition: Callable[[], Any], deadline_s: float, what: str) -> Any:
        """Spin until ``condition`` is true and return its value; fail when it is too late."""
        end = time.monotonic() + deadline_s
        while time.monotonic() < end:
            value = condition()
            if value:
                return value
            self.executor.spin_once(timeout_sec=min(0.1, max(0.0, end - time.monotonic())))
        raise AssertionError(f"not within {deadline_s:g} s: {what}")

    def spin_for(self, seconds: float) -> None:
        """Spin for a while: only to show that something does not happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=min(0.1, max(0.0, end - time.monotonic())))

    def wait(self, future: Future, deadline_s: float, what: str) -> Any:
        """Result of a future."""
        self.until(future.done, deadline_s, what)
        return future.result()

    def call(self, kind: type, service: str, request: Any, deadline_s: float = DISCOVERY_S) -> Any:
        """Call a service once it is there.

        A server that was killed looks ready for up to 20 s and answers nothing: ask again.
        """
        client = self.node.create_client(kind, service)
        futures: list[Future] = []
        asked_s = -ASK_AGAIN_S

        def answered() -> Future | None:
            nonlocal asked_s
            if client.service_is_ready() and time.monotonic() - asked_s > ASK_AGAIN_S:
                asked_s = time.monotonic()
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        try:
            return self.until(answered, deadline_s, f"{service} answers").result()
        finally:
            self.node.destroy_client(client)

    def set_parameter(
        self, node: str, name: str, value: Any, deadline_s: float = DISCOVERY_S
    ) -> tuple[bool, str]:
        """Set a parameter as ``ros2 param set`` does; returns whether it was taken, and why not."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        response = self.call(SetParameters, f"{node}/set_parameters", request, deadline_s)
        return response.results[0].successful, response.results[0].reason

    def status_of(self, node: str) -> dict[str, str]:
        """Newest diagnostics of a node as key and value; needs ``listen`` on /diagnostics."""
        for array in reversed(self.received[topics.DIAGNOSTICS]):
            for status in array.status:
                if status.name == f"/{topics.NAMESPACE}/{node}":
                    return {
                        "message": status.message,
                        "level": str(status.level[0]),
                        **{value.key: value.value for value in status.values},
                    }
        return {}

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()


@contextmanager
def ros(own_domain: bool = False) -> Iterator[None]:
    """rclpy for tests.

    :param own_domain: leave the module's domain, where killed nodes still show, for a fresh one.
    """
    if own_domain:
        enter_own_domain()
    rclpy.init()
    try:
        yield
    finally:
        rclpy.try_shutdown()
