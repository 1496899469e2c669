"""The reward desk: rewards equal the batch form, wait for their experts, and come exactly once."""

import numpy as np
import pytest
from streams import State, embeddings, states

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.streaming.reward_desk import DeskConfig, RewardDecision, RewardDesk
from rapl_core.streaming.reward_rule import RewardRule
from rapl_core.transport import TransportConfig, ot_reward
from rapl_core.types import EmbeddedEpisode, ExpertSet

RULE = RewardRule("ot", 2.5, TransportConfig(cost="euclidean", epsilon=0.5))


def experts(version: str = "aaaa") -> ExpertSet:
    rng = np.random.default_rng(0)
    videos = [EmbeddedEpisode(f"x{i}", rng.normal(size=(4, 2)).astype(np.float32)) for i in (0, 1)]
    return ExpertSet("rapl", version, tuple(videos))


def play(desk: RewardDesk, name: str, version: str = "aaaa") -> list[RewardDecision]:
    decisions: list[RewardDecision] = []
    for state, embedding in zip(states(name, 3), embeddings(name, 3, version), strict=True):
        decisions += desk.add_state(state, 0.0)
        decisions += desk.add_embedding(embedding, 0.0)
    return decisions


def ready_desk() -> RewardDesk:
    desk = RewardDesk(DeskConfig())
    desk.set_experts(experts())
    desk.set_rule("aaaa", RULE)
    return desk


def test_the_streamed_reward_equals_the_batch_reward() -> None:
    (decision,) = play(ready_desk(), "e")
    z = np.array([[1, 1], [2, 1], [3, 1]], np.float32)
    expected = ot_reward(z, experts().experts, RULE.transport, RULE.scale)
    assert decision.trace is not None
    np.testing.assert_allclose(decision.trace.values, expected.values, rtol=1e-6)
    assert decision.trace.expert_id == expected.expert_id
    assert (decision.encoder, decision.version) == ("rapl", "aaaa")


@pytest.mark.parametrize("experts_first", [True, False])
def test_it_waits_for_rule_and_experts_of_the_version(experts_first: bool) -> None:
    desk = ready_desk()
    assert play(desk, "e", version="bbbb") == []
    assert desk.tick(1.0) == []
    assert desk.pending == 1
    steps = [
        lambda: desk.set_experts(experts("bbbb")),
        lambda: desk.set_rule("bbbb", RULE),
    ]
    first, second = steps if experts_first else reversed(steps)
    assert first() == []
    (decision,) = second()
    assert decision.trace is not None and decision.version == "bbbb"
    assert desk.pending == 0


def test_experts_that_never_come_drop_the_episode_and_name_the_version() -> None:
    desk = RewardDesk(DeskConfig(embedding_deadline_s=3.0))
    desk.set_rule("aaaa", RULE)
    play(desk, "e")
    assert desk.tick(2.9) == []
    (decision,) = desk.tick(3.1)
    assert decision.trace is None
    assert decision.reason == "no experts of encoder rapl version aaaa came"
    assert desk.tick(99.0) == []


def test_experts_of_another_width_drop_the_episode_with_the_reason() -> None:
    desk = RewardDesk(DeskConfig())
    desk.set_rule("aaaa", RULE)
    wide = EmbeddedEpisode("wide", np.ones((4, 7), np.float32))
    desk.set_experts(ExpertSet("rapl", "aaaa", (wide,)))
    (decision,) = play(desk, "e")
    assert decision.trace is None and "expert wide" in decision.reason


def test_a_scalar_rule_needs_no_experts() -> None:
    desk = RewardDesk(DeskConfig())
    desk.set_rule("aaaa", RewardRule("scalar", 10.0))
    (decision,) = play(desk, "e")
    assert decision.trace is not None
    np.testing.assert_array_equal(decision.trace.values, [10.0, 20.0, 30.0])


def test_the_human_reward_needs_neither_encoder_nor_embeddings() -> None:
    desk = RewardDesk(DeskConfig(source="human_reward", human_reward_scale=4.0))
    decisions = [d for state in states("e", 3) for d in desk.add_state(state, 0.0)]
    assert len(decisions) == 1 and decisions[0].trace is not None
    np.testing.assert_array_equal(decisions[0].trace.values, [-4.0, -8.0, -12.0])


def test_the_human_reward_of_a_robot_without_truth_is_refused() -> None:
    desk = RewardDesk(DeskConfig(source="human_reward"))
    desk.add_state(State("e", 0, False, human_reward=None), 0.0)
    (decision,) = desk.add_state(State("e", 1, True, human_reward=None), 0.0)
    assert decision.trace is None and "no truth" in decision.reason


def test_an_unknown_reward_kind_names_the_known() -> None:
    with pytest.raises(UnknownNameError, match="known: clock, goal, ot, scalar"):
        RewardRule("magic")  # type: ignore[arg-type]


def test_an_episode_is_rewarded_again_as_it_would_have_been_and_counts_once() -> None:
    desk = ready_desk()
    (decision,) = play(desk, "e")
    z = np.array([[1, 1], [2, 1], [3, 1]], np.float32)
    again = desk.reward_again("aaaa", z)
    assert decision.trace is not None
    np.testing.assert_array_equal(again.values, decision.trace.values)
    assert desk.rewarded == 1 and desk.pending == 0


def test_no_reward_again_without_the_version_its_experts_or_an_encoder() -> None:
    desk = ready_desk()
    z = np.ones((3, 2), np.float32)
    with pytest.raises(RaplError, match="version bbbb is not known"):
        desk.reward_again("bbbb", z)
    desk.set_rule("bbbb", RULE)
    with pytest.raises(RaplError, match="version bbbb is not known"):
        desk.reward_again("bbbb", z)
    with pytest.raises(RaplError, match="human_reward"):
        RewardDesk(DeskConfig(source="human_reward")).reward_again("aaaa", z)
