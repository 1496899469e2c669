"""Rounds: when one is given up."""

import time
from collections.abc import Iterator

import pytest
from ros_harness import Probe

from rapl_ros import rounds, topics
from rapl_ros.background import wakeable_future
from rapl_ros.node import RaplNode
from rapl_ros.rounds import RoundLostError, Rounds


class Idle:
    """Leaves the worlds waiting."""

    behaviour = "idle"

    def begin(self, episode_ids: list[str]) -> None:
        self.episode_ids = list(episode_ids)

    def act(self, instants: list) -> list:
        return []

    def acted(self, actions: int) -> None:
        pass


class Scene:
    """A node that plays rounds, and a simulator that answers resets and then keeps silent."""

    def __init__(self) -> None:
        self.simulator = Probe(topics.SIMULATOR)
        self.node = RaplNode(topics.LEARNER)
        self.rounds = Rounds(self.node)
        self.player = Idle()
        self.simulator.executor.add_node(self.node)
        self.simulator.node.create_service(
            rounds.Reset, topics.of_node(topics.RESET, topics.SIMULATOR), self._on_reset
        )

    def _on_reset(self, request: rounds.Reset.Request, response: rounds.Reset.Response):
        response.success, response.episode_ids = True, ["train-s0-w0-000000-0"]
        return response

    def play(self):
        ended = wakeable_future(self.node)

        async def run() -> None:
            try:
                await self.rounds.play(self.player, "train", 0, 0)
            except RoundLostError as error:
                ended.set_result(str(error))

        self.simulator.executor.create_task(run)
        return ended

    def close(self) -> None:
        self.node.destroy_node()
        self.simulator.close()


@pytest.fixture
def scene(rclpy_context: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    monkeypatch.setattr(rounds, "SILENCE_S", 1.5)
    made = Scene()
    yield made
    made.close()


def test_a_silent_simulator_costs_the_round(scene: Scene) -> None:
    ended = scene.play()
    scene.simulator.until(ended.done, 30.0, "the round is given up")
    assert "who drives the worlds?" in ended.result()


def test_a_node_that_was_busy_itself_does_not_take_its_own_silence_for_the_simulators(
    scene: Scene,
) -> None:
    ended = scene.play()
    scene.simulator.until(lambda: hasattr(scene.player, "episode_ids"), 30.0, "the round begins")
    time.sleep(3.0)  # as long gradient steps do: nothing is heard, and nothing was asked
    scene.simulator.spin_for(0.7)
    assert not ended.done()
    scene.simulator.until(ended.done, 30.0, "the simulator is silent all the same")
