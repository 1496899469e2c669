"""The one table of the nodes: run_all's supervisor and the launch files both read it."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from rapl_core.analysis import provenance
from rapl_core.preferences.simulated_human import HumanKnobs, knobs_from
from rapl_core.preferences.strategies import LEARNING
from rapl_core.tasks import get_task
from rapl_ros.run_config import RunConfig
from rapl_ros.supervisor import ProcessSpec

ParameterValue = bool | int | float | str | list[str]


@dataclass(frozen=True)
class NodeEntry:
    """One node of the graph; each has a process of its own."""

    name: str
    module: str
    """Run as ``python -m``."""
    parameters: tuple[str, ...] = ()
    """Which of the run's parameters it takes, see :func:`run_parameters`."""
    imports_torch: bool = False
    """Takes 300 to 600 MiB rather than 65."""
    ends: bool = False
    """Exits when its work is done."""
    stops_last: bool = False
    """Keeps what the others made."""
    is_needed: Callable[[RunConfig], bool] = lambda config: True
    """Whether a run starts it unasked."""


KNOBS = tuple(knob.name for knob in fields(HumanKnobs))

STRATEGY_PACE_S = 0.3
"""Between two answers of simulated people where a strategy learns from them."""

NODES: tuple[NodeEntry, ...] = (
    NodeEntry("simulator", "rapl_ros.simulator_node", ("task", "worlds", "clock_file")),
    NodeEntry(
        "encoder",
        "rapl_ros.encoder_node",
        ("run_folder", "weights", "engine"),
        imports_torch=True,
    ),
    NodeEntry("ot_reward", "rapl_ros.ot_reward_node", ("source", "human_reward_scale")),
    NodeEntry("recorder", "rapl_ros.recorder_node", ("run_folder", "purposes"), stops_last=True),
    NodeEntry(
        "preference",
        "rapl_ros.preference_node",
        (
            "run_folder",
            "seed",
            "rankings_wanted",
            "repeat_share",
            "shared_share",
            "backbone",
            "weights",
            "engine",
            "trained",
            "tcc_iterations",
            "masked_iterations",
            "strategy",
            "preset",
            "noise",
            "groups",
        ),  # fmt: skip
        imports_torch=True,
    ),
    NodeEntry(
        "simulated_human",
        "rapl_ros.simulated_human_node",
        ("run_folder", "seed", "people", "pace_s", *KNOBS),
        is_needed=lambda config: not config.asks_people,
    ),
    NodeEntry("demonstrator", "rapl_ros.demonstrator_node"),
    NodeEntry(
        "learner",
        "rapl_ros.learner_node",
        (
            "run_folder",
            "seed",
            "reward_deadline_s",
            "after_swap",
            "schedule.random_steps",
            "schedule.checkpoint_every",
            "schedule.evaluate_every",
            "schedule.evaluate_episodes",
        ),
        imports_torch=True,
    ),
    NodeEntry(
        "web",
        "rapl_ros.web_node",
        ("run_folder", "host", "question"),
        is_needed=lambda config: config.asks_people,
    ),
    NodeEntry("conductor", "rapl_ros.conductor_node", ("run_folder",), ends=True),
)


RECORDED = ["demonstrate", "test", "evaluate"]
"""Purposes of the episodes that are recorded; the learner's own only where they are asked about."""


def entries_of(config: RunConfig, web: bool = False) -> list[NodeEntry]:
    """Return the nodes of a run.

    :param web: whether the page is wanted in any case.
    """
    return [entry for entry in NODES if entry.is_needed(config) or (web and entry.name == "web")]


def run_parameters(
    config: RunConfig, folder: Path, web_host: str = ""
) -> dict[str, ParameterValue]:
    """Return what a run says to its nodes; each takes what its entry names.

    :param web_host: address on which the page listens; empty: this machine's own.
    """
    return {
        "task": config.task,
        "worlds": config.worlds,
        "seed": config.seed,
        "human_reward_scale": get_task(config.task).human_reward_scale,
        "run_folder": str(folder.resolve()),
        "host": web_host or "127.0.0.1",
        "question": get_task(config.task).title,
        "clock_file": str((folder / "clock_ns").resolve()),
        "rankings_wanted": config.pool_triplets,
        # People tire and differ: now and then the same again, and what another person has ranked.
        "repeat_share": 0.08 if config.asks_people else 0.0,
        "shared_share": 0.08 if config.asks_people else 0.0,
        "backbone": config.backbone,
        # Unless given it is left to the node: an encoder that restarts takes up its own again.
        **({"weights": str(Path(config.weights).resolve())} if config.weights else {}),
        "engine": config.engine,
        "trained": config.trained,
        "tcc_iterations": config.tcc_iterations,
        "masked_iterations": config.masked_iterations,
        "strategy": config.query_strategy,
        "preset": config.preset,
        "noise": config.noise,
        "groups": config.groups,
        "people": config.people,
        "pace_s": STRATEGY_PACE_S if config.query_strategy in LEARNING else 0.0,
        **_knobs(config.knobs),
        "source": "human_reward" if config.reward == "ground_truth" else "embedding",
        # Longer than ot_reward waits for an encoder that has fallen behind.
        "reward_deadline_s": 60.0,
        "purposes": [*RECORDED, "train"] if config.online_alignments else RECORDED,
        "after_swap": "relabel" if config.online_alignments else "empty",
        "schedule.random_steps": config.random_steps,
        "schedule.checkpoint_every": config.checkpoint_every,
        "schedule.evaluate_every": config.evaluate_every,
        "schedule.evaluate_episodes": config.evaluate_episodes,
    }


def parameters_of(
    entry: NodeEntry, values: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the parameters of one node."""
    return {name: values[name] for name in entry.parameters if name in values}


def _knobs(text: str) -> dict[str, ParameterValue]:
    """The knobs that are not at their default."""
    asked, default = asdict(knobs_from(text)), asdict(HumanKnobs())
    return {name: value for name, value in asked.items() if value != default[name]}


def process_specs(config: RunConfig, folder: Path, web_host: str = "") -> list[ProcessSpec]:
    """Return the processes of a run.

    :param web_host: address on which the page listens; empty: no page unless people rank.
    """
    values = run_parameters(config, folder, web_host)
    return [
        ProcessSpec(
            entry.name,
            entry.module,
            ros_arguments(parameters_of(entry, values)),
            ends=entry.ends,
            stops_last=entry.stops_last,
        )
        for entry in entries_of(config, bool(web_host))
    ]


def ros_arguments(parameters: Mapping[str, ParameterValue]) -> tuple[str, ...]:
    """Return the command line that sets parameters of a node."""
    words = ["--ros-args"]
    for name, value in parameters.items():
        # YAML, as ROS reads it: a task called ``true`` stays a string.
        quoted = '"' if isinstance(value, str) else None
        flow = True if isinstance(value, list) else None
        text = yaml.safe_dump(value, default_style=quoted, default_flow_style=flow)
        words += ["-p", f"{name}:={text.removesuffix(chr(10)).removesuffix('...').strip()}"]
    return tuple(words)


def resolved_parameters(
    config: RunConfig, folder: Path, environment: Mapping[str, str], web_host: str = ""
) -> dict[str, Any]:
    """Return what config.yaml tells its reader beside the settings of the run."""
    values = run_parameters(config, folder, web_host)
    nodes = entries_of(config, bool(web_host))
    return {
        "nodes": {entry.name: parameters_of(entry, values) for entry in nodes},
        "environment": dict(environment),
        "versions": provenance.versions(),
        "commit": provenance.commit(),
        "machine": provenance.machine(),
    }
