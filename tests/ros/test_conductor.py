"""The conductor's stages as a run numbers them."""

import pytest
from rclpy.parameter import Parameter

from rapl_ros.conductor_node import ConductorNode, needed_stages
from rapl_ros.run_config import RunConfig, save_config

LAST = ["train", "evaluate", "report"]


@pytest.mark.parametrize(
    ("reward", "first"),
    [
        ("rapl", ["collect", "rank", "align"]),
        ("tcc", ["collect", "rank", "demonstrate", "align"]),
        ("ground_truth", []),
    ],
)
def test_only_the_stages_that_a_run_needs_are_numbered(probe, tmp_path, reward, first):
    config = RunConfig("franka_group", reward=reward)
    assert [stage.name for stage in needed_stages(config)] == [*first, *LAST]
    save_config(config, tmp_path)
    node = ConductorNode(
        parameter_overrides=[Parameter("run_folder", value=str(tmp_path))],
    )
    try:
        shown = [node._meter_of(stage).at(0, 1, "steps") for stage in needed_stages(config)]
        assert [(s.index, s.stages) for s in shown] == [
            (number, len(first) + 3) for number in range(1, len(first) + 4)
        ]
    finally:
        node.close()
        node.destroy_node()
