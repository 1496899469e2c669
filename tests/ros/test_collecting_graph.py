"""Simulator, recorder and demonstrator together, each in its own process."""

import shutil
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.action import Collect
from rapl_msgs.msg import Action, EpisodeInfo, State
from rclpy.action import ActionClient
from ros_harness import DISCOVERY_S
from sensor_msgs.msg import Image

from rapl_core.episodes.store import EpisodeStore
from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics

TASK = get_task("franka_group")
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


class Graph:
    """The three nodes, and a client of ``collect``."""

    def __init__(self, probe, start, folder, worlds=2, **demonstrator):
        self.probe = probe
        self.folder = folder
        self.store = EpisodeStore(folder / "episodes")
        self.client = ActionClient(
            probe.node, Collect, topics.of_node(topics.COLLECT, topics.DEMONSTRATOR)
        )
        self.feedback = []
        probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
        self.episodes = probe.listen(EpisodeInfo, topics.EPISODE, qos.event())
        self.states = probe.listen(State, topics.STATE, qos.stream())
        self.simulator = start(
            "rapl_ros.simulator_node", worlds=worlds, clock_file=folder / "clock.json"
        )
        self.recorder = start("rapl_ros.recorder_node", run_folder=folder)
        self.demonstrator = start("rapl_ros.demonstrator_node", **demonstrator)

    def send(self, **goal):
        self.probe.until(self.client.server_is_ready, DISCOVERY_S, "the demonstrator appears")
        future = self.client.send_goal_async(
            Collect.Goal(**goal), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        return self.probe.wait(future, 10.0, "the goal is answered")

    def collect(self, deadline_s=60.0, **goal):
        handle = self.send(**goal)
        assert handle.accepted
        answer = self.probe.wait(handle.get_result_async(), deadline_s, "the collection ends")
        return answer.status, answer.result

    def close(self):
        self.client.destroy()


@pytest.fixture
def make_graph(probe, start, tmp_path):
    made = []

    def make(**parameters):
        made.append(Graph(probe, start, tmp_path, **parameters))
        return made[-1]

    yield make
    for graph in made:
        graph.close()


def test_what_is_recorded_is_what_was_published(probe, make_graph):
    images = [
        probe.listen(Image, topics.world_topic(topics.CAMERA_IMAGE, w), qos.stream())
        for w in (0, 1)
    ]
    actions = probe.listen(Action, topics.ACTION, qos.stream())
    graph = make_graph()
    status, result = graph.collect(episodes=5, noise=0.1, seed=3, behaviours=["mime"])
    assert status == SUCCEEDED and result.success, result.message
    assert len(set(result.episode_ids)) == 5 and result.dropped == 0
    probe.until(lambda: len(graph.episodes) == 5, 5.0, "an EpisodeInfo each")
    assert graph.store.ids() == sorted(result.episode_ids)
    assert [feedback.done for feedback in graph.feedback] == [1, 2, 3, 4, 5]
    compared = 0
    for info in graph.episodes:
        record = conversions.episode_record_from_ros(info)
        assert record.uri == f"episodes/{record.episode_id}" and record.behaviour == "mime"
        episode = graph.store.load(record.episode_id)
        assert (episode.steps, episode.task, episode.world) == (60, TASK.name, record.world)
        assert record.human_return == pytest.approx(episode.human_return)
        assert record.success == episode.success
        own = {s.step: s for s in graph.states if s.episode_id == record.episode_id}
        shown = {conversions.key_from_ros(image.header): image for image in images[record.world]}
        if len(own) <= episode.steps or any(
            conversions.key_from_ros(s.image) not in shown for s in own.values()
        ):
            continue  # the probe joined later than the recorder
        for step, state in own.items():
            picture = conversions.image_from_ros(shown[conversions.key_from_ros(state.image)])
            np.testing.assert_array_equal(episode.frames[step], picture)
            np.testing.assert_array_equal(episode.states[step], state.values)
        sent = {a.step: a for a in actions if a.episode_id == record.episode_id}
        for step in range(episode.steps):
            np.testing.assert_array_equal(episode.actions[step], sent[step].values)
        track = graph.store.joints(record.episode_id)
        if track is not None:
            np.testing.assert_allclose(track.positions[:, :7], episode.states[:, :7])
            compared += 1
    assert compared >= 3


def test_held_out_videos_have_starts_of_their_own(make_graph):
    graph = make_graph()
    starts = []
    for goal in ({}, {"purpose": "test"}, {"first_episode": 1}, {"seed": 9}):
        status, result = graph.collect(**({"episodes": 2, "seed": 3} | goal))
        assert status == SUCCEEDED, result.message
        starts += [tuple(graph.store.load(e).states[0][7:16]) for e in result.episode_ids]
    assert len(set(starts)) == 8
    purposes = {summary.purpose for summary in graph.store.summaries()}
    assert purposes == {"demonstrate", "test"}


def test_a_goal_can_be_cancelled_and_the_next_one_is_taken(probe, make_graph):
    graph = make_graph()
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


def test_an_unknown_behaviour_is_refused_with_the_known_ones(make_graph):
    status, result = make_graph().collect(episodes=2, behaviours=["juggle"])
    assert status == ABORTED and not result.success
    assert "unknown behaviour 'juggle'; known: " in result.message and "mime" in result.message


def test_a_killed_recorder_costs_time_and_no_episode(probe, make_graph):
    graph = make_graph(recording_deadline_s=6.0)
    handle = graph.send(episodes=12, seed=1)
    probe.until(lambda: len(graph.episodes) >= 3, 40.0, "some are recorded")
    graph.recorder.kill()
    probe.until(
        lambda: "recorder is gone" in probe.status_of("demonstrator").get("message", ""),
        5.0,
        "the demonstrator says what is missing",
    )
    ended = {s.episode_id for s in graph.states if s.is_last}
    probe.spin_for(4.0)
    more = {s.episode_id for s in graph.states if s.is_last} - ended
    assert len(more) <= 2 * 2 + 2  # back-pressure: two a world and those under way
    graph.recorder.restart()
    answer = probe.wait(handle.get_result_async(), 60.0, "the collection ends")
    assert answer.status == SUCCEEDED and len(set(answer.result.episode_ids)) == 12
    for episode_id in answer.result.episode_ids:
        assert graph.store.load(episode_id).steps == TASK.horizon
    left = [p.name for p in (graph.folder / "episodes").iterdir() if p.name.startswith(".")]
    assert len(left) <= 1  # at most what the kill interrupted, under a name nobody reads


def test_a_killed_simulator_is_asked_again_when_it_is_back(probe, make_graph):
    graph = make_graph(recording_deadline_s=6.0)
    handle = graph.send(episodes=10, seed=2)
    probe.until(lambda: len(graph.episodes) >= 3, 40.0, "some are recorded")
    graph.simulator.kill()
    probe.until(
        lambda: all(
            "simulator is gone" in probe.status_of(node).get("message", "")
            for node in ("demonstrator", "recorder")
        ),
        5.0,
        "the others say what is missing",
    )
    graph.simulator.restart()
    answer = probe.wait(handle.get_result_async(), 60.0, "the collection ends")
    assert answer.status == SUCCEEDED and len(set(answer.result.episode_ids)) == 10
    stamps = {s.episode_id: s.header.stamp.sec for s in graph.states if s.world == 0}
    assert sorted(stamps, key=stamps.get) == list(stamps)  # in the order of arrival


def test_without_a_recorder_a_collection_is_given_up_by_name(probe, make_graph):
    graph = make_graph(patience_s=4.0)
    graph.recorder.kill()
    status, result = graph.collect(episodes=2, deadline_s=40.0)
    assert status == ABORTED and "recorder is missing" in result.message


def test_a_folder_that_cannot_be_written_is_an_error_and_no_hang(probe, make_graph, tmp_path):
    (tmp_path / "episodes").write_text("a file where the folder should be")
    graph = make_graph(recording_deadline_s=2.0)
    handle = graph.send(episodes=2)
    probe.until(
        lambda: "cannot write episode" in probe.status_of("recorder").get("message", ""),
        40.0,
        "the recorder says so",
    )
    status = probe.status_of("recorder")
    assert status["level"] == "2" and str(tmp_path) in status["message"]
    probe.until(
        lambda: int(probe.status_of("recorder").get("lost_episodes", 0)) > 0, 5.0, "they count"
    )
    assert graph.recorder.process.poll() is None and not graph.episodes
    # Once repaired it goes on by itself.
    (tmp_path / "episodes").unlink()
    answer = probe.wait(handle.get_result_async(), 40.0, "the collection ends")
    assert answer.status == SUCCEEDED and answer.result.dropped > 0
    assert len(graph.store.ids()) >= 2
    probe.until(lambda: probe.status_of("recorder").get("level") == "0", 5.0, "it is well again")


def test_a_recorder_that_is_told_to_end_writes_what_is_complete(probe, make_graph):
    graph = make_graph()
    handle = graph.send(episodes=30)
    probe.until(lambda: len(graph.episodes) >= 2, 40.0, "it records")
    begin = time.monotonic()
    assert graph.recorder.signal(signal.SIGINT) == 0
    assert time.monotonic() - begin < 5.0
    assert "Traceback" not in graph.recorder.text()
    for episode_id in graph.store.ids():
        assert graph.store.load(episode_id).steps == TASK.horizon
    probe.wait(handle.cancel_goal_async(), 5.0, "the goal is cancelled")
    shutil.rmtree(graph.folder / "episodes")
