"""What every node has: a life, a death that is noticed, diagnostics and exit codes."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.msg import Heartbeat
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import DISCOVERY_S, Probe, ros
from sensor_msgs.msg import Image

from rapl_ros import qos, topics
from rapl_ros.node import RaplNode

LONELY = "lonely_node"


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    here = str(Path(__file__).parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))


@pytest.fixture
def rclpy_context() -> Iterator[None]:
    """Tests that kill nodes have a domain each."""
    with ros(own_domain=True):
        yield


class Watcher(RaplNode):
    """A node whose peer is the encoder."""

    def __init__(self) -> None:
        super().__init__("watcher", peers=[topics.ENCODER])
        self.events: list[tuple[str, float]] = []

    def peer_lost(self, peer: str) -> None:
        self.events.append((f"lost {peer}", time.monotonic()))

    def peer_found(self, peer: str, restarted: bool) -> None:
        self.events.append((f"found {peer} {restarted}", time.monotonic()))


@pytest.fixture
def watcher(rclpy_context) -> Iterator[tuple[Watcher, Probe]]:
    node = Watcher()
    probe = Probe()
    probe.executor.shutdown(timeout_sec=1.0)
    probe.executor = SingleThreadedExecutor()
    probe.executor.add_node(node)
    probe.executor.add_node(probe.node)
    yield node, probe
    node.destroy_node()
    probe.close()


def test_a_killed_peer_is_noticed_within_five_seconds_and_its_restart_is_known(watcher, start):
    node, probe = watcher
    probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    peer = start(LONELY)
    probe.until(lambda: node.events, DISCOVERY_S, "the peer is found")
    assert node.events[0][0] == "found encoder False"
    assert node.missing_peers() == []
    peer.kill()
    killed_s = time.monotonic()
    probe.until(lambda: node.missing_peers(), 5.0, "the loss is noticed")
    assert node.events[-1][0] == "lost encoder"
    assert time.monotonic() - killed_s < 5.0
    probe.until(
        lambda: "encoder is gone" in probe.status_of("watcher").get("message", ""),
        3.0,
        "the loss is on /diagnostics",
    )
    peer.restart()
    probe.until(lambda: node.events[-1][0] == "found encoder True", DISCOVERY_S, "it is back")
    probe.until(
        lambda: probe.status_of("watcher").get("message") == "ok", 5.0, "diagnostics are well"
    )


def test_a_peer_that_is_back_before_its_lease_ran_out_is_told_as_gone_all_the_same(watcher, start):
    node, probe = watcher
    told = probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    peer = start(LONELY)
    probe.until(lambda: node.events, DISCOVERY_S, "the peer is found")
    start(LONELY)  # the lease of the first one cannot run out before: it still lives
    probe.until(lambda: len(node.events) >= 3, DISCOVERY_S, "its successor is noticed")
    peer.kill()
    assert [event for event, _ in node.events[:3]] == [
        "found encoder False",
        "lost encoder",
        "found encoder True",
    ]
    probe.until(
        lambda: any("encoder is gone" in s.message for array in told for s in array.status),
        3.0,
        "the loss is on /diagnostics",
    )


def test_a_stopped_peer_counts_as_gone_and_comes_back_without_restart(watcher, start):
    node, probe = watcher
    peer = start(LONELY)
    probe.until(lambda: node.events, DISCOVERY_S, "the peer is found")
    peer.process.send_signal(signal.SIGSTOP)
    try:
        probe.until(lambda: node.missing_peers(), 5.0, "the stop is noticed")
    finally:
        peer.process.send_signal(signal.SIGCONT)
    probe.until(lambda: not node.missing_peers(), 10.0, "it is alive again")
    probe.spin_for(0.5)
    assert not any("True" in event for event, _ in node.events)


def test_a_peer_that_never_came_is_missing_by_name(watcher, monkeypatch):
    node, probe = watcher
    monkeypatch.setattr("rapl_ros.liveness.DISCOVERY_S", 0.5)
    probe.until(lambda: node.diagnostics.conditions, 5.0, "a complaint")
    assert node.diagnostics.conditions == {"peer encoder": "encoder never appeared"}


def test_a_heartbeat_says_what_the_node_does(probe, start):
    beats = probe.listen(Heartbeat, "encoder/heartbeat", qos.heartbeat())
    start(LONELY)
    probe.until(lambda: beats, DISCOVERY_S, "a heartbeat")
    probe.until(lambda: beats[-1].status == "active", 5.0, "it is active")
    assert beats[-1].node == "encoder" and beats[-1].detail == "doing nothing"
    assert len({beat.incarnation for beat in beats}) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_cleanly_with_exit_code_0(probe, start, number):
    beats = probe.listen(Heartbeat, "encoder/heartbeat", qos.heartbeat())
    node = start(LONELY)
    probe.until(lambda: beats, DISCOVERY_S, "it runs")
    begin = time.monotonic()
    assert node.signal(number) == 0
    assert time.monotonic() - begin < 3.0
    assert node.text().count("closed") == 1 and "Traceback" not in node.text()


def test_a_refusal_is_one_line_and_exit_code_1(start):
    node = start(LONELY, fault="refuses")
    assert node.process.wait(timeout=20) == 1
    assert "there is nothing to encode" in node.text() and "Traceback" not in node.text()


def test_a_fault_in_a_callback_is_told_in_full_and_exit_code_1(start):
    node = start(LONELY, fault="breaks")
    assert node.process.wait(timeout=20) == 1
    assert "ZeroDivisionError" in node.text() and "closed" in node.text()


def a_camera(node, reliability):
    profile = QoSProfile(depth=5, reliability=reliability)
    return node.create_publisher(Image, topics.CAMERA_IMAGE, profile)


def test_a_best_effort_camera_is_an_error_on_diagnostics(watcher):
    node, probe = watcher
    node.subscribe_to(Image, topics.CAMERA_IMAGE, lambda _: None, qos.stream(), overridable=True)
    a_camera(probe.node, ReliabilityPolicy.BEST_EFFORT)
    probe.until(lambda: node.diagnostics.conditions, 10.0, "the error")
    message = node.diagnostics.conditions[f"qos of {topics.CAMERA_IMAGE}"]
    assert "RELIABILITY" in message
    assert "qos_overrides./rapl/camera/image_raw.subscription" in message


def test_an_override_by_parameter_cures_it(rclpy_context):
    name = "qos_overrides./rapl/camera/image_raw.subscription.reliability"
    node = RaplNode("cured", cli_args=["--ros-args", "-p", f"{name}:=best_effort"])
    probe = Probe()
    probe.executor.add_node(node)
    received = []
    try:
        node.subscribe_to(
            Image, topics.CAMERA_IMAGE, received.append, qos.stream(), overridable=True
        )
        publisher = a_camera(probe.node, ReliabilityPolicy.BEST_EFFORT)
        probe.until(lambda: (publisher.publish(Image()), received)[1], 10.0, "an image is received")
        assert not node.diagnostics.conditions
    finally:
        probe.close()
        node.destroy_node()


def test_conditions_stand_until_cleared_and_counters_are_told(watcher):
    node, probe = watcher
    probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    probe.until(lambda: probe.status_of("watcher"), 10.0, "a status")
    node.diagnostics.warn("image", "corrupt")
    node.diagnostics.error("disk", "full")
    node.diagnostics.count("ignored_actions", 3)
    with node.diagnostics.shares.of("rendering"):
        pass
    probe.until(lambda: probe.status_of("watcher").get("ignored_actions"), 5.0, "counters")
    status = probe.status_of("watcher")
    assert status["level"] == "2" and status["message"] == "corrupt; full"
    assert status["ignored_actions"] == "3" and float(status["rendering_s"]) < 0.1
    node.diagnostics.clear("disk")
    probe.until(lambda: probe.status_of("watcher")["level"] == "1", 5.0, "only a warning")


def test_a_condition_about_bad_input_ends_by_itself(watcher):
    node, probe = watcher
    node.diagnostics.warn_for(0.3, "image", "corrupt")
    node.diagnostics.error_for(0.3, "embedding", "NaN")
    assert node.diagnostics.conditions == {"image": "corrupt", "embedding": "NaN"}
    probe.until(lambda: not node.diagnostics.conditions, 5.0, "it ends")


def test_the_same_condition_again_lasts_until_cleared_or_longer(watcher):
    node, _ = watcher
    node.diagnostics.warn_for(0.01, "image", "corrupt")
    node.diagnostics.warn_for(60.0, "image", "corrupt")
    node.diagnostics.error_for(0.01, "disk", "full")
    node.diagnostics.error("disk", "full")
    time.sleep(0.05)
    node.diagnostics.publish()
    assert node.diagnostics.conditions == {"image": "corrupt", "disk": "full"}
    node.diagnostics.clear("image")
    node.diagnostics.clear("disk")


def test_a_worker_thread_may_report_while_the_status_is_published(watcher, monkeypatch):
    node, _ = watcher
    diagnostics = node.diagnostics
    monkeypatch.setattr(diagnostics, "_publisher", SimpleNamespace(publish=lambda message: None))
    node.get_logger().set_level(LoggingSeverity.FATAL)
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    for number in range(200):
        diagnostics.warn(f"standing {number}", "bad")
    failed: list[RuntimeError] = []
    ends_s = time.monotonic() + 2.0

    def repeat(report: Callable[[], None]) -> None:
        try:
            while time.monotonic() < ends_s and not failed:
                report()
        except RuntimeError as error:
            failed.append(error)

    def come_and_go() -> None:
        diagnostics.error("embedding", "NaN")
        diagnostics.clear("embedding")

    worker = threading.Thread(target=repeat, args=[come_and_go])
    worker.start()
    try:
        repeat(diagnostics.publish)
    finally:
        worker.join()
        sys.setswitchinterval(interval_s)
        node.get_logger().set_level(LoggingSeverity.INFO)
    assert not failed
