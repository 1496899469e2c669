"""Stepping through the graph equals stepping in-process, bit by bit, pictures included."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from rapl_msgs.msg import State
from ros_harness import Probe
from scripted_steps import demonstrators, scripted_steps
from sensor_msgs.msg import Image
from state_controller import Controller, wait_for

from rapl_core.tasks import get_task
from rapl_core.tasks.base import Task
from rapl_ros import conversions, qos, topics

SEED, EPISODE, WORLDS = 9, 4, 2


class Scripts:
    """Acts as the demonstrators do; a state that comes again gets its answer again."""

    def __init__(self, task: Task) -> None:
        self._demonstrators = demonstrators(task, WORLDS)
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

    # In a process of its own: what other tests did to this one's GL is none of its business.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        in_process = pool.submit(scripted_steps, name, WORLDS, SEED, EPISODE).result()
    for world, instants in enumerate(in_process):
        assert len(instants) == task.horizon + 1
        for step, (state, human_reward, _, pixels) in enumerate(instants):
            message = on_graph[world, step]
            assert np.array_equal(message.values, state), (name, world, step)
            assert message.human_reward == human_reward
            picture = conversions.image_from_ros(
                shown[world][conversions.key_from_ros(message.image)]
            )
            assert np.array_equal(picture, pixels), (name, world, step)
        assert message.is_last and message.success == instants[-1][2]
