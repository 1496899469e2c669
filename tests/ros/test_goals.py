"""Having a peer do what takes long: goals that get lost, and goals that somebody left."""

from collections.abc import Iterator
from typing import Any

import pytest
from rapl_msgs.action import Collect
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future
from ros_harness import DISCOVERY_S, Probe

from rapl_ros import goals, topics
from rapl_ros.background import wakeable_future
from rapl_ros.calls import pause
from rapl_ros.goals import ActionPort, ParameterPort
from rapl_ros.node import RaplNode

NAME = topics.of_node(topics.COLLECT, topics.DEMONSTRATOR)


class Worker(RaplNode):
    """Takes one goal at a time and works until it is cancelled, or not at all."""

    def __init__(self) -> None:
        super().__init__(topics.DEMONSTRATOR)
        self.declare_parameter("colour", "red")
        self.at_work = False
        self.taken = 0
        self._server = ActionServer(
            self,
            Collect,
            topics.COLLECT,
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def _on_goal(self, _: Collect.Goal) -> GoalResponse:
        return GoalResponse.REJECT if self.at_work else GoalResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> Collect.Result:
        self.at_work = True
        self.taken += 1
        while goal.request.episodes > 1 and not goal.is_cancel_requested:
            await pause(self, 0.05)
        self.at_work = False
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.succeed()
        return Collect.Result(success=True)


class Scene:
    """The worker, and somebody who wants work done."""

    def __init__(self) -> None:
        self.probe = Probe()
        self.worker = Worker()
        self.asker = RaplNode("asker", peers=[topics.DEMONSTRATOR])
        for node in (self.worker, self.asker):
            self.probe.executor.add_node(node)
        self.said: list[str] = []
        self.port = ActionPort(self.asker, Collect, NAME, topics.DEMONSTRATOR, self.said.append)
        self.parameters = ParameterPort(self.asker, topics.DEMONSTRATOR, self.said.append)

    def ask(self, episodes: int) -> Future:
        done = wakeable_future(self.asker)

        async def run() -> None:
            goal = Collect.Goal(episodes=episodes)
            done.set_result(await self.port.run(goal, lambda _: None, DISCOVERY_S))

        self.probe.executor.create_task(run)
        return done

    def close(self) -> None:
        self.worker.destroy_node()
        self.asker.destroy_node()
        self.probe.close()


@pytest.fixture
def scene(rclpy_context: None) -> Iterator[Scene]:
    made = Scene()
    yield made
    made.close()


def test_a_goal_whose_answer_is_lost_is_sent_again(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goals, "ANSWER_S", 0.3)
    client = scene.port._client
    send, sent = client.send_goal_async, []

    def lose_the_first(*args: Any, **named: Any) -> Future:
        sent.append(send(*args, **named))
        return Future() if len(sent) == 1 else sent[-1]

    monkeypatch.setattr(client, "send_goal_async", lose_the_first)
    answer = scene.probe.wait(scene.ask(episodes=1), DISCOVERY_S, "the goal ends")
    assert answer.success and len(sent) == 2


def test_a_parameter_whose_setting_is_lost_is_set_again(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goals, "ANSWER_S", 0.3)
    client = scene.parameters._client
    call, called = client.call_async, []

    def lose_the_first(request: Any) -> Future:
        called.append(request)
        return Future() if len(called) == 1 else call(request)

    monkeypatch.setattr(client, "call_async", lose_the_first)
    done = wakeable_future(scene.asker)

    async def run() -> None:
        await scene.parameters.set("colour", "blue", DISCOVERY_S)
        done.set_result(None)

    scene.probe.executor.create_task(run)
    scene.probe.until(done.done, DISCOVERY_S, "the parameter is set")
    assert scene.worker.get_parameter("colour").value == "blue" and len(called) == 2


def test_a_goal_that_somebody_has_left_is_cancelled(scene: Scene) -> None:
    scene.ask(episodes=100)
    scene.probe.until(lambda: scene.worker.at_work, DISCOVERY_S, "the first goal is taken")
    answer = scene.probe.wait(scene.ask(episodes=1), DISCOVERY_S, "the second goal ends")
    assert answer.success and scene.worker.taken == 2
    assert "for demonstrator to leave an earlier goal" in scene.said
