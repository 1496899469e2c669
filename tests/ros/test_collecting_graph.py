"""Simulator, recorder and demonstrator together, each in its own process."""

import time

import numpy as np
import pytest
from collecting import ABORTED, CANCELED, SUCCEEDED, Graph
from rapl_msgs.msg import Action
from ros_harness import NodeProcess, Probe
from sensor_msgs.msg import Image

from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics

TASK = get_task("franka_group")


@pytest.fixture(scope="module")
def graph(tmp_path_factory, rclpy_context):
    """A graph for the tests that leave it as they found it."""
    folder = tmp_path_factory.mktemp("run")
    probe = Probe("client")
    running = []

    def start(module, **parameters):
        name = module.rpartition(".")[2]
        running.append(NodeProcess(module, folder / f"{name}.log", **parameters))
        return running[-1]

    made = Graph(probe, start, folder)
    yield made
    made.close()
    for node in reversed(running):
        node.stop()
    probe.close()


@pytest.fixture(autouse=True)
def forget(graph):
    """Messages of the test before."""
    for messages in graph.probe.received.values():
        messages.clear()
    graph.feedback.clear()


def test_what_is_recorded_is_what_was_published(graph):
    probe = graph.probe
    images = [
        probe.listen(Image, topics.world_topic(topics.CAMERA_IMAGE, w), qos.stream())
        for w in (0, 1)
    ]
    actions = probe.listen(Action, topics.ACTION, qos.stream())
    for seed in range(100, 110):  # until the publishers have found the probe
        status, result = graph.collect(episodes=2, seed=seed)
        assert status == SUCCEEDED, result.message
        if actions and all(images):
            break
    status, result = graph.collect(episodes=5, noise=0.1, seed=3, behaviours=["mime"])
    assert status == SUCCEEDED and result.success, result.message
    assert len(set(result.episode_ids)) == 5 and result.dropped == 0

    def told():
        return [info for info in graph.episodes if info.episode_id in result.episode_ids]

    probe.until(lambda: len(told()) == 5, 5.0, "an EpisodeInfo each")
    assert set(result.episode_ids) <= set(graph.store.ids())
    assert [feedback.done for feedback in graph.feedback[-5:]] == [1, 2, 3, 4, 5]
    for info in told():
        record = conversions.episode_record_from_ros(info)
        assert record.uri == f"episodes/{record.episode_id}" and record.behaviour == "mime"
        episode = graph.store.load(record.episode_id)
        assert (episode.steps, episode.task, episode.world) == (60, TASK.name, record.world)
        assert record.human_return == pytest.approx(episode.human_return)
        assert record.success == episode.success
        own = {s.step: s for s in graph.states if s.episode_id == record.episode_id}
        shown = {conversions.key_from_ros(image.header): image for image in images[record.world]}
        assert len(own) == episode.steps + 1
        for step, state in own.items():
            picture = conversions.image_from_ros(shown[conversions.key_from_ros(state.image)])
            np.testing.assert_array_equal(episode.frames[step], picture)
            np.testing.assert_array_equal(episode.states[step], state.values)
        sent = {a.step: a for a in actions if a.episode_id == record.episode_id}
        for step in range(episode.steps):
            np.testing.assert_array_equal(episode.actions[step], sent[step].values)
        track = graph.store.joints(record.episode_id)
        assert track is not None
        np.testing.assert_allclose(track.positions[:, :7], episode.states[:, :7])


def test_held_out_videos_have_starts_of_their_own(graph):
    starts = []
    for goal in ({}, {"purpose": "test"}, {"first_episode": 1}, {"seed": 9}):
        status, result = graph.collect(**({"episodes": 2, "seed": 3} | goal))
        assert status == SUCCEEDED, result.message
        starts += [tuple(graph.store.load(e).states[0][7:16]) for e in result.episode_ids]
    assert len(set(starts)) == 8
    purposes = {summary.purpose for summary in graph.store.summaries()}
    assert {"demonstrate", "test"} <= purposes


def test_a_goal_can_be_cancelled_and_the_next_one_is_taken(graph):
    probe = graph.probe
    handle = graph.send(episodes=1000)
    probe.until(lambda: graph.feedback, 40.0, "it is under way")
    second = graph.send(episodes=1)
    assert not second.accepted  # one at a time
    begin = time.monotonic()
    probe.wait(handle.cancel_goal_async(), 5.0, "the cancellation is taken")
    answer = probe.wait(handle.get_result_async(), 5.0, "the collection ends")
    assert answer.status == CANCELED and time.monotonic() - begin < 2.0
    assert 0 < len(answer.result.episode_ids) < 1000
    status, result = graph.collect(episodes=2, seed=8)
    assert status == SUCCEEDED, result.message


def test_an_unknown_behaviour_is_refused_with_the_known_ones(graph):
    status, result = graph.collect(episodes=2, behaviours=["juggle"])
    assert status == ABORTED and not result.success
    assert "unknown behaviour 'juggle'; known: " in result.message and "mime" in result.message
