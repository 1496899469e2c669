"""The launch files follow from the table of the nodes. ros2 launch itself is not installable here,
so they are compiled and their parts tested, not launched."""

import ast
import runpy
import sys
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from types import ModuleType

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import Image

from rapl_core.errors import RaplError
from rapl_ros import qos, topics
from rapl_ros.encoder_node import EncoderNodeConfig
from rapl_ros.launching import ARGUMENTS, executable_of, plan
from rapl_ros.node_table import KNOBS, NODES, parameters_of, process_specs, run_parameters
from rapl_ros.recorder_node import RecorderConfig
from rapl_ros.run_config import RunConfig, load_config

BRINGUP = Path(__file__).parents[2] / "ros_ws" / "src" / "rapl_bringup"


def given(folder: Path, **changes: str) -> dict[str, str]:
    return {argument.name: argument.default for argument in ARGUMENTS} | {
        "run_folder": str(folder),
        **changes,
    }


def test_every_node_that_a_run_needs_is_launched_with_its_parameters(tmp_path: Path) -> None:
    nodes = plan(given(tmp_path, worlds="2", seed="7"))
    entries = [entry for entry in NODES if entry.name != "web"]
    assert [node.name for node in nodes] == [entry.name for entry in entries]
    # Of the simulated human, and weights that were not given: the nodes' own defaults hold.
    unset = {*KNOBS, "weights"}
    assert [set(node.parameters) for node in nodes] == [set(e.parameters) - unset for e in entries]
    assert {node.name: node.parameters for node in nodes}["simulator"]["worlds"] == 2
    assert [node.name for node in nodes if node.ends] == ["conductor"]
    assert load_config(tmp_path).seed == 7


def test_simulated_people_and_how_they_err_reach_their_node(tmp_path: Path) -> None:
    config = RunConfig("franka_group", people="ann:task,ben:opposite", knobs="beta=2,skip=0.1")
    values = run_parameters(config, tmp_path)
    (human,) = (entry for entry in NODES if entry.name == "simulated_human")
    given_to_it = parameters_of(human, values)
    assert given_to_it["people"] == "ann:task,ben:opposite"
    assert (given_to_it["beta"], given_to_it["skip"]) == (2.0, 0.1)
    assert not {"myopia", "mistakes"} & set(given_to_it)


def test_the_learners_videos_are_recorded_where_it_is_aligned_again_meanwhile(
    tmp_path: Path,
) -> None:
    def of(config: RunConfig) -> dict[str, list[str]]:
        specs = process_specs(config, tmp_path)
        return {spec.name: list(spec.arguments) for spec in specs}

    online, offline = (of(RunConfig("franka_group", online=n)) for n in (2, 0))
    assert "purposes:=[demonstrate, test, evaluate, train]" in online["recorder"]
    assert "purposes:=[demonstrate, test, evaluate]" in offline["recorder"]
    assert 'after_swap:="relabel"' in online["learner"]
    assert 'after_swap:="empty"' in offline["learner"]


def test_with_people_there_is_the_page_and_no_simulated_human(tmp_path: Path) -> None:
    names = {node.name for node in plan(given(tmp_path, human="web"))}
    assert "web" in names and "simulated_human" not in names


def test_a_folder_that_holds_a_run_is_continued_with_its_settings(tmp_path: Path) -> None:
    plan(given(tmp_path, worlds="2", reward="imagenet"))
    for same in ({}, {"worlds": "2", "reward": "imagenet", "task": "franka_group"}):
        nodes = plan(given(tmp_path, **same))
        assert {node.name: node.parameters for node in nodes}["simulator"]["worlds"] == 2
    with pytest.raises(RaplError, match="was started with worlds 2, not 4; .*steps and human"):
        plan(given(tmp_path, worlds="4"))
    with pytest.raises(RaplError, match="was started with reward 'imagenet', not 'rapl'"):
        plan(given(tmp_path, reward="rapl"))
    plan(given(tmp_path, steps="70000"))
    assert load_config(tmp_path) == RunConfig(
        "franka_group", worlds=2, reward="imagenet", steps=70_000, online=0, online_triplets=0
    )


def test_a_short_run_has_gradient_steps_too(tmp_path: Path) -> None:
    nodes = {node.name: node.parameters for node in plan(given(tmp_path, steps="2000"))}
    assert nodes["learner"]["schedule.random_steps"] == 500


def test_a_part_of_the_nodes_can_be_launched(tmp_path: Path) -> None:
    nodes = plan(given(tmp_path, nodes="encoder, ot_reward", params_file="camera.yaml"))
    assert [node.name for node in nodes] == ["encoder", "ot_reward"]
    assert {node.parameter_files for node in nodes} == {("camera.yaml",)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"nodes": "oven"}, "unknown node 'oven'; known: .*simulator"),
        ({"worlds": "many"}, "worlds:=many is no int"),
        ({"worlds": "0"}, "worlds is 0, expected 1 to 16"),
        ({"steps": "-5"}, "steps is -5, expected 1 or more"),
        ({"seed": "-1"}, "seed is -1, expected 0 or more"),
        ({"pool_episodes": "3"}, "pool_episodes is 3, expected 12 or more"),
        ({"evaluate_every": "-1"}, "evaluate_every is -1, expected 0 or more"),
        ({"task": "juggling"}, "unknown task 'juggling'; known: .*franka_group"),
        ({"reward": "raplx"}, "unknown reward 'raplx'; known: .*rapl"),
        ({"reward": "supervised_probe"}, "never for learning"),
        ({"preset": "nonsense"}, "unknown preset 'nonsense'; known: authors_code, paper, tuned"),
        ({"human": "webb"}, "unknown human 'webb'; known: simulated, web"),
        ({"encoder": "eye"}, "unknown encoder 'eye'"),
        ({"backbone": "spine"}, "unknown backbone 'spine'"),
        ({"engine": "steam"}, "unknown inference engine 'steam'; known: openvino, torch"),
        ({"weights": "/nowhere"}, "no weights at /nowhere"),
        ({"online": "2", "reward": "imagenet"}, "'imagenet' learns nothing from them"),
    ],
)
def test_bad_values_are_refused_by_name_and_leave_no_run(
    tmp_path: Path, changes: dict[str, str], words: str
) -> None:
    with pytest.raises(RaplError, match=words):
        plan(given(tmp_path, **changes))
    assert list(tmp_path.iterdir()) == []


def test_every_argument_is_described() -> None:
    assert all(len(argument.description) > 8 for argument in ARGUMENTS)
    assert len({argument.name for argument in ARGUMENTS}) == len(ARGUMENTS)


def test_every_node_of_the_table_is_an_installed_command() -> None:
    installed = {
        point.name: point.load()
        for point in metadata.distribution("rapl_ros").entry_points
        if point.group == "console_scripts"
    }
    assert {executable_of(entry) for entry in NODES} <= set(installed)
    assert all(callable(function) for function in installed.values())


@pytest.mark.parametrize("path", sorted(BRINGUP.glob("launch/*.py")), ids=lambda path: path.name)
def test_launch_files_compile_and_have_their_entry_point(path: Path) -> None:
    tree = ast.parse(path.read_text())
    compile(tree, str(path), "exec")
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert "generate_launch_description" in functions


class _Recorded:
    """Stands for any class of launch: keeps what it was made with."""

    def __init__(self, *given: object, **named: object) -> None:
        self.given, self.named = given, named


def test_the_launch_file_keeps_the_graph_on_this_machine_unless_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    imported = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": (
            "DeclareLaunchArgument", "EmitEvent", "OpaqueFunction", "SetEnvironmentVariable",
        ),
        "launch.events": ("Shutdown",),
        "launch.substitutions": ("EnvironmentVariable", "LaunchConfiguration"),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }  # fmt: skip
    for module, names in imported.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (_Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    found = runpy.run_path(str(BRINGUP / "launch" / "rapl.launch.py"))
    actions = found["generate_launch_description"]().given[0]
    kinds = [type(action).__name__ for action in actions]
    assert kinds[-2:] == ["SetEnvironmentVariable", "OpaqueFunction"]
    assert kinds.count("DeclareLaunchArgument") == len(ARGUMENTS) == len(kinds) - 2
    name, value = actions[-2].given
    assert name == "ROS_AUTOMATIC_DISCOVERY_RANGE"
    assert (value.given, value.named) == ((name,), {"default_value": "LOCALHOST"})


def test_the_camera_configuration_lets_few_large_pictures_wait() -> None:
    vga_bytes = 640 * 480 * 3
    settings = yaml.safe_load((BRINGUP / "config" / "usb_camera.yaml").read_text())
    known = {
        "encoder": {field.name for field in fields(EncoderNodeConfig)},
        "recorder": {field.name for field in fields(RecorderConfig)},
    }
    for node, names in known.items():
        parameters = settings[f"/rapl/{node}"]["ros__parameters"]
        (override,) = parameters["qos_overrides"].values()
        assert override["subscription"]["depth"] * vga_bytes < 64e6
        assert set(parameters) - {"qos_overrides"} <= names
    assert settings["/rapl/encoder"]["ros__parameters"]["queue_frames"] * vga_bytes < 64e6


def test_the_camera_configuration_makes_the_encoder_take_best_effort_pictures() -> None:
    context = Context()
    arguments = ["--ros-args", "--params-file", str(BRINGUP / "config" / "usb_camera.yaml")]
    rclpy.init(args=arguments, context=context)
    try:
        node = rclpy.create_node(topics.ENCODER, namespace=topics.NAMESPACE, context=context)
        node.create_subscription(
            Image, topics.CAMERA_IMAGE, lambda image: None, qos.stream(),
            qos_overriding_options=qos.overrides(),
        )  # fmt: skip
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        infos = []
        for _ in range(100):
            executor.spin_once(timeout_sec=0.1)
            infos = node.get_subscriptions_info_by_topic(f"/rapl/{topics.CAMERA_IMAGE}")
            if infos:
                break
        assert [info.qos_profile.reliability for info in infos] == [ReliabilityPolicy.BEST_EFFORT]
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
