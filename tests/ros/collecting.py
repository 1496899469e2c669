"""Simulator, recorder and demonstrator, each in its own process, and a client of ``collect``."""

from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.action import Collect
from rapl_msgs.msg import EpisodeInfo, State
from rclpy.action import ActionClient
from ros_harness import DISCOVERY_S

from rapl_core.episodes.store import EpisodeStore
from rapl_ros import qos, topics

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
