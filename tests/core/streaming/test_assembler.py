"""The assembler: one outcome for every episode that began, whatever arrives in whatever order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import Embedding, State, embeddings, states

from rapl_core.streaming.assembler import AssemblerLimits, EpisodeAssembler, Outcome
from rapl_core.streaming.samples import DroppedEpisode, JoinedEpisode


def feed(assembler: EpisodeAssembler, items: list[State | Embedding]) -> list[Outcome]:
    outcomes: list[Outcome] = []
    for item in items:
        if isinstance(item, State):
            outcomes += assembler.add_state(item, 0.0)
        else:
            outcomes += assembler.add_embedding(item)
    return outcomes


def only_drop(outcomes: list[Outcome]) -> DroppedEpisode:
    assert len(outcomes) == 1 and isinstance(outcomes[0], DroppedEpisode)
    return outcomes[0]


def only_join(outcomes: list[Outcome]) -> JoinedEpisode:
    assert len(outcomes) == 1 and isinstance(outcomes[0], JoinedEpisode)
    return outcomes[0]


@given(order=st.permutations(list(range(8))), repeats=st.lists(st.integers(0, 7), max_size=6))
@settings(deadline=None, max_examples=80)
def test_any_order_and_any_repeats_join_to_the_same_episode(
    order: list[int], repeats: list[int]
) -> None:
    items = [*states("e", 3), *embeddings("e", 3)]
    joined = only_join(feed(EpisodeAssembler(), [items[i] for i in [*order, *repeats]]))
    np.testing.assert_array_equal(joined.embeddings, [[1, 1], [2, 1], [3, 1]])
    np.testing.assert_array_equal(joined.human_rewards, [-1.0, -2.0, -3.0])
    assert joined.last.step == 3
    assert (joined.encoder, joined.version) == ("rapl", "aaaa")


def test_the_first_frame_needs_no_embedding() -> None:
    only_join(feed(EpisodeAssembler(), [*states("e", 2), *embeddings("e", 2)[1:]]))


def test_of_two_embeddings_of_one_image_the_first_counts() -> None:
    twice = [replace(e, values=e.values + 7) for e in embeddings("e", 2)]
    items = [*states("e", 2)[:2], *embeddings("e", 2)[:2], *twice[:2], *states("e", 2)[2:]]
    joined = only_join(feed(EpisodeAssembler(), [*items, embeddings("e", 2)[2]]))
    np.testing.assert_array_equal(joined.embeddings, [[1, 1], [2, 1]])


def test_a_missing_embedding_drops_the_episode_after_its_deadline_and_names_the_step() -> None:
    assembler = EpisodeAssembler(limits=AssemblerLimits(embedding_deadline_s=3.0))
    items = [e for e in embeddings("e", 4) if e.image != ("e", 2)]
    assert feed(assembler, [*states("e", 4), *items]) == []
    assert assembler.expire(2.9) == []
    drop = only_drop(assembler.expire(3.1))
    assert drop.reason == "embedding missing at step 2 (1 of 4 missing)"
    assert assembler.expire(99.0) == []


def test_an_encoder_that_works_through_its_queue_is_waited_for_up_to_a_limit() -> None:
    limits = AssemblerLimits(embedding_deadline_s=3.0, embedding_limit_s=20.0)
    assembler = EpisodeAssembler(limits=limits)
    feed(assembler, states("e", 4))
    for now_s in range(2, 20, 2):
        assembler.add_embedding(embeddings(f"other-{now_s}", 1)[1], float(now_s))
        assert assembler.expire(now_s + 1.0) == []
    assembler.add_embedding(embeddings("other", 1)[1], 20.0)
    assert "no encoder at work" in only_drop(assembler.expire(20.1)).reason

    assembler = EpisodeAssembler(limits=limits)
    feed(assembler, states("e", 4))
    assembler.add_embedding(embeddings("e", 4)[1], 4.0)
    assert assembler.expire(6.9) == []
    assert "(3 of 4 missing)" in only_drop(assembler.expire(7.1)).reason


def test_no_embedding_at_all_says_that_no_encoder_is_at_work() -> None:
    assembler = EpisodeAssembler()
    feed(assembler, states("e", 4))
    assert "no encoder at work" in only_drop(assembler.expire(9.0)).reason


def test_a_missing_state_is_named() -> None:
    assembler = EpisodeAssembler()
    feed(assembler, [*states("e", 3)[1:], *embeddings("e", 3)])
    assert only_drop(assembler.expire(9.0)).reason == "state missing at step 0 (1 of 4 missing)"


def test_an_episode_that_stops_in_the_middle_is_dropped_when_states_cease() -> None:
    assembler = EpisodeAssembler(limits=AssemblerLimits(state_deadline_s=4.0))
    for second, state in enumerate(states("e", 9)[:3]):
        assembler.add_state(state, float(second))
    assert assembler.expire(5.9) == []
    drop = only_drop(assembler.expire(6.1))
    assert drop.reason == "stopped at step 2: no state for 4 s"
    assert drop.last.step == 2


def test_a_state_repeated_while_its_action_is_awaited_keeps_the_episode_open() -> None:
    assembler = EpisodeAssembler()
    state = states("e", 9)[0]
    for second in range(100):
        assert assembler.add_state(state, float(second)) == []
        assert assembler.expire(float(second)) == []
    assert assembler.open_episodes == ["e"]


def test_a_new_episode_of_the_same_world_ends_the_unfinished_one_and_only_that() -> None:
    assembler = EpisodeAssembler()
    feed(assembler, [*states("old", 5)[:3], *states("other", 5, world=1)[:3]])
    drop = only_drop(assembler.add_state(states("new", 5)[0], 1.0))
    assert drop.last.episode_id == "old"
    assert drop.reason == "stopped at step 2: new began"
    assert assembler.open_episodes == ["other", "new"]


def test_an_episode_that_ended_still_waits_for_its_embeddings_when_the_next_begins() -> None:
    assembler = EpisodeAssembler()
    assert feed(assembler, [*states("old", 2), *states("new", 2)[:1]]) == []
    assert only_join(feed(assembler, embeddings("old", 2))).last.episode_id == "old"


@pytest.mark.parametrize("late", [False, True])
def test_two_encoder_versions_in_one_episode_drop_it(late: bool) -> None:
    mixed = [*embeddings("e", 4, "aaaa")[:3], *embeddings("e", 4, "bbbb")[3:]]
    items = [*states("e", 4), *mixed] if late else [*mixed, *states("e", 4)]
    drop = only_drop(feed(EpisodeAssembler(), items))
    assert drop.reason.startswith("two encoder versions: aaaa at step")


def test_an_embedding_with_nan_drops_the_episode_at_once() -> None:
    bad = Embedding(("e", 1), np.array([np.nan, 1], np.float32))
    drop = only_drop(feed(EpisodeAssembler(), [*states("e", 3)[:2], bad]))
    assert drop.reason == "embedding of step 1 has NaN or infinite values"


def test_an_embedding_of_another_width_drops_the_episode() -> None:
    bad = Embedding(("e", 2), np.ones(3, np.float32))
    items = [*states("e", 3), embeddings("e", 3)[1], bad]
    assert "has 3 values" in only_drop(feed(EpisodeAssembler(), items)).reason


@pytest.mark.parametrize("before", [False, True])
def test_a_spoilt_image_drops_its_episode_before_or_after_its_state(before: bool) -> None:
    assembler = EpisodeAssembler()
    outcomes = assembler.spoil(("e", 2), "not finite") if before else []
    outcomes += feed(assembler, states("e", 3))
    outcomes += [] if before else assembler.spoil(("e", 2), "not finite")
    assert only_drop(outcomes).reason == "image of step 2: not finite"


def test_late_messages_do_not_begin_a_closed_episode_again() -> None:
    assembler = EpisodeAssembler()
    only_join(feed(assembler, [*states("e", 2), *embeddings("e", 2)]))
    assert feed(assembler, [*states("e", 2), *embeddings("e", 2)]) == []
    assert assembler.expire(99.0) == []
    assert assembler.late_states == 3


def test_embeddings_without_states_are_bounded_and_counted() -> None:
    assembler = EpisodeAssembler(limits=AssemblerLimits(spare_embeddings=10))
    feed(assembler, embeddings("unknown", 24))
    assert assembler.evicted_embeddings == 15


def test_without_embeddings_the_states_alone_make_the_episode() -> None:
    joined = only_join(feed(EpisodeAssembler(needs_embeddings=False), states("e", 3)))
    assert joined.embeddings is None
    np.testing.assert_array_equal(joined.human_rewards, [-1.0, -2.0, -3.0])


def test_an_unknown_truth_is_none() -> None:
    blind = [replace(s, human_reward=None) if s.step == 2 else s for s in states("e", 3)]
    joined = only_join(feed(EpisodeAssembler(needs_embeddings=False), list(blind)))
    assert joined.human_rewards is None


def test_an_episode_without_a_transition_is_dropped() -> None:
    drop = only_drop(feed(EpisodeAssembler(), [State("e", 0, is_last=True)]))
    assert drop.reason == "it has no transition"


@given(st.data())
@settings(deadline=None, max_examples=60)
def test_every_episode_that_began_has_exactly_one_outcome(data: st.DataObject) -> None:
    """Two worlds, several episodes each, messages lost at random."""
    items: list[State | Embedding] = []
    for number in range(4):
        for world in range(2):
            name = f"e{number}-{world}"
            stop = data.draw(st.integers(1, 4))
            items += states(name, 3, world)[:stop] + embeddings(name, 3)
    kept = [item for item in items if data.draw(st.integers(0, 9)) > 0]
    assembler = EpisodeAssembler()
    outcomes = feed(assembler, kept) + assembler.expire(1e6)
    began = {item.episode_id for item in kept if isinstance(item, State)}
    assert sorted(o.last.episode_id for o in outcomes) == sorted(began)
