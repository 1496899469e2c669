"""The learner after a swap: what it learns from is rewarded again, or dropped where nobody can.

The probe plays ot_reward, so that every reward tells by which version it was given.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Train
from rapl_msgs.srv import RewardAgain
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from ros_harness import NodeProcess, Probe, ros
from std_srvs.srv import Trigger

from rapl_core.policies import read_checkpoint
from rapl_core.types import RewardTrace
from rapl_ros import conversions, qos, topics
from rapl_ros.liveness import Heartbeat
from rapl_ros.wire import EpisodeReward, RewardsAgain

pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

START_S = 200.0
"""torch takes seconds to import, many on a busy machine."""
VALUES = {"aaaa": -1.0, "bbbb": -2.0, "cccc": -3.0}
"""Reward of every transition by each version."""
BATCH = 16


class RewardsByVersion:
    """Rewards every episode that ends, and again what is asked for."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.version = "aaaa"
        self.answers = 10**9
        """Requests that are still answered; then this ot_reward hangs."""
        self.rewarded: dict[str, wire_msg.State] = {}
        self.asked: list[list[str]] = []
        Heartbeat(probe.node).report("active")
        self._rewards = probe.node.create_publisher(wire_msg.Reward, topics.REWARD, qos.event())
        probe.listen(wire_msg.State, topics.STATE, qos.stream(), self._on_state)
        waits = ReentrantCallbackGroup()
        probe.node.create_service(
            RewardAgain, topics.REWARD_AGAIN, self._on_request, callback_group=waits
        )

    def reward(self, last: wire_msg.State) -> tuple[EpisodeReward, RewardTrace]:
        key = conversions.key_from_ros(last.header)
        whose = EpisodeReward(key, last.episode_id, last.world, "train", "rapl", self.version)
        values = np.full(last.step, VALUES[self.version])
        return whose, RewardTrace(values, "", 0.0, True, 0, 0.0, 1.0)

    def _on_state(self, msg: wire_msg.State) -> None:
        if msg.is_last and msg.episode_id not in self.rewarded:
            self.rewarded[msg.episode_id] = msg
            self._rewards.publish(conversions.reward_to_ros(*self.reward(msg)))

    async def _on_request(
        self, request: RewardAgain.Request, response: RewardAgain.Response
    ) -> RewardAgain.Response:
        self.asked.append(list(request.episode_ids))
        self.answers -= 1
        if self.answers < 0:
            await Future(executor=self.probe.executor)
        rewards = tuple(self.reward(self.rewarded[name]) for name in request.episode_ids)
        again = RewardsAgain("rapl", self.version, rewards, {})
        conversions.fill_reward_again(response, again)
        return response


@pytest.fixture
def rclpy_context() -> Iterator[None]:
    with ros(own_domain=True):
        yield


def replay(checkpoint: str) -> dict[str, np.ndarray]:
    """Rewards in the replay buffer of a checkpoint, by episode."""
    part = read_checkpoint(checkpoint)["trainer"]
    rewards = part.arrays["replay.rewards"][:, 0]
    spans = part.values["replay"]["spans"]
    return {name: rewards[start : start + steps] for name, start, steps in spans}


def test_a_swap_keeps_the_buffer_and_an_ot_reward_that_hangs_costs_only_the_rest(
    start: Callable[..., NodeProcess], tmp_path: Path, rclpy_context: None
) -> None:
    probe = Probe(topics.OT_REWARD)
    try:
        start("rapl_ros.simulator_node", worlds=2, render=False, clock_file=tmp_path / "clock")
        learner = start(
            "rapl_ros.learner_node",
            run_folder=tmp_path,
            after_swap="relabel",
            relabel_deadline_s=4.0,
            sac__hidden="[8]",
            schedule__random_steps=1_000_000,
            schedule__evaluate_episodes=0,
            schedule__checkpoint_every=1_000_000,
        )
        source = RewardsByVersion(probe)
        client = ActionClient(probe.node, Train, topics.of_node(topics.TRAIN, topics.LEARNER))
        probe.until(client.server_is_ready, START_S, "the learner appears")
        sent = client.send_goal_async(Train.Goal(steps=1_000_000))
        assert probe.wait(sent, 60.0, "the goal is answered").accepted

        def episodes(count: int) -> None:
            probe.until(lambda: len(source.rewarded) >= count, 120, f"{count} episodes")

        def saved() -> dict[str, np.ndarray]:
            name = topics.of_node(topics.SAVE, topics.LEARNER)
            response = probe.call(Trigger, name, Trigger.Request(), 90)
            assert response.success, response.message
            return replay(response.message)

        episodes(20)
        old = list(source.rewarded)
        source.version = "bbbb"
        probe.until(lambda: source.asked, 60, "it asks for new rewards")
        assert len(source.asked[0]) == BATCH
        episodes(30)
        held = saved()
        assert set(old[:16]) <= set(held), "the buffer keeps what it had"
        for name, values in held.items():
            np.testing.assert_array_equal(values, VALUES["bbbb"], err_msg=name)
        asked = [name for batch in source.asked for name in batch]
        assert len(asked) == len(set(asked)) and set(asked) <= set(old)

        source.asked.clear()
        source.answers = 1
        source.version = "cccc"
        probe.until(lambda: source.asked, 60, "it asks again")
        first = len(source.rewarded)
        episodes(first + 6)
        held = saved()
        answered = set(source.asked[0])
        assert len(source.asked) == 2 and answered <= set(held)
        lost = set(list(source.rewarded)[:24]) - answered
        assert lost and not lost & set(held)
        for name, values in held.items():
            np.testing.assert_array_equal(values, VALUES["cccc"], err_msg=name)
        assert "episodes could not be rewarded again and are dropped" in learner.text()
    finally:
        probe.close()
