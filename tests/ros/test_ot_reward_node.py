"""The node ot_reward on real topics: one reward for every episode, equal to rapl_core's."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs import msg as wire_msg
from rapl_msgs.srv import EmbedEpisodes, RewardAgain
from rclpy.task import Future
from ros_harness import DISCOVERY_S, NodeProcess, Probe

from rapl_core.streaming.reward_rule import RewardRule
from rapl_core.transport import TransportConfig, ot_reward
from rapl_core.types import EmbeddedEpisode, EncoderInfo, ExpertSet
from rapl_ros import conversions, qos, topics
from rapl_ros.liveness import Heartbeat
from rapl_ros.wire import EmbeddedFrame, EmbeddingsAgain, EpisodeRecord, Instant, JoinKey

pytestmark = pytest.mark.ros

HORIZON, SIZE = 6, 8
RULE = RewardRule("ot", 3.0, TransportConfig(cost="cosine", solver="sinkhorn", epsilon=0.05))


def embeddings(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(HORIZON + 1, SIZE)).astype(np.float32)


def experts(version: str) -> ExpertSet:
    videos = [EmbeddedEpisode(f"expert{i}", embeddings(100 + i)[1:]) for i in range(3)]
    return ExpertSet("rapl", version, tuple(videos))


class Robot:
    """Publishes what a simulator and an encoder would."""

    def __init__(self, probe: Probe) -> None:
        def publisher(kind: type, topic: str, profile: Any) -> Any:
            return probe.node.create_publisher(kind, topic, profile)

        self.probe = probe
        self.states = publisher(wire_msg.State, topics.STATE, qos.stream())
        self.embeddings = publisher(wire_msg.Embedding, topics.EMBEDDING, qos.stream())
        self.infos = publisher(wire_msg.EncoderInfo, topics.ENCODER_INFO, qos.latched())
        self.experts = publisher(wire_msg.ExpertSet, topics.EXPERTS, qos.latched())
        self.rewards = probe.listen(wire_msg.Reward, topics.REWARD, qos.event())
        probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
        self._stamp_ns = 0

    def wait_for_node(self) -> None:
        everyone = (self.states, self.embeddings, self.infos, self.experts)
        self.probe.until(
            lambda: (
                all(p.get_subscription_count() for p in everyone)
                and self.probe.node.count_publishers(topics.REWARD)
            ),
            DISCOVERY_S,
            "ot_reward subscribes",
        )

    def describe(self, version: str, rule: RewardRule = RULE) -> None:
        self.experts.publish(conversions.experts_to_ros(experts(version), 0))
        info = EncoderInfo("rapl", version, "none", "tuned", SIZE, 112, 112, rule.scale)
        self.infos.publish(conversions.encoder_info_to_ros(info, rule, 0))

    def instants(self, name: str, world: int = 0) -> list[Instant]:
        instants = []
        for step in range(HORIZON + 1):
            self._stamp_ns += 1_000_000
            instants.append(
                Instant(
                    key=JoinKey(topics.world_frame(world), self._stamp_ns),
                    image=JoinKey(topics.camera_frame(world), self._stamp_ns),
                    world=world,
                    episode_id=name,
                    purpose="train",
                    controller="learner",
                    step=step,
                    is_last=step == HORIZON,
                    terminated=False,
                    values=np.zeros(3),
                    human_reward=-float(step),
                    success=False,
                )
            )
        return instants

    def say(self, instant: Instant) -> None:
        self.states.publish(conversions.state_to_ros(instant))

    def show(self, instant: Instant, z: np.ndarray, version: str) -> None:
        frame = EmbeddedFrame(instant.image, "rapl", version, z)
        self.embeddings.publish(conversions.embedding_to_ros(frame))

    def play(self, name: str, version: str, seed: int) -> None:
        for instant, z in zip(self.instants(name), embeddings(seed), strict=True):
            self.say(instant)
            self.show(instant, z, version)

    def reward_of(self, name: str, deadline_s: float = 10.0) -> wire_msg.Reward:
        def found() -> list[wire_msg.Reward]:
            return [reward for reward in self.rewards if reward.episode_id == name]

        self.probe.until(found, deadline_s, f"a reward of {name}")
        self.probe.spin_for(0.3)
        assert len(found()) == 1, "exactly one"
        return found()[0]


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    log = tmp_path_factory.mktemp("ot_reward") / "log"
    process = NodeProcess(
        "rapl_ros.ot_reward_node", log, embedding_deadline_s=2.0, state_deadline_s=2.0
    )
    yield process
    process.stop()


@pytest.fixture(scope="module")
def robot(node: NodeProcess, rclpy_context: None) -> Iterator[Robot]:
    probe = Probe("robot")
    robot = Robot(probe)
    robot.wait_for_node()
    robot.describe("aaaa")
    yield robot
    probe.close()


def test_the_reward_equals_that_of_rapl_core(robot: Robot) -> None:
    robot.play("equal", "aaaa", seed=1)
    msg = robot.reward_of("equal")
    expected = ot_reward(embeddings(1)[1:], experts("aaaa").experts, RULE.transport, RULE.scale)
    assert msg.valid and msg.reason == ""
    np.testing.assert_allclose(msg.values, expected.values, rtol=1e-6)
    assert msg.total == pytest.approx(expected.total, rel=1e-6)
    assert msg.transport_cost == pytest.approx(expected.transport_cost, rel=1e-6)
    assert (msg.expert_id, msg.encoder, msg.version) == (expected.expert_id, "rapl", "aaaa")
    assert msg.converged and msg.scale == RULE.scale
    assert len(msg.values) == HORIZON


def test_order_and_repeats_do_not_matter(robot: Robot) -> None:
    instants = robot.instants("shuffled")
    zs = embeddings(2)
    for instant, z in reversed(list(zip(instants, zs, strict=True))):
        robot.show(instant, z, "aaaa")
        robot.show(instant, z, "aaaa")
    for instant in (*instants[:4], *instants):
        robot.say(instant)
    expected = ot_reward(zs[1:], experts("aaaa").experts, RULE.transport, RULE.scale)
    np.testing.assert_allclose(robot.reward_of("shuffled").values, expected.values, rtol=1e-6)


def test_an_episode_that_stops_in_the_middle_is_dropped_with_the_reason(robot: Robot) -> None:
    for instant, z in list(zip(robot.instants("stopped"), embeddings(3), strict=True))[:3]:
        robot.say(instant)
        robot.show(instant, z, "aaaa")
    msg = robot.reward_of("stopped", deadline_s=5.0)
    assert not msg.valid
    assert msg.reason == "stopped at step 2: no state for 2 s"


def test_a_missing_embedding_drops_the_episode_and_names_the_step(robot: Robot) -> None:
    for instant, z in zip(robot.instants("gap"), embeddings(4), strict=True):
        robot.say(instant)
        if instant.step != 4:
            robot.show(instant, z, "aaaa")
    msg = robot.reward_of("gap", deadline_s=5.0)
    assert not msg.valid and "embedding missing at step 4" in msg.reason


def test_an_embedding_with_nan_drops_the_episode_at_once(robot: Robot) -> None:
    instants = robot.instants("nan")
    bad = conversions.failed_embedding_to_ros(instants[2].image, "rapl", "aaaa")
    bad.values = [float("nan")] * SIZE
    for instant in instants[:4]:
        robot.say(instant)
    robot.embeddings.publish(bad)
    msg = robot.reward_of("nan", deadline_s=1.5)
    assert not msg.valid and "image of step 2" in msg.reason and "NaN" in msg.reason


def test_an_image_that_the_encoder_gave_up_drops_the_episode(robot: Robot) -> None:
    instants = robot.instants("corrupt")
    failed = conversions.failed_embedding_to_ros(instants[5].image, "rapl", "aaaa")
    robot.embeddings.publish(failed)
    for instant in instants:
        robot.say(instant)
    msg = robot.reward_of("corrupt")
    assert msg.reason == "image of step 5: the encoder could not embed it"


def test_no_reward_mixes_two_versions_of_an_encoder(robot: Robot) -> None:
    for instant, z in zip(robot.instants("mixed"), embeddings(5), strict=True):
        robot.say(instant)
        robot.show(instant, z, "aaaa" if instant.step < 4 else "bbbb")
    msg = robot.reward_of("mixed")
    assert not msg.valid and "two encoder versions" in msg.reason


def test_a_reward_waits_for_the_experts_of_its_version(robot: Robot) -> None:
    robot.play("early", "cccc", seed=6)
    robot.probe.spin_for(0.7)
    assert not [reward for reward in robot.rewards if reward.episode_id == "early"]
    robot.describe("cccc")
    msg = robot.reward_of("early")
    assert msg.valid and msg.version == "cccc"


def test_without_experts_the_episode_is_dropped_in_time(robot: Robot) -> None:
    robot.play("lonely", "dddd", seed=7)
    msg = robot.reward_of("lonely", deadline_s=5.0)
    assert not msg.valid and "version dddd" in msg.reason


def test_a_solver_that_does_not_converge_is_counted_and_told(robot: Robot) -> None:
    hurried = TransportConfig(cost="cosine", solver="sinkhorn", epsilon=0.001, max_iterations=10)
    robot.describe("hurried", RewardRule("ot", 3.0, hurried))
    robot.play("train-hurried", "hurried", seed=30)
    assert not robot.reward_of("train-hurried").converged
    status = robot.probe.until(
        lambda: robot.probe.status_of(topics.OT_REWARD).get("transport"), 5.0, "a warning"
    )
    assert "did not converge for train-hurried: marginal error" in status
    assert int(robot.probe.status_of(topics.OT_REWARD)["unconverged"]) >= 1


def test_a_bad_description_of_an_encoder_stands_until_a_good_one_comes(robot: Robot) -> None:
    robot.infos.publish(wire_msg.EncoderInfo(encoder="rapl", version="bad", reward_kind="luck"))
    robot.probe.until(
        lambda: "bad encoder_info" in robot.probe.status_of(topics.OT_REWARD), 5.0, "an error"
    )
    robot.describe("good")
    robot.probe.until(
        lambda: "bad encoder_info" not in robot.probe.status_of(topics.OT_REWARD), 5.0, "the end"
    )


def reward_again(robot: Robot, ids: list[str]) -> RewardAgain.Response:
    name = topics.of_node(topics.REWARD_AGAIN, topics.OT_REWARD)
    return robot.probe.call(RewardAgain, name, RewardAgain.Request(episode_ids=ids), 20.0)


def test_recorded_episodes_are_rewarded_again_by_the_rule_of_the_version_at_work(
    robot: Robot,
) -> None:
    """A probe answers in the encoder's place, then hangs, then dies."""
    version, hangs = "aaaa", False
    encoder = Probe(topics.ENCODER)
    Heartbeat(encoder.node).report("active")
    robot.probe.executor.add_node(encoder.node)
    beats = robot.probe.listen(
        wire_msg.Heartbeat, topics.of_node(topics.HEARTBEAT, topics.OT_REWARD), qos.heartbeat()
    )
    z = {name: embeddings(seed)[1:] for name, seed in (("old-1", 21), ("old-2", 22))}

    def record(name: str) -> EpisodeRecord:
        key = JoinKey(topics.world_frame(1), 77)
        return EpisodeRecord(key, name, "franka_group", 1, "train", "learner", "sac", HORIZON, "")

    async def embed(
        request: EmbedEpisodes.Request, response: EmbedEpisodes.Response
    ) -> EmbedEpisodes.Response:
        if hangs:
            await Future(executor=robot.probe.executor)
        known = [name for name in request.episode_ids if name in z]
        missing = {name: "not recorded" for name in request.episode_ids if name not in z}
        episodes = tuple((record(name), EmbeddedEpisode(name, z[name])) for name in known)
        again = EmbeddingsAgain("rapl", version, episodes, missing)
        conversions.fill_embed_episodes(response, again)
        return response

    encoder.node.create_service(EmbedEpisodes, topics.EMBED_EPISODES, embed)
    robot.probe.until(
        lambda: beats and beats[-1].status == "active", DISCOVERY_S, "the encoder is noticed"
    )
    try:
        published = len(robot.rewards)
        response = reward_again(robot, ["old-2", "gone", "old-1"])
        assert response.success, response.message
        again = conversions.rewards_again_from_ros(response)
        assert (again.encoder, again.version) == ("rapl", "aaaa")
        assert again.missing == {"gone": "not recorded"}
        assert [whose.episode_id for whose, _ in again.rewards] == ["old-2", "old-1"]
        for whose, trace in again.rewards:
            expected = ot_reward(
                z[whose.episode_id], experts("aaaa").experts, RULE.transport, RULE.scale
            )
            np.testing.assert_allclose(trace.values, expected.values, rtol=1e-6)
            assert (whose.key.stamp_ns, whose.world, whose.purpose) == (77, 1, "train")
        version = "eeee"
        refused = reward_again(robot, ["old-1"])
        assert not refused.success and "version eeee is not known" in refused.message
        robot.probe.spin_for(0.3)
        assert len(robot.rewards) == published, "the topic keeps one reward an episode"
        hangs = True
        service = topics.of_node(topics.REWARD_AGAIN, topics.OT_REWARD)
        client = robot.probe.node.create_client(RewardAgain, service)
        robot.probe.until(client.service_is_ready, DISCOVERY_S, "reward_again is there")
        asked = client.call_async(RewardAgain.Request(episode_ids=["old-1"]))
        robot.probe.spin_for(1.0)
        assert not asked.done()
    finally:
        robot.probe.executor.remove_node(encoder.node)
        encoder.close()
    answer = robot.probe.wait(asked, 6.0, "that the encoder died is no reason to wait for long")
    assert not answer.success and "encoder died meanwhile" in answer.message
    robot.probe.until(lambda: beats[-1].status == "waiting", 5.0, "the encoder is missed")


def test_it_says_that_the_encoder_is_missing(robot: Robot) -> None:
    beats = robot.probe.listen(
        wire_msg.Heartbeat, topics.of_node(topics.HEARTBEAT, topics.OT_REWARD), qos.heartbeat()
    )
    beat = robot.probe.until(lambda: beats and beats[-1], 5.0, "a heartbeat")
    assert (beat.status, beat.detail) == ("waiting", "for the encoder")


def test_it_loads_no_torch(robot: Robot, node: NodeProcess) -> None:
    robot.play("any", "aaaa", seed=8)
    assert robot.reward_of("any").valid
    maps = Path(f"/proc/{node.process.pid}/maps").read_text()
    assert "numpy" in maps and "libtorch" not in maps


def test_the_oracle_needs_no_encoder(probe: Probe, start: Callable[..., NodeProcess]) -> None:
    start("rapl_ros.ot_reward_node", source="human_reward", human_reward_scale=2.0)
    rewards = probe.listen(wire_msg.Reward, topics.REWARD, qos.event())
    states = probe.node.create_publisher(wire_msg.State, topics.STATE, qos.stream())
    beats = probe.listen(
        wire_msg.Heartbeat, topics.of_node(topics.HEARTBEAT, topics.OT_REWARD), qos.heartbeat()
    )
    probe.until(lambda: [b for b in beats if b.status == "active"], DISCOVERY_S, "it is active")
    probe.until(states.get_subscription_count, DISCOVERY_S, "it subscribes")
    probe.spin_for(0.5)
    for instant in Robot(probe).instants("oracle"):
        states.publish(conversions.state_to_ros(instant))
    msg = probe.until(
        lambda: next((r for r in rewards if r.episode_id == "oracle" and r.valid), None),
        10.0,
        "a reward",
    )
    np.testing.assert_array_equal(msg.values, [-2.0 * step for step in range(1, HORIZON + 1)])
    assert msg.encoder == "" and msg.scale == 2.0
