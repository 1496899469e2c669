"""The launch files follow from the table of the nodes. ros2 launch itself is not installable here,
so they are compiled and their parts tested, not launched."""

import ast
from importlib import metadata
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import Image

from rapl_core.errors import RaplError, UnknownNameError
from rapl_ros import qos, topics
from rapl_ros.launching import ARGUMENTS, executable_of, plan
from rapl_ros.node_table import KNOBS, NODES, parameters_of, run_parameters
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
    unset = set(KNOBS)  # of the simulated human: its own defaults hold
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


def test_with_people_there_is_the_page_and_no_simulated_human(tmp_path: Path) -> None:
    names = {node.name for node in plan(given(tmp_path, human="web"))}
    assert "web" in names and "simulated_human" not in names


def test_a_folder_that_holds_a_run_is_continued_with_its_settings(tmp_path: Path) -> None:
    plan(given(tmp_path, worlds="2"))
    nodes = plan(given(tmp_path, worlds="3"))
    assert {node.name: node.parameters for node in nodes}["simulator"]["worlds"] == 2


def test_a_part_of_the_nodes_can_be_launched(tmp_path: Path) -> None:
    nodes = plan(given(tmp_path, nodes="encoder, ot_reward", params_file="camera.yaml"))
    assert [node.name for node in nodes] == ["encoder", "ot_reward"]
    assert {node.parameter_files for node in nodes} == {("camera.yaml",)}


def test_bad_values_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="unknown node 'oven'; known: .*simulator"):
        plan(given(tmp_path, nodes="oven"))
    with pytest.raises(RaplError, match="worlds:=many is no int"):
        plan(given(tmp_path, worlds="many"))


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
