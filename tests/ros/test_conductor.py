"""The conductor's stages as a run numbers them."""

import asyncio
import time

import pytest
from rclpy.parameter import Parameter

from rapl_ros.conductor_node import ConductorNode, needed_stages
from rapl_ros.run_config import RunConfig, save_config
from rapl_ros.stages import Stage

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


def test_a_stages_first_word_comes_however_soon_after_the_last_stage(probe, tmp_path, monkeypatch):
    said = []

    async def perform(context):
        context.show(0, 1, "things")
        context.say("for a node")
        context.say("")
        said.append(node.heartbeat.detail)
        return {}

    stages = [Stage(name, perform, lambda result: "") for name in LAST]
    monkeypatch.setattr("rapl_ros.conductor_node.STAGES", stages)
    save_config(RunConfig("franka_group", reward="ground_truth"), tmp_path)
    node = ConductorNode(
        parameter_overrides=[Parameter("run_folder", value=str(tmp_path))],
    )
    node._publish = lambda progress: said.append((progress.stage, progress.status))
    try:
        for stage in stages:
            node._meter = node._meter_of(stage)
            node._published_s = time.monotonic()  # the last word of the stage before
            asyncio.run(node._run_stage(stage))
    finally:
        node.close()
        node.destroy_node()
    assert said == [
        word
        for name in LAST
        for word in ((name, "running"), (name, "waiting"), name, (name, "done"))
    ]
