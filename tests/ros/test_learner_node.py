"""The node learner in a real graph: parity with learning in-process, deaths, resume, cancel."""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Evaluate, Train
from rclpy.action import ActionClient
from ros_harness import NodeProcess, Probe, ros
from std_srvs.srv import Trigger

from rapl_core.policies import (
    GroundTruthReward,
    LearningCurve,
    SacConfig,
    ScheduleConfig,
    read_checkpoint,
)
from rapl_core.policies.in_process import train_in_process
from rapl_ros import qos, topics

pytestmark = pytest.mark.ros

SCALE = 2.5
SAC = SacConfig(hidden=(32, 32), batch_size=64)
SCHEDULE = ScheduleConfig(
    steps=720,
    worlds=2,
    random_steps=240,
    block_steps=50,
    train_ratio=0.5,
    evaluate_every=360,
    evaluate_episodes=2,
    checkpoint_every=360,
)
START_S = 200.0
"""torch takes seconds to import, many on a busy machine."""
Start = Callable[..., NodeProcess]


@pytest.fixture
def rclpy_context() -> Iterator[None]:
    """Tests that kill nodes have a domain each."""
    with ros(own_domain=True):
        yield


class Graph:
    """Simulator, ot_reward on the true reward, and learner, each in its process."""

    def __init__(self, start: Start, folder: Path) -> None:
        self.simulator = start(
            "rapl_ros.simulator_node", worlds=2, render=False, clock_file=folder / "clock"
        )
        self.ot_reward = start(
            "rapl_ros.ot_reward_node", source="human_reward", human_reward_scale=SCALE
        )
        self.learner = start_learner(start, folder)


def start_learner(
    start: Start, folder: Path, evaluate_episodes: int = 2, reward_deadline_s: float = 15.0
) -> NodeProcess:
    return start(
        "rapl_ros.learner_node",
        run_folder=folder,
        seed=5,
        reward_deadline_s=reward_deadline_s,
        sac__hidden="[32, 32]",
        sac__batch_size=64,
        schedule__random_steps=SCHEDULE.random_steps,
        schedule__block_steps=SCHEDULE.block_steps,
        schedule__train_ratio=SCHEDULE.train_ratio,
        schedule__evaluate_every=SCHEDULE.evaluate_every,
        schedule__evaluate_episodes=evaluate_episodes,
        schedule__checkpoint_every=SCHEDULE.checkpoint_every,
    )


class Training:
    """A goal of ~/train or ~/evaluate under way."""

    def __init__(self, probe: Probe, kind: type, name: str, goal: Any) -> None:
        self.probe = probe
        self.feedback: list[Any] = []
        self.client = ActionClient(probe.node, kind, topics.of_node(name, topics.LEARNER))
        probe.until(self.client.server_is_ready, START_S, "the learner appears")
        sent = self.client.send_goal_async(
            goal, feedback_callback=lambda msg: self.feedback.append(msg.feedback)
        )
        self.handle = probe.wait(sent, 60.0, "the goal is answered")

    def result(self, deadline_s: float) -> Any:
        answer = self.handle.get_result_async()
        return self.probe.wait(answer, deadline_s, "the goal ends")

    @property
    def steps(self) -> int:
        return self.feedback[-1].metrics.steps if self.feedback else 0


def train(probe: Probe, steps: int, resume: bool = False) -> Training:
    return Training(probe, Train, topics.TRAIN, Train.Goal(steps=steps, resume=resume))


def heartbeats(probe: Probe, node: str) -> list[wire_msg.Heartbeat]:
    name = topics.of_node(topics.HEARTBEAT, node)
    return probe.listen(wire_msg.Heartbeat, name, qos.heartbeat())


@pytest.mark.timeout(400)
def test_the_graph_learns_what_learning_in_process_learns_to_the_last_bit(
    probe: Probe, start: Start, tmp_path: Path
) -> None:
    Graph(start, tmp_path)
    rewards = probe.listen(wire_msg.Reward, topics.REWARD, qos.event())
    policies = probe.listen(wire_msg.PolicyInfo, topics.POLICY_INFO, qos.latched())
    training = train(probe, SCHEDULE.steps)
    answer = training.result(120)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    assert answer.result.metrics.steps == SCHEDULE.steps
    assert answer.result.policy_id == "000000720"

    reference = tmp_path / "reference"
    curve = train_in_process("franka_group", GroundTruthReward(SCALE), SAC, SCHEDULE, 5, reference)
    graph = LearningCurve.load(tmp_path / "policies" / "curve.json")
    assert [p.steps for p in graph.points] == [p.steps for p in curve.points] == [360, 720]
    for ours, theirs in zip(graph.points, curve.points, strict=True):
        assert ours.human_return_mean == pytest.approx(theirs.human_return_mean, rel=1e-12)
        assert ours.success_rate == theirs.success_rate
    ours = read_checkpoint(tmp_path / "policies" / "000000720")["trainer"]
    theirs = read_checkpoint(reference / "checkpoints" / "000000720")["trainer"]
    assert ours.arrays.keys() == theirs.arrays.keys()
    for name in ours.arrays:
        np.testing.assert_array_equal(ours.arrays[name], theirs.arrays[name], err_msg=name)

    probe.until(lambda: policies and policies[-1].steps == 720, 5.0, "the policy is told")
    assert (tmp_path / policies[-1].uri).is_dir()
    by_episode = [reward.episode_id for reward in rewards]
    assert len(by_episode) == len(set(by_episode)), "one reward an episode"
    assert all(reward.valid for reward in rewards)
    assert list((tmp_path / "metrics").glob("events.out.tfevents.*"))

    evaluation = Training(
        probe, Evaluate, topics.EVALUATE, Evaluate.Goal(episodes=3, seed=5)
    ).result(60)
    assert evaluation.result.success, evaluation.result.message
    ids = list(evaluation.result.episode_ids)
    assert len(ids) == 3 and not set(ids) & set(by_episode)
    assert np.isfinite(evaluation.result.reward_mean)
    assert evaluation.result.reward_mean == pytest.approx(
        SCALE * evaluation.result.human_return_mean
    )


@pytest.mark.timeout(400)
@pytest.mark.parametrize("victim", ["simulator", "ot_reward"])
def test_a_killed_peer_is_named_within_5_s_and_training_goes_on_when_it_is_back(
    probe: Probe, start: Start, tmp_path: Path, victim: str
) -> None:
    graph = Graph(start, tmp_path)
    beats = heartbeats(probe, topics.LEARNER)
    training = train(probe, SCHEDULE.steps)
    probe.until(lambda: training.steps >= 240, 60, "some steps")
    process = getattr(graph, victim)
    process.kill()
    killed_s = time.monotonic()
    diagnostics = probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())

    def is_said() -> bool:
        return bool(diagnostics) and f"{victim} is gone" in probe.status_of(topics.LEARNER).get(
            "message", ""
        )

    probe.until(is_said, 5.0, f"the learner says that {victim} is gone")
    assert time.monotonic() - killed_s < 5.0
    if victim == "ot_reward":
        probe.until(
            lambda: beats[-1].status == "waiting" and victim in beats[-1].detail,
            10.0,
            "the learner waits",
        )
    process.restart()
    answer = training.result(120)
    assert answer.result.success, answer.result.message
    assert answer.result.metrics.steps >= SCHEDULE.steps


@pytest.mark.timeout(400)
def test_a_killed_learner_goes_on_from_its_checkpoint(
    probe: Probe, start: Start, tmp_path: Path
) -> None:
    graph = Graph(start, tmp_path)
    beats = heartbeats(probe, topics.LEARNER)
    train(probe, 5_000)
    checkpoint = tmp_path / "policies" / "000000360"
    probe.until(checkpoint.is_dir, 90, "a checkpoint")
    graph.learner.kill()
    read_checkpoint(checkpoint)  # complete, by its hashes
    dead = beats[-1].incarnation
    second = Probe("second")
    try:
        graph.learner.restart()
        beats = heartbeats(second, topics.LEARNER)
        second.until(
            lambda: [beat for beat in beats if beat.incarnation != dead],
            START_S,
            "the learner is back",
        )
        second.spin_for(2.0)  # its services follow
        refused = train(second, 720).result(60)
        assert not refused.result.success and "resume it" in refused.result.message
        resumed = train(second, 720, resume=True)
        answer = resumed.result(120)
        assert answer.result.success, answer.result.message
        assert min(feedback.metrics.steps for feedback in resumed.feedback) > 360
        assert answer.result.metrics.steps == 720
    finally:
        second.close()


@pytest.mark.timeout(400)
def test_save_and_cancel_leave_a_checkpoint_and_a_busy_learner_refuses(
    probe: Probe, start: Start, tmp_path: Path
) -> None:
    Graph(start, tmp_path)
    training = train(probe, 100_000)
    probe.until(lambda: training.steps >= 120, 60, "some steps")
    assert not train(probe, 100).handle.accepted
    saved = probe.call(Trigger, topics.of_node(topics.SAVE, topics.LEARNER), Trigger.Request(), 60)
    assert saved.success
    read_checkpoint(Path(saved.message))
    probe.wait(training.handle.cancel_goal_async(), 10, "the cancel is answered")
    answer = training.result(60)
    assert answer.status == GoalStatus.STATUS_CANCELED
    newest = max(path.name for path in (tmp_path / "policies").iterdir() if path.is_dir())
    assert int(newest) == answer.result.metrics.steps
    idle = probe.call(Trigger, topics.of_node(topics.SAVE, topics.LEARNER), Trigger.Request(), 10)
    assert not idle.success and "no training" in idle.message


@pytest.mark.timeout(300)
def test_back_pressure_no_round_begins_while_rewards_are_missing(
    start: Start, tmp_path: Path, rclpy_context: None
) -> None:
    """The probe takes ot_reward's place and keeps silent, then answers out of order."""
    from rapl_ros.liveness import Heartbeat

    probe = Probe(topics.OT_REWARD)
    try:
        start("rapl_ros.simulator_node", worlds=2, render=False, clock_file=tmp_path / "clock")
        # a deadline that a loaded machine does not reach: a late episode would be dropped
        start_learner(start, tmp_path, evaluate_episodes=0, reward_deadline_s=120.0)
        heart = Heartbeat(probe.node)
        heart.report("active")
        states = probe.listen(wire_msg.State, topics.STATE, qos.stream())
        rewards = probe.node.create_publisher(wire_msg.Reward, topics.REWARD, qos.event())
        training = train(probe, 2_000)

        def ended() -> list[str]:
            return sorted({s.episode_id for s in states if s.is_last and s.purpose == "train"})

        probe.until(lambda: len(ended()) == 4, 60, "two rounds")
        probe.spin_for(3.0)
        began = {state.episode_id for state in states}
        assert len(began) == len(ended()) == 4, "no third round without the first one's rewards"
        last = {s.episode_id: s for s in states if s.is_last}
        for name in reversed(ended()):
            rewards.publish(
                wire_msg.Reward(
                    header=last[name].header,
                    episode_id=name,
                    world=last[name].world,
                    purpose="train",
                    valid=True,
                    total=-60.0,
                    scale=1.0,
                    converged=True,
                    values=[-1.0] * last[name].step,
                )
            )
        probe.until(lambda: len(ended()) >= 6, 30, "the next round")
        probe.until(lambda: training.steps >= 360, 10, "and it counts")
        metrics = training.feedback[-1].metrics
        assert metrics.dropped_episodes == 0 and metrics.reward_mean == -60.0
    finally:
        probe.close()


def test_a_signal_ends_it_cleanly_within_5_s(start: Start, tmp_path: Path, probe: Probe) -> None:
    graph = Graph(start, tmp_path)
    training = train(probe, 5_000)
    probe.until(lambda: training.steps >= 120, 60, "some steps")
    began_s = time.monotonic()
    assert graph.learner.signal(signal.SIGINT) == 0, graph.learner.text()
    assert time.monotonic() - began_s < 5.0
