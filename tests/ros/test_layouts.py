"""The layouts of rviz and Foxglove name topics and fields that exist. Neither was opened here."""

import json
import re
from pathlib import Path
from typing import Any

import yaml
from rapl_msgs.msg import Metrics, Reward
from sensor_msgs.msg import JointState

from rapl_ros import topics

BRINGUP = Path(__file__).parents[2] / "ros_ws" / "src" / "rapl_bringup"
PLOTTED = {topics.REWARD: Reward, topics.METRICS: Metrics, topics.JOINT_STATES: JointState}


def panels(node: Any) -> list[str]:
    """The panels of a Foxglove layout, a tree of splits."""
    return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])


def test_the_foxglove_layout_shows_what_the_graph_publishes() -> None:
    layout = json.loads((BRINGUP / "foxglove" / "rapl.json").read_text())
    configured = layout["configById"]
    assert sorted(panels(layout["layout"])) == sorted(configured)
    camera = configured["Image!rapl_camera"]["imageMode"]["imageTopic"]
    assert camera == f"/{topics.NAMESPACE}/{topics.CAMERA_IMAGE}"
    assert configured["DiagnosticSummary!rapl_health"]["topicToRender"] == topics.DIAGNOSTICS
    paths = [path["value"] for panel in configured.values() for path in panel.get("paths", ())]
    seen = set()
    for path in paths:
        match = re.fullmatch(rf"/{topics.NAMESPACE}/(\w+)\.(\w+)(\[:\])?", path)
        assert match, path
        topic, field, is_list = match.groups()
        seen.add(topic)
        kind = PLOTTED[topic].get_fields_and_field_types()[field]
        assert kind.startswith("sequence") if is_list else kind == "double", path
    assert seen == set(PLOTTED)


def test_the_rviz_layout_shows_the_cameras_of_two_worlds() -> None:
    manager = yaml.safe_load((BRINGUP / "rviz" / "rapl.rviz").read_text())["Visualization Manager"]
    shown = [display["Topic"]["Value"] for display in manager["Displays"]]
    names = [topics.world_topic(topics.CAMERA_IMAGE, world) for world in (0, 1)]
    assert shown == [f"/{topics.NAMESPACE}/{name}" for name in names]
    assert manager["Global Options"]["Fixed Frame"] == topics.world_frame(0)


def test_the_package_installs_both() -> None:
    assert "rviz foxglove" in (BRINGUP / "CMakeLists.txt").read_text()
