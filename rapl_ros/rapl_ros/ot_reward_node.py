"""The node ``ot_reward``: one reward for every episode that began.

Subscribes ``state``, ``embedding``, ``encoder_info`` (latched), ``experts`` (latched).
Publishes ``reward`` (rapl_msgs/Reward). Serves ``~/reward_again`` (rapl_msgs/RewardAgain); calls
``encoder/embed_episodes``.
Parameters: ``source`` (embedding | human_reward), ``human_reward_scale``, the two deadlines.
"""

import time
from collections.abc import Iterable
from typing import Any

from rapl_msgs import msg as wire_msg

from rapl_core.errors import RaplError
from rapl_core.streaming.reward_desk import DeskConfig, RewardDecision, RewardDesk
from rapl_core.types import RewardTrace
from rapl_ros import conversions, qos, topics
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.rewarding_again import RewardingAgain
from rapl_ros.wire import EpisodeReward, Instant

CHECK_PERIOD_S = 0.2


class OtRewardNode(RaplNode):
    """Joins states and embeddings by the image's header and scores what is complete.

    Scoring takes 0.1 to 60 ms an episode, by solver, and stays on the executor's thread: nothing
    else waits for this node, and its queues hold three episodes of all worlds.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.OT_REWARD, peers=(topics.SIMULATOR,), **options)
        self._desk = RewardDesk(declare_config(self, DeskConfig()))
        self._rewards = self.publish_to(wire_msg.Reward, topics.REWARD, qos.event())
        self.subscribe_to(wire_msg.State, topics.STATE, self._on_state, qos.stream())
        if self._desk.config.source == "embedding":
            self.watch(topics.ENCODER)
            self.subscribe_to(
                wire_msg.Embedding, topics.EMBEDDING, self._on_embedding, qos.stream()
            )
            self.subscribe_to(
                wire_msg.EncoderInfo, topics.ENCODER_INFO, self._on_encoder, qos.latched()
            )
            self.subscribe_to(wire_msg.ExpertSet, topics.EXPERTS, self._on_experts, qos.latched())
        RewardingAgain(self, self._desk)
        self.steady_timer(CHECK_PERIOD_S, self._on_check)
        self._say_what_is_missing()

    def _on_state(self, msg: wire_msg.State) -> None:
        try:
            state: Instant = conversions.state_from_ros(msg)
        except RaplError as error:
            self.diagnostics.count("refused_state")
            self.diagnostics.error_for(BAD_INPUT_S, "bad state", str(error))
            return
        with self.diagnostics.shares.of("transport"):
            decisions = self._desk.add_state(state, time.monotonic())
        self._publish(decisions)

    def _on_embedding(self, msg: wire_msg.Embedding) -> None:
        try:
            frame = conversions.embedding_from_ros(msg)
        except RaplError as error:
            reason = str(error) if msg.values else "the encoder could not embed it"
            self.diagnostics.count("unusable_embeddings")
            image = conversions.key_from_ros(msg.header)
            self._publish(self._desk.spoil(image, reason, time.monotonic()))
            return
        with self.diagnostics.shares.of("transport"):
            decisions = self._desk.add_embedding(frame, time.monotonic())
        self._publish(decisions)

    def _on_encoder(self, msg: wire_msg.EncoderInfo) -> None:
        try:
            rule = conversions.reward_rule_from_ros(msg)
        except RaplError as error:
            self._refuse("encoder_info", error)
            return
        self.diagnostics.clear("bad encoder_info")
        self.get_logger().info(f"encoder {msg.encoder} version {msg.version}: {rule}")
        self._publish(self._desk.set_rule(msg.version, rule))

    def _on_experts(self, msg: wire_msg.ExpertSet) -> None:
        try:
            experts = conversions.experts_from_ros(msg)
        except RaplError as error:
            self._refuse("experts", error)
            return
        self.diagnostics.clear("bad experts")
        self._publish(self._desk.set_experts(experts))

    def _on_check(self) -> None:
        self._publish(self._desk.tick(time.monotonic()))
        self._say_what_is_missing()
        counters, assembler = self.diagnostics.counters, self._desk.assembler
        counters["rewarded"], counters["dropped"] = self._desk.rewarded, self._desk.dropped
        counters["pending"] = self._desk.pending
        counters["late_states"] = assembler.late_states
        counters["evicted_embeddings"] = assembler.evicted_embeddings

    def _say_what_is_missing(self) -> None:
        """The learner begins no round while this node waits: its steps would be wasted."""
        simulator = self.peers[topics.SIMULATOR]
        if simulator.incarnation and not simulator.alive:  # it was there; a robot has none
            self.heartbeat.report("waiting", "for the simulator")
            return
        encoder = self.peers.get(topics.ENCODER)
        if encoder is None or (encoder.alive and encoder.status == "active"):
            self.heartbeat.report("active", f"rewards from {self._desk.config.source}")
        elif encoder.alive:
            self.heartbeat.report("waiting", f"for the encoder, which waits {encoder.detail}")
        else:
            self.heartbeat.report("waiting", "for the encoder")

    def _publish(self, decisions: Iterable[RewardDecision]) -> None:
        for decision in decisions:
            last = decision.last
            assert isinstance(last, Instant)
            whose = EpisodeReward(
                key=last.key,
                episode_id=last.episode_id,
                world=last.world,
                purpose=last.purpose,
                encoder=decision.encoder,
                version=decision.version,
            )
            if decision.trace is None:
                self._rewards.publish(conversions.invalid_reward_to_ros(whose, decision.reason))
            else:
                self._rewards.publish(conversions.reward_to_ros(whose, decision.trace))
                self._check_convergence(last.episode_id, decision.trace)

    def _check_convergence(self, episode_id: str, trace: RewardTrace) -> None:
        if not trace.converged:
            self.diagnostics.count("unconverged")
            self.diagnostics.warn_for(
                BAD_INPUT_S,
                "transport",
                f"the solver did not converge for {episode_id}: marginal error "
                f"{trace.marginal_error:.1e} after {trace.iterations} iterations",
            )

    def _refuse(self, topic: str, error: RaplError) -> None:
        """What is latched is refused until a better one comes."""
        self.diagnostics.count(f"refused_{topic}")
        self.diagnostics.error(f"bad {topic}", str(error))


if __name__ == "__main__":
    main(OtRewardNode)
