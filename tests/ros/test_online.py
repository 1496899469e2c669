"""Alignments beside a training: what is asked of whom in which order, and what stays on disk.

Real services, actions and parameters; behind them nobody learns anything.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rapl_msgs.action import Align
from rapl_msgs.srv import GetProgress
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.parameter import Parameter
from ros_harness import DISCOVERY_S, Probe

from rapl_core.analysis.online import read_online
from rapl_ros import online, topics
from rapl_ros.node import RaplNode
from rapl_ros.online import OnlineAlignments
from rapl_ros.run_config import RunConfig
from rapl_ros.stage_context import StageContext

pytestmark = pytest.mark.ros

RUN = RunConfig(
    "franka_group",
    triplets=24,
    steps=900,
    random_steps=100,
    online=2,
    online_triplets=6,
    preset="paper",
)
SETTABLE = {
    topics.PREFERENCE: {"rankings_wanted": 0, "strategy": "uniform"},
    topics.SIMULATED_HUMAN: {"rankings": 0},
    topics.ENCODER: {"encoder": ""},
}


class Stage:
    """Preference node, simulated human and encoder in name only, and a conductor."""

    def __init__(self, folder: Path, given: int = 12) -> None:
        self.folder, self.given = folder, given
        self.is_slow = False
        """The human does not answer."""
        self.failures = 0
        """Alignments that fail before one succeeds."""
        self.done: list[tuple[str, Any]] = []
        """What was asked of the nodes, in order."""
        self.probe = Probe()
        self.nodes = {name: self._node(name, settable) for name, settable in SETTABLE.items()}
        preference = self.nodes[topics.PREFERENCE]
        preference.create_service(GetProgress, topics.GET_PROGRESS, self._on_progress)
        self._server = ActionServer(preference, Align, topics.ALIGN, self._align)
        self.conductor = RaplNode(topics.CONDUCTOR, peers=list(SETTABLE))
        self.probe.executor.add_node(self.conductor)
        self.context = StageContext(
            self.conductor, RUN, folder, lambda *_, **__: None, lambda _: None
        )
        self.alignments = OnlineAlignments(self.context)

    def _node(self, name: str, settable: dict[str, Any]) -> RaplNode:
        node = RaplNode(name)
        for parameter, value in settable.items():
            node.declare_parameter(parameter, value)
        node.add_on_set_parameters_callback(self._on_set)
        node.heartbeat.report("active")
        self.probe.executor.add_node(node)
        return node

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            self.done.append((parameter.name, parameter.value))
            if parameter.name == "rankings" and not self.is_slow:
                self.given = parameter.value
        return SetParametersResult(successful=True)

    def _on_progress(
        self, _: GetProgress.Request, response: GetProgress.Response
    ) -> GetProgress.Response:
        response.success, response.given = True, self.given
        return response

    async def _align(self, goal: ServerGoalHandle) -> Align.Result:
        request = goal.request
        self.done.append(("align", (request.encoder, request.preset, request.triplets)))
        self.failures -= 1
        if self.failures >= 0:
            goal.abort()
            return Align.Result(message="no memory left")
        goal.succeed()
        return Align.Result(success=True, version=f"{self.given:016d}", held_out_accuracy=0.75)

    def until_done(self, count: int) -> None:
        self.probe.until(lambda: self.alignments.done == count, DISCOVERY_S, f"{count} alignments")

    def finish(self) -> None:
        """The training is over."""
        ended = self.probe.executor.create_task(self.alignments.end)
        self.probe.wait(ended, DISCOVERY_S, "it ends")

    def close(self) -> None:
        for node in (*self.nodes.values(), self.conductor):
            node.destroy_node()
        self.probe.close()


@pytest.fixture
def stage(rclpy_context: None, tmp_path: Path) -> Iterator[Stage]:
    made = Stage(tmp_path)
    yield made
    made.close()


def test_each_time_it_asks_about_own_videos_aligns_all_and_swaps(stage: Stage) -> None:
    stage.alignments.begin()
    stage.alignments.steps = 290
    stage.probe.spin_for(0.8)
    assert stage.done == [], "nothing before a third of the steps"
    stage.alignments.steps = 310
    stage.until_done(1)
    first = [
        ("strategy", "own"),
        ("rankings_wanted", 18),
        ("rankings", 18),
        ("strategy", "uniform"),
        ("align", ("rapl", "paper", 0)),
        ("encoder", "rapl"),
    ]
    assert stage.done == first
    stage.probe.spin_for(0.8)
    assert stage.done == first, "the next one waits for its steps"
    stage.alignments.steps = 700
    stage.until_done(2)
    stage.finish()
    assert [(e.asked_steps, e.steps, e.rankings) for e in read_online(stage.folder)] == [
        (310, 310, 18),
        (700, 700, 24),
    ]
    assert stage.alignments.problem == ""


def test_people_who_are_slower_than_the_robot_leave_it_unaligned_and_it_goes_on_after_a_restart(
    stage: Stage,
) -> None:
    stage.is_slow = True
    stage.alignments.begin()
    stage.alignments.steps = 400
    stage.probe.until(lambda: ("strategy", "own") in stage.done, DISCOVERY_S, "it asks")
    stage.probe.spin_for(0.5)
    stage.finish()
    assert ("strategy", "uniform") in stage.done and stage.alignments.done == 0
    assert not [what for what, _ in stage.done if what == "align"]
    [entry] = read_online(stage.folder)
    assert (entry.wanted, entry.is_done) == (18, False)

    stage.is_slow, stage.given = False, 15
    stage.alignments = OnlineAlignments(stage.context)  # of the process that takes over
    stage.alignments.begin()
    stage.until_done(1)
    [entry] = read_online(stage.folder)
    assert (entry.asked_steps, entry.steps, entry.rankings) == (400, 400, 18)
    stage.finish()


def test_an_alignment_that_fails_is_tried_again_and_given_up_in_the_end(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(online, "RETRY_S", 0.1)
    stage.failures = 1
    stage.alignments.begin()
    stage.alignments.steps = 300
    stage.until_done(1)
    stage.failures = online.ATTEMPTS
    stage.alignments.steps = 600
    stage.probe.until(lambda: stage.alignments.problem, DISCOVERY_S, "it gives up")
    assert "no memory left" in stage.alignments.problem
    assert stage.alignments.done == 1
    assert len([what for what, _ in stage.done if what == "align"]) == 2 + online.ATTEMPTS
    stage.finish()


def test_no_round_begins_when_the_training_is_over_and_none_is_asked_for_after_it(
    stage: Stage,
) -> None:
    stage.is_slow = True
    stage.alignments.begin()
    stage.alignments.steps = 400
    stage.probe.until(lambda: ("rankings", 18) in stage.done, DISCOVERY_S, "it asks")
    stage.alignments.steps = 900
    stage.finish()
    asked = {what: value for what, value in stage.done}
    assert (asked["rankings_wanted"], asked["rankings"]) == (12, 12), "taken back"
    assert len(read_online(stage.folder)) == 1, "the round at 600 steps has not begun"

    stage.done.clear()
    stage.alignments = OnlineAlignments(stage.context)
    stage.alignments.steps = 900
    finished = stage.probe.executor.create_task(stage.alignments.end)
    stage.probe.wait(finished, DISCOVERY_S, "it ends")
    assert stage.done == []
