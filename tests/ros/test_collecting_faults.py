"""Collecting when something dies or cannot write."""

import shutil
import signal
import time
from collections.abc import Iterator

import pytest
from collecting import ABORTED, SUCCEEDED, Graph
from rapl_msgs.action import Collect
from rapl_msgs.msg import WorldInfo
from rapl_msgs.srv import Reset
from rclpy.action import ActionClient
from ros_harness import Probe, ros

from rapl_core.tasks import get_task
from rapl_ros import qos, topics
from rapl_ros.demonstrator_node import DemonstratorNode
from rapl_ros.liveness import Heartbeat

TASK = get_task("franka_group")


@pytest.fixture
def rclpy_context() -> Iterator[None]:
    """Tests that kill nodes have a domain each."""
    with ros(own_domain=True):
        yield


@pytest.fixture
def make_graph(probe, start, tmp_path):
    made = []

    def make(**parameters):
        made.append(Graph(probe, start, tmp_path, **parameters))
        return made[-1]

    yield make
    for graph in made:
        graph.close()


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


def test_a_simulator_whose_world_info_comes_before_its_heartbeat_is_asked_again(probe):
    """Two topics have no order: after a restart either may be first."""
    simulator, recorder = Probe(topics.SIMULATOR), Probe(topics.RECORDER)
    demonstrator = DemonstratorNode()
    resets = []

    def on_reset(request, response):
        resets.append(request)
        response.success = True
        response.episode_ids = [f"demonstrate-s0-w{w}-{len(resets):06d}-0" for w in request.worlds]
        return response

    simulator.node.create_service(Reset, topics.of_node("~/reset", topics.SIMULATOR), on_reset)
    infos = simulator.node.create_publisher(WorldInfo, topics.WORLD_INFO, qos.latched())
    infos.publish(WorldInfo(task=TASK.name, worlds=2))
    hearts = [Heartbeat(simulator.node), Heartbeat(recorder.node)]
    for node in (simulator.node, recorder.node, demonstrator):
        probe.executor.add_node(node)
    collect = topics.of_node(topics.COLLECT, topics.DEMONSTRATOR)
    client = ActionClient(probe.node, Collect, collect)
    try:
        for heart in hearts:
            heart.report("active")
        probe.until(client.server_is_ready, 20.0, "the demonstrator appears")
        client.send_goal_async(Collect.Goal(episodes=4))
        probe.until(lambda: resets, 20.0, "the worlds are reset")
        hearts[0].incarnation = "another"
        hearts[0].beat()
        probe.until(lambda: len(resets) > 1, 10.0, "they are reset again")
    finally:
        client.destroy()
        demonstrator.destroy_node()
        simulator.close()
        recorder.close()


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
