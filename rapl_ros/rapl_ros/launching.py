"""What ``ros2 launch rapl_bringup rapl.launch.py`` starts, from the one table of the nodes.

Knows nothing of the packages launch and launch_ros, which only a full ROS 2 has: the launch file
turns these into its actions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.tasks import task_names
from rapl_ros.domain import DISCOVERY_RANGE
from rapl_ros.node_table import (
    NODES,
    NodeEntry,
    ParameterValue,
    entries_of,
    parameters_of,
    resolved_parameters,
    run_parameters,
)
from rapl_ros.run_config import CONFIG_FILE, RunConfig, check_writable, load_config, save_config
from rapl_ros.run_lock import refuse_if_running
from rapl_ros.settings import checked, continued


@dataclass(frozen=True)
class LaunchArgument:
    """An argument of the launch file."""

    name: str
    default: str
    description: str


@dataclass(frozen=True)
class LaunchedNode:
    """A node as the launch file starts it."""

    executable: str
    name: str
    namespace: str
    parameters: dict[str, ParameterValue]
    parameter_files: tuple[str, ...]
    ends: bool


_DEFAULT = RunConfig(task="franka_group")

SETTINGS = {
    "task": "what to learn",
    "reward": "where the reward comes from: rapl, ground_truth, ...: ./run_all.sh --list",
    "encoder": "encoder that embeds the pictures; empty: the one that the reward implies",
    "backbone": "network that the encoder is made on; empty: the one that the reward names",
    "weights": "its weights, a file or a folder; empty: where they are usually",
    "engine": "what computes its features: torch or openvino",
    "trained": "what alignment trains: head or last_block",
    "demonstrations": "preferred demonstrations, for tcc and tcc_ot",
    "preset": "settings of the representation learning: tuned, paper or authors_code",
    "human": "who ranks: simulated, or people on the page (web)",
    "seed": "of everything random",
    "worlds": "worlds simulated side by side",
    "pool_episodes": "videos to collect and rank",
    "triplets": "rankings of three videos in all",
    "online": "alignments while the robot learns; empty: the preset's own",
    "online_triplets": "of the rankings, kept for each of them; empty: half of all, shared out",
    "steps": "world steps of learning",
    "evaluate_every": "world steps between two evaluations while learning",
    "final_episodes": "episodes of the evaluation after learning",
}
"""Arguments that are settings of a run, see :class:`rapl_ros.run_config.RunConfig`. Empty, as they
are by default, says nothing: a new run has the defaults then, a continued one what it had."""

ENVIRONMENT = {"ROS_AUTOMATIC_DISCOVERY_RANGE": DISCOVERY_RANGE}
"""Set for the nodes where the user has not: nothing is visible beyond this machine unasked."""

ARGUMENTS: tuple[LaunchArgument, ...] = (
    LaunchArgument("run_folder", "", "folder of the run; empty: runs/TASK/launched here. A folder "
                   "that holds a run is continued, with the settings that it was started with; "
                   "others than steps and human are refused then"),
    LaunchArgument("nodes", "all", "which nodes to start here, separated by commas, or all that "
                   "the run needs; known: "
                   + ", ".join(entry.name for entry in NODES)),
    LaunchArgument("params_file", "", "YAML file of further parameters, e.g. QoS overrides"),
    LaunchArgument("namespace", "rapl", "namespace of the nodes"),
    *(LaunchArgument(name, "", f"{text} ({getattr(_DEFAULT, name) or 'empty'})")
      for name, text in SETTINGS.items()),
)  # fmt: skip


def plan(given: Mapping[str, str]) -> list[LaunchedNode]:
    """Return the nodes to start; prepares the run folder, as run_all does.

    :param given: value of each of `ARGUMENTS`, as text.
    :raises RaplError: if a value is not acceptable or the folder is not writable.
    """
    asked = _asked(given)
    task = str(asked.get("task", _DEFAULT.task))
    folder = Path(given["run_folder"] or Path("runs") / task / "launched")
    chosen = _chosen(given["nodes"])
    if chosen is None or any(entry.ends for entry in chosen):
        refuse_if_running(folder)
    config = _run_config(asked, folder)
    entries = entries_of(config) if chosen is None else chosen
    values = run_parameters(config, folder)
    files = (given["params_file"],) if given["params_file"] else ()
    return [
        LaunchedNode(
            executable=executable_of(entry),
            name=entry.name,
            namespace=given["namespace"],
            parameters=parameters_of(entry, values),
            parameter_files=files,
            ends=entry.ends,
        )
        for entry in entries
    ]


def executable_of(entry: NodeEntry) -> str:
    """Return the name by which ``ros2 run rapl_ros`` knows a node."""
    return entry.module.rpartition(".")[2].removesuffix("_node")


def _chosen(names: str) -> list[NodeEntry] | None:
    """The nodes asked for by name; None: all that the run needs."""
    known = {entry.name: entry for entry in NODES}
    if names == "all":
        return None
    asked = [name.strip() for name in names.split(",") if name.strip()]
    for name in asked:
        if name not in known:
            raise UnknownNameError("node", name, known)
    return [known[name] for name in asked]


def _asked(given: Mapping[str, str]) -> dict[str, Any]:
    """The settings that were given, each as what it is."""
    defaults = {field.name: getattr(_DEFAULT, field.name) for field in fields(RunConfig)}
    # What has no default of its own is a number.
    types = {n: int if value is None else type(value) for n, value in defaults.items()}
    asked: dict[str, Any] = {}
    for name in SETTINGS:
        if not given[name]:
            continue
        try:
            asked[name] = types[name](given[name])
        except ValueError as error:
            kind = types[name].__name__
            raise RaplError(f"launch argument {name}:={given[name]} is no {kind}") from error
    return asked


def _run_config(asked: Mapping[str, Any], folder: Path) -> RunConfig:
    """The settings of the run in ``folder``, which is on disk then."""
    if (folder / CONFIG_FILE).exists():
        kept = load_config(folder)
        config = continued(kept, asked, folder)
        if config == kept:
            return config
    else:
        config = checked(replace(_DEFAULT, **asked), task_names())
    check_writable(folder)
    save_config(config, folder, resolved_parameters(config, folder, ENVIRONMENT))
    return config
