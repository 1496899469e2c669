"""The simulator as a process: its parameters, its end, and its life after a kill."""

import json
import signal
import time
from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros_harness import NodeProcess, ros
from sensor_msgs.msg import Image
from state_controller import Controller, wait_for

from rapl_core.tasks import get_task
from rapl_ros import qos, topics

MODULE = "rapl_ros.simulator_node"
TASK = get_task("franka_group")


@pytest.fixture
def rclpy_context() -> Iterator[None]:
    """Tests that kill nodes have a domain each."""
    with ros(own_domain=True):
        yield


@pytest.fixture
def controller(probe):
    probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    return Controller(probe)


@pytest.fixture
def start_simulator(start, controller, tmp_path):
    """Starts a simulator of the test's own."""

    def start_it(**parameters) -> NodeProcess:
        values = dict(worlds=2, clock_file=tmp_path / "clock.json") | parameters
        node = start(MODULE, **values)
        wait_for(controller)
        return node

    return start_it


def test_stamps_go_on_after_a_kill_though_it_ran_ahead_of_the_wall_clock(
    probe, controller, start_simulator, tmp_path
):
    ahead_ns = time.time_ns() + 600 * 10**9  # as after hours faster than real time
    (tmp_path / "clock.json").write_text(json.dumps({"reserved_until_ns": ahead_ns}))
    node = start_simulator()
    controller.reset(episodes=0)
    states = controller.states
    probe.until(lambda: len(states) > 120, 60.0, "more than one episode")
    node.kill()
    before = {w: max(s.header.stamp.sec for s in states if s.world == w) for w in (0, 1)}
    assert before[0] > time.time() + 300
    states.clear()
    node.restart()
    assert controller.reset(episodes=0).success
    probe.until(lambda: {s.world for s in states} == {0, 1}, 30.0, "new states")
    for state in states:
        assert state.header.stamp.sec > before[state.world]


def test_real_time_is_kept_when_asked_for(probe, controller, start_simulator):
    start_simulator(real_time_factor=2.0)
    controller.reset()
    probe.until(lambda: any(s.step == 1 for s in controller.states), 10.0, "it begins")
    begin = time.monotonic()
    probe.until(lambda: any(s.step == 31 for s in controller.states), 30.0, "30 steps")
    took = time.monotonic() - begin
    assert took > 0.95 * 30 * TASK.period_s / 2.0


def test_without_rendering_there_are_states_and_no_images(probe, controller, start_simulator):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
    start_simulator(render=False)
    controller.reset()
    probe.until(lambda: any(s.is_last for s in controller.states), 30.0, "an episode")
    assert images == []


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"task": "dishes"}, "unknown task 'dishes'; known: "),
        ({"worlds": 900}, "take fewer worlds"),
        ({"worlds": 0}, "worlds"),
        ({"clock_file": "/dev/null/clock"}, "/dev/null/clock"),
    ],
)
def test_bad_parameters_end_it_with_one_clear_line(start, tmp_path, parameters, complaint):
    values = dict(worlds=1, clock_file=tmp_path / "clock.json") | parameters
    node = start(MODULE, **values)
    assert node.process.wait(timeout=30) == 1
    assert complaint in node.text() and "Traceback" not in node.text()


def test_it_ends_cleanly_while_it_steps(probe, controller, start_simulator):
    node = start_simulator()
    controller.reset(episodes=0)
    probe.until(lambda: len(controller.states) > 50, 30.0, "it steps")
    begin = time.monotonic()
    node.process.send_signal(signal.SIGINT)
    code = node.process.wait(timeout=10)
    assert code == 0 and time.monotonic() - begin < 5.0
    assert "Traceback" not in node.text()
