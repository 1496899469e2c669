"""Stepping through the graph equals stepping in-process, bit by bit, pictures included."""

from collections.abc import Sequence

import numpy as np
import pytest
from rapl_msgs.msg import State
from ros_harness import Probe
from sensor_msgs.msg import Image
from state_controller import Controller, wait_for

from rapl_core.demonstrators import behaviours_of, make_demonstrator
from rapl_core.demonstrators.demonstrator import Demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task
from rapl_core.tasks.base import Task
from rapl_ros import conversions, qos, topics

SEED, EPISODE, WORLDS = 9, 4, 2


def demonstrators(task: Task) -> list[Demonstrator]:
    """One a world, each in a way that people prefer, with their noise: they push, so blocks touch
    and slide."""
    preferred = [b.name for b in behaviours_of(task).values() if b.preferred]
    return [
        make_demonstrator(task, preferred[w % len(preferred)], np.random.default_rng([3, w]), 0.1)
        for w in range(WORLDS)
    ]


class Scripts:
    """Acts as the demonstrators do; a state that comes again gets its answer again."""

    def __init__(self, task: Task) -> None:
        self._demonstrators = demonstrators(task)
        self.actions: dict[tuple[int, int], Sequence[float]] = {}

    def choose(self, msg: State) -> Sequence[float]:
        key = (msg.world, msg.step)
        if key not in self.actions:
            demonstrator = self._demonstrators[msg.world]
            self.actions[key] = demonstrator.act(np.array(msg.values), msg.step).tolist()
        return self.actions[key]


@pytest.mark.parametrize("name", ["franka_group", "kuka_group", "franka_clutter", "xmagical_group"])
def test_the_graph_steps_as_one_does_in_process(name, probe: Probe, start, tmp_path):
    task = get_task(name)
    images = [
        probe.listen(Image, topics.world_topic(topics.CAMERA_IMAGE, w), qos.stream())
        for w in range(WORLDS)
    ]
    controller = Controller(probe, Scripts(task).choose)
    start(
        "rapl_ros.simulator_node", task=name, worlds=WORLDS, clock_file=tmp_path / "clock.json"
    )  # fmt: skip
    wait_for(controller)
    assert controller.reset(first_episode=EPISODE, seed=SEED).success
    states = controller.states
    probe.until(lambda: sum(s.is_last for s in states) >= WORLDS, 120.0, "both episodes end")
    on_graph = {(s.world, s.step): s for s in states}
    shown = [{conversions.key_from_ros(image.header): image for image in own} for own in images]

    simulation = Simulation(task, worlds=WORLDS)
    for world, demonstrator in enumerate(demonstrators(task)):
        snapshot = simulation.reset(world, episode_rng(SEED, "train", world, EPISODE))
        for step in range(task.horizon + 1):
            message = on_graph[world, step]
            assert np.array_equal(message.values, snapshot.state), (name, world, step)
            assert message.human_reward == snapshot.human_reward
            picture = conversions.image_from_ros(
                shown[world][conversions.key_from_ros(message.image)]
            )
            assert np.array_equal(picture, simulation.render(world)), (name, world, step)
            if not snapshot.is_last:
                action = demonstrator.act(snapshot.state, snapshot.step)
                snapshot = simulation.step(world, action)
        assert message.is_last and message.success == snapshot.success
    simulation.close()
