"""Images, states, actions and joints come together in any order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rapl_core.errors import ShapeError
from rapl_ros.episode_builder import (
    BuilderLimits,
    EpisodeBuilder,
    Joints,
    LostEpisode,
    Recording,
)
from rapl_ros.wire import Instant, JoinKey, answer

STEPS = 4


def instants(name="e-0", world=0, purpose="demonstrate", first_ns=1000, steps=STEPS):
    return [
        Instant(
            key=JoinKey(f"env_{world}/world", first_ns + step),
            image=JoinKey(f"env_{world}/camera", first_ns + step),
            world=world,
            episode_id=name,
            purpose=purpose,
            controller="demonstrator",
            step=step,
            is_last=step == steps,
            terminated=False,
            values=np.full(3, step, dtype=float),
            human_reward=-float(step),
            success=step == steps,
        )
        for step in range(steps + 1)
    ]


def picture(step):
    return np.full((2, 2, 3), step, np.uint8)


def messages(episode):
    """Everything that an episode sends, as (kind, payload)."""
    sent = []
    for instant in episode:
        sent.append(("image", (instant.image, picture(instant.step))))
        joints = Joints(("a",), np.array([instant.step * 1.0]), np.array([0.0]))
        sent.append(("joints", (instant.key, joints)))
        sent.append(("state", instant))
        if not instant.is_last:
            sent.append(("action", answer(instant, [0.1 * instant.step, 2.0], "mime")))
    return sent


def feed(builder, sent, now_s=0.0):
    outcomes = []
    for kind, payload in sent:
        if kind == "image":
            outcomes += builder.add_image(*payload, now_s)
        elif kind == "joints":
            outcomes += builder.add_joints(*payload)
        elif kind == "state":
            outcomes += builder.add_state(payload, now_s)
        else:
            outcomes += builder.add_action(payload)
    return outcomes


@pytest.fixture
def builder():
    return EpisodeBuilder(["demonstrate"])


def test_a_complete_episode_has_everything_in_its_place(builder):
    (recording,) = feed(builder, messages(instants()))
    assert isinstance(recording, Recording)
    episode = recording.episode("franka_group")
    assert (episode.episode_id, episode.task, episode.steps) == ("e-0", "franka_group", STEPS)
    assert episode.frames[:, 0, 0, 0].tolist() == [0, 1, 2, 3, 4]
    assert episode.states[:, 0].tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(episode.actions[:, 0], [0.0, 0.1, 0.2, 0.3])
    assert episode.actions[:, 1].max() == 1.0  # as the simulator clips them
    assert episode.human_return == -10.0 and episode.success is True
    assert episode.behaviour == "mime"
    track = recording.joint_track()
    assert track is not None and track.positions[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert builder.open_episodes == []


@settings(max_examples=60, deadline=None)
@given(st.randoms(use_true_random=False), st.integers(0, 5))
def test_images_may_come_in_any_order_and_anything_may_come_twice(shuffler, repeats):
    """Topics keep their own order and are delayed against each other; states are repeated."""
    builder = EpisodeBuilder(["demonstrate"])
    by_kind = {kind: [] for kind in ("image", "joints", "state", "action")}
    for kind, payload in messages(instants()):
        by_kind[kind].append((kind, payload))
    by_kind["image"] += by_kind["image"][:repeats]
    by_kind["state"] = [s for s in by_kind["state"] for _ in range(1 + (s[1].step == repeats))]
    shuffler.shuffle(by_kind["image"])
    pending = {kind: list(sent) for kind, sent in by_kind.items() if kind != "action"}
    sent, acted = [], set()
    while any(pending.values()):
        kind = shuffler.choice([kind for kind, left in pending.items() if left])
        message = pending[kind].pop(0)
        sent.append(message)
        if kind == "state" and not message[1].is_last and message[1].step not in acted:
            acted.add(message[1].step)
            sent.append(("action", answer(message[1], [0.0, 0.0])))
    outcomes = feed(builder, sent)
    assert len(outcomes) == 1
    episode = outcomes[0].episode("t")
    assert episode.frames[:, 0, 0, 0].tolist() == [0, 1, 2, 3, 4]


def test_an_episode_whose_image_is_missing_is_lost_by_step_after_its_deadline(builder):
    sent = [m for m in messages(instants()) if m[0] != "image" or m[1][0].stamp_ns != 1002]
    assert feed(builder, sent, now_s=10.0) == []
    assert builder.expire(14.9) == []
    (lost,) = builder.expire(15.1)
    assert isinstance(lost, LostEpisode)
    assert lost.reason == "image missing at step 2 (1 of 5 missing)"
    assert builder.expire(99.0) == []


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("action", "action missing at step 0 (4 of 4"), ("image", "image missing at step 0 (5 of 5")],
)
def test_what_is_missing_is_named(builder, kind, reason):
    feed(builder, [m for m in messages(instants()) if m[0] != kind])
    (lost,) = builder.expire(100.0)
    assert reason in lost.reason


def test_a_recorder_that_began_in_the_middle_loses_the_episode(builder):
    feed(builder, messages(instants())[7:])
    (lost,) = builder.expire(100.0)
    assert lost.reason.startswith("state missing at step 0")


def test_a_late_image_completes_the_episode_within_the_deadline(builder):
    sent = messages(instants())
    late = sent.pop(0)
    assert feed(builder, sent) == []
    (recording,) = feed(builder, [late])
    assert recording.missing() == ""


def test_a_new_episode_in_the_same_world_ends_the_unfinished_one(builder):
    feed(builder, messages(instants("e-0"))[:8])
    feed(builder, messages(instants("e-1", world=1, first_ns=2000))[:4])
    (lost,) = feed(builder, messages(instants("e-2", first_ns=3000))[:4])
    assert lost.latest.episode_id == "e-0" and lost.reason == "stopped at step 1: e-2 began"
    assert builder.open_episodes == ["e-1", "e-2"]


def test_an_episode_without_states_for_long_is_given_up(builder):
    feed(builder, messages(instants())[:8], now_s=5.0)
    assert builder.expire(34.0) == []
    (lost,) = builder.expire(35.5)
    assert lost.reason == "stopped at step 1"


def test_other_purposes_are_passed_over_without_keeping_their_images(builder):
    assert feed(builder, messages(instants(purpose="train"))) == []
    sent = messages(instants("e-9", purpose="train", first_ns=9000))
    assert feed(builder, sorted(sent, key=lambda m: m[0] == "image")) == []  # images come last
    assert builder.open_episodes == [] and not builder._spare and not builder._spare_joints
    assert builder.expire(1000.0) == []


def test_memory_is_bounded_when_states_never_come():
    builder = EpisodeBuilder(["demonstrate"], BuilderLimits(spare_images=10))
    for stamp in range(100):
        builder.add_image(JoinKey("camera", stamp), picture(0), 0.0)
        builder.add_joints(JoinKey("world", stamp), Joints((), np.zeros(0), np.zeros(0)))
    assert len(builder._spare) == 10 and len(builder._spare_joints) == 10


def test_a_camera_that_runs_free_takes_no_more_memory_than_allowed():
    builder = EpisodeBuilder(["demonstrate"], BuilderLimits(spare_megabytes=5))
    picture_of_a_megabyte = np.zeros((500, 2000), np.uint8)
    for stamp in range(100):
        builder.add_image(JoinKey("camera", stamp), picture_of_a_megabyte, 0.0)
    assert len(builder._spare) == 5
    assert builder._spare.pop(JoinKey("camera", 94)) is None
    assert builder._spare.pop(JoinKey("camera", 95)) is not None
    builder.add_image(JoinKey("camera", 99), picture_of_a_megabyte, 0.0)  # again
    assert len(builder._spare) == 4
    builder.add_image(JoinKey("camera", 100), picture_of_a_megabyte, 9.0)
    assert len(builder._spare) == 5
    builder.add_image(JoinKey("camera", 101), picture_of_a_megabyte, 12.0)
    assert len(builder._spare) == 2
    builder.expire(20.0)
    assert len(builder._spare) == 1


def test_without_joints_the_episode_is_complete(builder):
    (recording,) = feed(builder, [m for m in messages(instants()) if m[0] != "joints"])
    assert recording.joint_track() is None


def test_joints_that_come_after_their_states_are_kept(builder):
    sent = messages(instants())
    sent = [m for m in sent if m[0] != "joints"] + [m for m in sent if m[0] == "joints"]
    # Nothing says that joints exist until the first has come: here one comes in time.
    sent.insert(1, sent.pop(-len(instants())))
    (recording,) = feed(builder, sent)
    track = recording.joint_track()
    assert track is not None and track.positions[:, 0].tolist() == [0, 1, 2, 3, 4]


def test_joints_that_stop_coming_cost_no_episode(builder):
    sent = messages(instants())
    assert feed(builder, [m for m in sent if m[0] != "joints" or m[1][0].stamp_ns < 1004]) == []
    (recording,) = builder.expire(6.0)
    assert isinstance(recording, Recording) and recording.joint_track() is None


def test_another_controllers_action_does_not_count(builder):
    sent = messages(instants())
    index = next(i for i, (kind, _) in enumerate(sent) if kind == "action")
    wrong = answer(sent[index - 1][1], [-1.0, -1.0])
    object.__setattr__(wrong, "controller", "intruder")
    sent.insert(index, ("action", wrong))
    (recording,) = feed(builder, sent)
    assert recording.episode("t").actions[0].tolist() == [0.0, 1.0]


def test_images_of_two_sizes_are_refused_by_name(builder):
    sent = messages(instants())
    sent[0] = ("image", (sent[0][1][0], np.zeros((3, 2, 3), np.uint8)))
    (recording,) = feed(builder, sent)
    with pytest.raises(ShapeError, match="images of episode e-0 are not of one shape"):
        recording.episode("t")


def test_an_episode_without_a_transition_is_refused(builder):
    (recording,) = feed(builder, messages(instants(steps=0)))
    with pytest.raises(ShapeError, match="no transition"):
        recording.episode("t")


def test_without_truth_the_episode_says_so(builder):
    sent = messages(instants())
    for kind, payload in sent:
        if kind == "state":
            object.__setattr__(payload, "human_reward", None)
            object.__setattr__(payload, "success", None)
    (recording,) = feed(builder, sent)
    episode = recording.episode("t")
    assert episode.human_rewards is None and episode.success is None


def test_the_first_action_may_come_before_the_state_that_it_answers(builder):
    sent = messages(instants())
    index = next(i for i, (kind, _) in enumerate(sent) if kind == "action")
    sent[index - 1], sent[index] = sent[index], sent[index - 1]
    (recording,) = feed(builder, sent)
    assert recording.episode("t").actions.shape == (STEPS, 2)
