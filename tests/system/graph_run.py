"""A whole run as a person starts it, and a probe that listens to its graph."""

import os
import re
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs import msg as wire_msg
from ros_harness import Probe
from sensor_msgs.msg import Image

from rapl_ros import conversions, qos, topics
from rapl_ros.wire import JoinKey

IMAGES_KEPT = 400
WORLDS = 2
TINY = [
    "franka_group",
    "--quick",
    "--episodes",
    "12",
    "--triplets",
    "12",
    "--steps",
    "720",
    "--worlds",
    str(WORLDS),
    "--online",
    "0",
]
RUN_DEADLINE_S = 400.0
"""Of one part of a run; tens of seconds where the tests have the machine to themselves."""
MISSED_WITHIN_S = 5.0
WATCHERS = {
    "simulator": "learner",
    "encoder": "ot_reward",
    "ot_reward": "learner",
    "recorder": "demonstrator",
    "preference": "simulated_human",
    "simulated_human": "conductor",
    "demonstrator": "conductor",
    "learner": "conductor",
}
"""A node that depends on another and must miss it."""


class GraphRun:
    """``./run_all.sh`` without its set-up.

    :param arguments: of the command line.
    :param log: gets what the terminal would show.
    """

    def __init__(self, arguments: list[str], log: Path) -> None:
        self.log = log
        with log.open("ab") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "rapl_ros.run_all", *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=log.parent,
            )

    def text(self) -> str:
        """What it has shown so far."""
        return self.log.read_text(errors="replace")

    def children(self) -> list[psutil.Process]:
        """Its processes, this very one left out."""
        return psutil.Process(self.process.pid).children(recursive=True)

    def pid_of(self, node: str) -> int:
        """Process id of a node."""
        for child in self.children():
            if f"rapl_ros.{node}_node" in child.cmdline():
                return child.pid
        raise AssertionError(f"{node} does not run")

    def until(self, condition: Callable[[], bool], deadline_s: float, what: str) -> None:
        """Wait for a condition that the run brings about."""
        end_s = time.monotonic() + deadline_s
        while not condition():
            assert self.process.poll() is None, f"the run has ended:\n{self.text()[-3000:]}"
            assert time.monotonic() < end_s, f"not within {deadline_s:.0f} s: {what}"
            time.sleep(0.02)

    def kill_node(self, node: str) -> int:
        """End a node as a crash would; returns its process id."""
        pid = self.pid_of(node)
        os.kill(pid, signal.SIGKILL)
        return pid

    def interrupt(self) -> tuple[float, list[psutil.Process]]:
        """Press Ctrl-C; returns the seconds until it ended and the processes that it left."""
        children = self.children()
        began_s = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        self.process.wait(timeout=20)
        took_s = time.monotonic() - began_s
        _, alive = psutil.wait_procs(children, timeout=0.5)
        return took_s, alive

    def close(self) -> None:
        """End it if it still runs."""
        if self.process.poll() is None:
            self.interrupt()


class GraphProbe(Probe):
    """Keeps what the parity tests compare: states, embeddings, rewards, some pictures."""

    def __init__(self, worlds: int) -> None:
        super().__init__("graph_probe")
        self.embeddings: dict[JoinKey, wire_msg.Embedding] = {}
        self.states: dict[str, dict[int, wire_msg.State]] = {}
        self.rewards: list[wire_msg.Reward] = []
        self.pictures: deque[Image] = deque(maxlen=IMAGES_KEPT)
        self.progress: list[wire_msg.Progress] = []
        self.complaints: list[tuple[str, str]] = []
        """Watcher and what it said on /diagnostics, of every condition; some stand very briefly."""
        self._hear(wire_msg.Embedding, topics.EMBEDDING, qos.stream(), self._on_embedding)
        self._hear(wire_msg.State, topics.STATE, qos.stream(), self._on_state)
        self._hear(wire_msg.Reward, topics.REWARD, qos.event(), self.rewards.append)
        self._hear(wire_msg.Progress, topics.PROGRESS, qos.event(), self.progress.append)
        self._hear(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics(), self._on_diagnostics)
        for world in range(worlds):
            topic = topics.world_topic(topics.CAMERA_IMAGE, world)
            self._hear(Image, topic, qos.stream(), lambda msg: self.pictures.append(msg))

    def _hear(self, kind: type, topic: str, profile: Any, callback: Callable[[Any], None]) -> None:
        self.node.create_subscription(kind, topic, callback, profile)

    def _on_embedding(self, msg: wire_msg.Embedding) -> None:
        self.embeddings[conversions.key_from_ros(msg.header)] = msg

    def _on_state(self, msg: wire_msg.State) -> None:
        self.states.setdefault(msg.episode_id, {})[msg.step] = msg

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            watcher = status.name.rpartition("/")[2]
            self.complaints += [(watcher, value.value) for value in status.values]

    def until_missed(self, node: str) -> float:
        """Wait until the watcher of a node that was just killed says so; returns the seconds."""
        killed_s, watcher = time.monotonic(), WATCHERS[node]
        self.complaints.clear()

        def is_missed() -> bool:
            said = [text for who, text in self.complaints if who == watcher]
            return any(f"{node} is gone" in text for text in said)

        self.until(is_missed, MISSED_WITHIN_S, f"{watcher} says that {node} is gone")
        return time.monotonic() - killed_s

    def stage(self) -> str:
        """Stage under way, with how it stands, e.g. ``train running``."""
        return f"{self.progress[-1].stage} {self.progress[-1].status}" if self.progress else ""

    def until_stage(self, stage: str, done: int, run: GraphRun, deadline_s: float) -> None:
        """Wait until a stage has done so much."""

        def reached() -> bool:
            if run.process.poll() is not None:
                raise AssertionError(f"the run has ended:\n{run.text()[-3000:]}")
            return any(p.stage == stage and p.done >= done for p in self.progress[-50:])

        self.until(reached, deadline_s, f"{stage} reaches {done}; it is at {self.stage()}")

    def until_ended(self, run: GraphRun, deadline_s: float) -> int:
        """Wait until the run has ended; returns its exit code."""
        self.until(
            lambda: run.process.poll() is not None, deadline_s, f"the run ends, {self.stage()}"
        )
        return int(run.process.returncode)

    def embedded(self, episode_id: str) -> list[wire_msg.Embedding] | None:
        """Embeddings of frames 1..T of an episode in order; None if the probe missed one."""
        states = self.states.get(episode_id, {})
        last = max(states, default=0)
        if not states or not states[last].is_last or len(states) != last + 1:
            return None
        keys = [conversions.key_from_ros(states[step].image) for step in range(1, last + 1)]
        found = [self.embeddings.get(key) for key in keys]
        return None if None in found else [msg for msg in found if msg is not None]


@dataclass(frozen=True)
class FinishedRun:
    """A run all of whose stages are done and whose graph still turns."""

    folder: Path
    probe: GraphProbe
    run: GraphRun
    first_text: str
    """What the terminal showed before Ctrl-C."""
    stop_s: float
    left: list[psutil.Process]
    stop_code: int
    seen_before: frozenset[str]
    """Episodes that began before Ctrl-C."""
    missed_s: float
    """From the kill of the simulator while it learnt until the learner said that it is gone."""


def stages_shown(text: str) -> list[str]:
    """Names of the stages that the terminal showed as done, in order."""
    return re.findall(r"^\d/\d (\w+) .*\bdone\b", text, flags=re.MULTILINE)
