"""World steps per second of the running graph, and where the time goes.

python experiments/benchmark_graph.py [--reward none] [--worlds 4] [--seconds 20] [--out FILE]

``--reward none`` plays ping-pong: the simulator, and a controller that answers with random actions.
Any other reward starts simulator, encoder, ot_reward and learner and has the learner train;
``--reward rapl`` or ``imagenet`` needs ``--folder``, a run that has videos and rankings.

Each node tells on /diagnostics how many seconds it spent on what, by the wall and of a processor.
What its process used of a processor beyond that is its executor, the middleware and Python itself.
On a busy machine wall time counts the waiting for a processor too.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.action import Train
from rapl_msgs.msg import Action, State
from rapl_msgs.srv import Reset
from rclpy.action import ActionClient
from rclpy.node import Node

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.errors import RaplError
from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics
from rapl_ros.domain import graph_environment
from rapl_ros.node import RaplNode, run
from rapl_ros.node_table import process_specs
from rapl_ros.run_config import RunConfig
from rapl_ros.supervisor import ProcessSpec, Supervisor

START_S = 60.0
"""In which the graph must begin to step."""
WALL, PROCESSOR = "_s", "_processor_s"
"""Ends of the keys of /diagnostics that are seconds."""


@dataclass(frozen=True)
class NodeShare:
    """One node during the measurement."""

    node: str
    processor_s: float
    """User and system time of its process."""
    wall_by_purpose_s: dict[str, float]
    processor_by_purpose_s: dict[str, float]


class PingPong(RaplNode):
    """Answers every state with a random action, as ``learner``."""

    def __init__(self) -> None:
        super().__init__(topics.LEARNER)
        self._rng = np.random.default_rng(0)
        self._actions = self.publish_to(Action, topics.ACTION, qos.stream())
        self.subscribe_to(State, topics.STATE, self._on_state, qos.stream())

    def _on_state(self, msg: State) -> None:
        if msg.is_last:
            return
        with self.diagnostics.shares.of("ros"):
            instant = conversions.state_from_ros(msg)
            command = conversions.answer(instant, self._rng.uniform(-1, 1, 2), "random")
            self._actions.publish(conversions.action_to_ros(command))


class Gauge(Node):
    """Counts instants and reads what the nodes say of their time."""

    def __init__(self) -> None:
        super().__init__("benchmark", namespace=topics.NAMESPACE)
        self.instants = 0
        self.seconds: defaultdict[str, dict[str, float]] = defaultdict(dict)
        self.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.diagnostics()
        )

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            name = status.name.rpartition("/")[2]
            for pair in status.values:
                if pair.key.endswith(WALL):
                    self.seconds[name][pair.key] = float(pair.value)
                elif name == topics.SIMULATOR and pair.key == "instants":
                    self.instants = int(pair.value)

    def until(self, condition: Callable[[], bool], deadline_s: float, what: str) -> None:
        """Spin until ``condition`` holds.

        :raises RaplError: if it is too late.
        """
        end = time.monotonic() + deadline_s
        while not condition():
            if time.monotonic() > end:
                raise RaplError(f"not within {deadline_s:g} s: {what}")
            rclpy.spin_once(self, timeout_sec=0.1)

    def begin_ping_pong(self) -> None:
        """Have the simulator obey the ping-pong controller."""
        client = self.create_client(Reset, topics.of_node(topics.RESET, topics.SIMULATOR))
        self.until(client.service_is_ready, START_S, "the simulator appears")
        request = Reset.Request(purpose="train", controller=topics.LEARNER)
        future = client.call_async(request)
        self.until(future.done, START_S, "the simulator resets")

    def begin_training(self) -> None:
        """Have the learner train, without end."""
        client = ActionClient(self, Train, topics.of_node(topics.TRAIN, topics.LEARNER))
        self.until(client.server_is_ready, START_S, "the learner appears")
        future = client.send_goal_async(Train.Goal(steps=10_000_000))
        self.until(future.done, START_S, "the learner answers")
        if not future.result().accepted:
            raise RaplError("the learner does not accept the goal")


def processes(config: RunConfig, folder: Path, also: Sequence[str]) -> list[ProcessSpec]:
    """What is started: a part of the table of nodes, and the ping-pong controller."""
    wanted = {topics.SIMULATOR, *also}
    if config.reward != "none":
        wanted |= {topics.OT_REWARD, topics.LEARNER}
        if config.reward != "ground_truth":
            wanted.add(topics.ENCODER)
    specs = [spec for spec in process_specs(config, folder) if spec.name in wanted]
    if config.reward == "none":
        module = Path(__file__).stem
        environment = {"PYTHONPATH": str(Path(__file__).parent)}
        specs.append(ProcessSpec(topics.LEARNER, module, ("--controller",), environment))
    return specs


def measure(
    gauge: Gauge, supervisor: Supervisor, warm_s: float, seconds: float
) -> dict[str, object]:
    """Let the graph run for ``warm_s``, then measure it for ``seconds``."""
    gauge.until(lambda: gauge.instants > 0, START_S, "the worlds step")
    begin = time.monotonic()
    gauge.until(lambda: time.monotonic() - begin > warm_s, warm_s + 5, "warm")
    pids = supervisor.pids()

    def reading() -> tuple[float, int, dict[str, float], dict[str, dict[str, float]]]:
        used = {name: sum(psutil.Process(pid).cpu_times()[:2]) for name, pid in pids.items()}
        spent = {name: dict(values) for name, values in gauge.seconds.items()}
        return time.monotonic(), gauge.instants, used, spent

    # Diagnostics come once a second: both readings are taken just after one of the simulator's.
    gauge.until(_next_report(gauge), 10, "diagnostics")
    start_s, first, used, spent = reading()
    gauge.until(lambda: time.monotonic() - start_s > seconds, seconds + 5, "measured")
    gauge.until(_next_report(gauge), 10, "diagnostics")
    end_s, last, used_after, spent_after = reading()
    nodes = []
    for name in pids:
        wall, processor = {}, {}
        for key, total in spent_after.get(name, {}).items():
            passed = total - spent.get(name, {}).get(key, 0.0)
            if key.endswith(PROCESSOR):
                processor[key.removesuffix(PROCESSOR)] = passed
            else:
                wall[key.removesuffix(WALL)] = passed
        nodes.append(NodeShare(name, used_after[name] - used[name], wall, processor))
    return {
        "wall_s": end_s - start_s,
        "world_steps": last - first,
        "world_steps_per_s": (last - first) / (end_s - start_s),
        "nodes": [asdict(node) for node in nodes],
    }


def _next_report(gauge: Gauge) -> Callable[[], bool]:
    before = gauge.instants
    return lambda: gauge.instants != before


def table(result: dict[str, object]) -> str:
    """The result for people: milliseconds a world step, and shares of the wall time."""
    wall_s, steps = float(result["wall_s"]), int(result["world_steps"])  # type: ignore[call-overload]

    def row(node: str, purpose: str, wall: float | None, processor: float) -> str:
        cells = [f"{node:11}{purpose:28}"]
        for seconds in (wall, processor):
            if seconds is None:
                cells.append(" " * 18)
            else:
                cells.append(f"{1000 * seconds / max(1, steps):10.2f}{seconds / wall_s:8.1%}")
        return "".join(cells)

    lines = [
        f"{result['world_steps_per_s']:.1f} world steps/s over {wall_s:.1f} s",
        f"{'node':11}{'purpose':28}{'wall ms':>10}{'share':>8}{'CPU ms':>10}{'share':>8}",
    ]
    for node in result["nodes"]:  # type: ignore[attr-defined]
        name, processor = node["node"], node["processor_by_purpose_s"]
        for purpose, seconds in sorted(node["wall_by_purpose_s"].items()):
            lines.append(row(name, purpose, seconds, processor[purpose]))
        rest = node["processor_s"] - sum(processor.values())
        lines.append(row(name, "executor, middleware, rest", None, max(0.0, rest)))
        lines.append(row(name, "= process", None, node["processor_s"]))
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--task", default="franka_group")
    parser.add_argument("--reward", default="none", help="none: ping-pong; ground_truth, rapl, ...")
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--also", nargs="*", default=[], help="further nodes, e.g. recorder")
    parser.add_argument("--folder", type=Path, help="a run with videos and rankings")
    parser.add_argument("--warm", type=float, default=5.0, help="seconds before the measurement")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--out", type=Path, help="JSON file of results")
    options = parser.parse_args(arguments)
    get_task(options.task)
    config = RunConfig(task=options.task, reward=options.reward, worlds=options.worlds, online=0)
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        environment = graph_environment(Path(scratch))
        os.environ.update(environment)
        supervisor = Supervisor(
            processes(config, folder, options.also), Path(scratch) / "logs", environment, print
        )
        supervisor.start()
        rclpy.init()
        gauge = Gauge()
        try:
            if options.reward == "none":
                gauge.begin_ping_pong()
            else:
                gauge.begin_training()
            result = measure(gauge, supervisor, options.warm, options.seconds)
        finally:
            gauge.destroy_node()
            rclpy.try_shutdown()
            supervisor.stop()
    print(table(result))
    if options.out:
        provenance = {"commit": commit(), "machine": machine(), "versions": versions()}
        options.out.write_text(
            json.dumps({"run": asdict(config), **result, **provenance}, indent=1) + "\n"
        )


if __name__ == "__main__":
    if "--controller" in sys.argv:
        sys.argv.remove("--controller")
        sys.exit(run(PingPong))
    main()
