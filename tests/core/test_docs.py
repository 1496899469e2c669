"""What the documents say is so: files, options, names on the wire, parameters, results."""

import ast
import importlib
import importlib.util
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
INTERFACES = ROOT / "docs" / "interfaces.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
MADE_BY_A_RUN = ("runs/", "build/", ".venv/", "episodes/", "encoders/", "logs/", "policies/")

CONFIGS = {
    "simulator": [("rapl_ros.simulator_node", "SimulatorConfig", "")],
    "encoder": [
        ("rapl_ros.encoder_node", "EncoderChoice", ""),
        ("rapl_ros.encoder_node", "EncoderNodeConfig", ""),
    ],
    "ot_reward": [("rapl_core.streaming.reward_desk", "DeskConfig", "")],
    "recorder": [("rapl_ros.recorder_node", "RecorderConfig", "")],
    "preference": [("rapl_ros.preference_config", "PreferenceConfig", "")],
    "simulated_human": [("rapl_ros.simulated_human_node", "SimulatedHumanConfig", "")],
    "demonstrator": [("rapl_ros.demonstrator_node", "DemonstratorConfig", "")],
    "learner": [
        ("rapl_ros.learner_node", "LearnerConfig", ""),
        ("rapl_core.policies", "SacConfig", "sac."),
        ("rapl_core.policies", "ScheduleConfig", "schedule."),
    ],
    "web": [("rapl_ros.web_node", "WebConfig", "")],
    "conductor": [("rapl_ros.conductor_node", "ConductorConfig", "")],
}


def ros_module(name: str) -> ModuleType:
    """A module of rapl_ros; skips where ROS is not there or blocked."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        pytest.skip(f"needs ROS: {error}")


def section(text: str, title: str) -> str:
    """What stands under a heading of the second or third level, up to the next one."""
    match = re.search(rf"^(#+) {re.escape(title)}\n(.*?)(?=^##|\Z)", text, re.M | re.S)
    assert match, f"no heading '{title}'"
    return match[2]


def rows(text: str) -> list[list[str]]:
    """The cells of every row of the tables in ``text``, heads and rules left out."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", text, re.M):
        lines = block.strip().splitlines()[2:]
        found += [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return found


def quoted(text: str) -> set[str]:
    """Everything in backquotes."""
    return set(re.findall(r"`([^`\n]+)`", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    text = page.read_text()
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_named_files_exist(page: Path) -> None:
    for name in quoted(page.read_text()):
        is_file = re.fullmatch(r"(?:[\w.-]+/)+[\w-]+\.(?:py|sh|md|ya?ml|lock|png|in)", name)
        if is_file and not name.startswith(MADE_BY_A_RUN):
            places = (ROOT, page.parent, ROOT / "rapl_core" / "rapl_core", ROOT / "rapl_ros")
            assert any((place / name).exists() for place in places), f"{page.name} names {name}"


def test_the_readme_names_every_option_and_no_other() -> None:
    options = ros_module("rapl_ros.options")
    known = set(re.findall(r"--[a-z][a-z-]*", options.build_parser().format_help()))
    named = {word for cell, *_ in rows(section(README.read_text(), "Options")) for word in
             re.findall(r"--[a-z][a-z-]*", cell)}  # fmt: skip
    assert named == known - {"--help", "--list"}
    commands = " ".join(re.findall(r"run_all\.sh[^`\n]*", "".join(p.read_text() for p in PAGES)))
    assert set(re.findall(r"--[a-z][a-z-]*", commands)) <= known


def test_the_readme_gives_the_real_defaults() -> None:
    config = ros_module("rapl_ros.run_config").RunConfig("franka_group")
    text = section(README.read_text(), "Options")
    assert f"videos to collect ({config.pool_episodes})" in text
    assert f"rankings of three in all ({config.triplets})" in text
    assert f"of learning ({config.steps:,}), side by side ({config.worlds})" in text
    for words in (f"{config.pool_episodes} videos", f"{config.triplets} rankings"):
        assert words in section(README.read_text(), "Two commands")


def topic_constants() -> set[str]:
    """Every name in topics.py, read as text: this needs no ROS."""
    tree = ast.parse((ROOT / "rapl_ros" / "rapl_ros" / "topics.py").read_text())
    return {
        node.value.value
        for node in tree.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Constant)
    }


def node_names() -> set[str]:
    """The names in the node table, read as text."""
    tree = ast.parse((ROOT / "rapl_ros" / "rapl_ros" / "node_table.py").read_text())
    return {
        node.args[0].value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "NodeEntry"
        and isinstance(node.args[0], ast.Constant)
    }


def wire_names() -> set[str]:
    """Names that may stand in a document: topics as they are, services with their node."""
    constants = topic_constants()
    private = {name.removeprefix("~/") for name in constants if name.startswith("~/")}
    return constants | {f"{node}/{name}" for node in node_names() for name in private}


def test_the_table_of_nodes_is_that_of_the_code() -> None:
    table = rows(section(INTERFACES.read_text(), "Nodes"))
    assert {cells[0].strip("`") for cells in table} == node_names()
    for cells in table:
        sets_parameters = cells[0] in ("`conductor`", "`web`")
        allowed = wire_names() | (node_names() if sets_parameters else set())
        assert quoted(" ".join(cells[1:])) <= allowed, f"row of {cells[0]}"


@pytest.mark.parametrize("node", sorted(CONFIGS))
def test_the_table_of_nodes_says_what_each_node_makes(node: str) -> None:
    source = (ROOT / "rapl_ros" / "rapl_ros" / f"{node}_node.py").read_text()
    parts = {"learner": "rounds.py", "web": "web_graph.py"}  # which speak for the node
    if node in parts:
        source += (ROOT / "rapl_ros" / "rapl_ros" / parts[node]).read_text()
    tree = ast.parse((ROOT / "rapl_ros" / "rapl_ros" / "topics.py").read_text())
    values = {
        node.target.id: node.value.value
        for node in tree.body
        if isinstance(node, ast.AnnAssign)
        and isinstance(node.target, ast.Name)
        and isinstance(node.value, ast.Constant)
    }
    own = {topic for topic in topic_constants() if not topic.startswith("~") and topic != "rapl"}
    used = {values[name] for name in re.findall(r"topics\.([A-Z_]+)", source) if name in values}
    cells = next(c for c in rows(section(INTERFACES.read_text(), "Nodes")) if c[0] == f"`{node}`")
    said = quoted(" ".join(cells[1:3]))
    assert said == used & (own - node_names())


def test_topics_services_and_actions_are_all_there() -> None:
    text = INTERFACES.read_text()
    constants = topic_constants() - node_names() - {"rapl", "web"}
    topics = {cells[0].strip("`") for cells in rows(section(text, "Topics"))} - {
        "stream", "event", "latched", "<node>/heartbeat"
    }  # fmt: skip
    assert topics == {name for name in constants if not name.startswith("~")}
    served = {cells[0].strip("`") for cells in rows(section(text, "Services and actions"))}
    private = {name.removeprefix("~/") for name in constants if name.startswith("~/")}
    assert {name.rpartition("/")[2] for name in served} == private - {"heartbeat"}
    assert served <= wire_names()


def test_the_types_in_the_tables_exist() -> None:
    for package, name in re.findall(r"\b(rapl_msgs)/(\w+)", INTERFACES.read_text()):
        if name not in ("msg", "srv", "action"):
            folder = ROOT / "ros_ws" / "src" / package
            assert list(folder.glob(f"*/{name}.*")), f"{package}/{name}"


def test_the_picture_of_the_graph_has_the_names_of_the_code() -> None:
    graph = re.search(r"```mermaid\n(.*?)```", README.read_text(), re.S)
    assert graph
    edges = re.findall(r"^  (\w+) -[-.] (.+) \.?-+> (\w+)$", graph[1], re.M)
    assert len(edges) == len(graph[1].strip().splitlines()) - 1
    assert {name for left, _, right in edges for name in (left, right)} == node_names()
    assert {name for _, label, _ in edges for name in label.split(", ")} <= wire_names()


def _leaves(config: Any, prefix: str) -> dict[str, tuple[Any, str]]:
    """Value and range of every parameter."""
    found: dict[str, tuple[Any, str]] = {}
    for field in fields(config):
        value = getattr(config, field.name)
        name = f"{prefix}{field.name}"
        leaf = {name: (value, _range(field.metadata))}
        found |= _leaves(value, f"{name}.") if is_dataclass(value) else leaf
    return found


def _range(metadata: Mapping[str, Any]) -> str:
    low, high = metadata.get("minimum"), metadata.get("maximum")
    if low is None:
        return ""
    return f"from {low:g}" if high is None else f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value) or '""'


@pytest.mark.parametrize("node", sorted(CONFIGS))
def test_parameters_and_their_defaults_are_those_of_the_code(node: str) -> None:
    ros_module("rclpy")
    expected: dict[str, tuple[str, str]] = {}
    for module, name, prefix in CONFIGS[node]:
        config = getattr(ros_module(module), name)()
        expected |= {key: (_shown(v), span) for key, (v, span) in _leaves(config, prefix).items()}
    if "clock_file" in expected:
        expected["clock_file"] = ("~/.ros/rapl/simulator_clock.json", "")
    if node == "learner":
        for name in ros_module("rapl_ros.learner_node").GIVEN_OTHERWISE:
            del expected[f"schedule.{name}"]
    table = rows(section(INTERFACES.read_text(), f"`{node}`"))
    said = {
        cells[0].strip("`"): (cells[1].strip("`"), "" if "`" in cells[2] else cells[2])
        for cells in table
    }
    assert said == expected


def script(name: str) -> ModuleType:
    """A module of experiments/."""
    path = ROOT / "experiments" / name
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_of_results_is_what_the_results_files_say() -> None:
    summarise = script("franka_group/summarise.py")
    text = README.read_text()
    assert all(text.count(mark) == 1 for mark in summarise.MARKS)
    runs = summarise.load()
    if not runs:
        pytest.skip("there are no results files yet")
    written = text.split(summarise.MARKS[0])[1].split(summarise.MARKS[1])[0].strip()
    assert written == summarise.table(runs).strip()


def test_the_page_of_the_oracle_is_what_its_results_files_say() -> None:
    summarise = script("oracle/summarise.py")
    runs = summarise.load()
    assert (ROOT / "docs" / "results" / "oracle.md").read_text() == summarise.page(runs)


def test_the_oracle_stops_at_a_plateau_or_at_the_ceiling_and_never_on_the_ground() -> None:
    stops = script("oracle/learn.py").is_plateau
    assert not stops([0.0] * 30, 6)
    assert not stops([0.0, 0.5], 6), "too few to have a mean"
    rising = [0.1 * i for i in range(9)]
    assert not stops(rising, 3)
    assert not stops([*rising, 0.8, 0.8, 0.8], 3), "the mean has risen since"
    assert stops([*rising, 0.6, 0.6, 0.6, 0.6], 3)
    assert stops([0.0, 0.96, 0.98, 1.0], 6)
