"""The preference node's long work: what it is told to train is what learns."""

from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ranked_videos import make_videos
from rapl_msgs.action import Align

from rapl_core.preferences import RankingStore
from rapl_core.representations import load_encoder, make_extractor
from rapl_core.types import Ranking
from rapl_ros.preference_node import PreferenceNode

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


def align(folder: Path, method: str, preset: str, *parameters: str) -> tuple[Any, list[Any]]:
    """What the node makes of ranked videos, and what it told meanwhile."""
    returns = make_videos(folder)
    with RankingStore(folder / "rankings.sqlite") as store:
        for number, three in enumerate(list(combinations(returns, 3))[::28]):
            best_first = sorted(three, key=returns.__getitem__, reverse=True)
            store.add(Ranking(f"r{number}", "ada", tuple(best_first), (1, 2, 3)))
    told: list[Any] = []
    request = Align.Goal(encoder=method, preset=preset, seed=1)
    goal = SimpleNamespace(request=request, is_cancel_requested=False, publish_feedback=told.append)
    arguments = [part for given in (f"run_folder:={folder}", *parameters) for part in ("-p", given)]
    node = PreferenceNode(cli_args=["--ros-args", *arguments])
    try:
        return node._work(goal).groups[0], told  # type: ignore[arg-type]
    finally:
        node.close()
        node.destroy_node()


def test_the_last_block_is_trained_where_the_node_is_told_to(
    tmp_path: Path, rclpy_context: None
) -> None:
    outcome, told = align(tmp_path, "rlhf", "paper", "trained:=last_block")
    encoder = load_encoder(tmp_path / outcome.uri)
    given = make_extractor("efficientnet_lite0", encoder.card.recipe)
    assert encoder.card.has_own_backbone
    assert (tmp_path / outcome.uri / "backbone.safetensors").is_file()
    assert encoder.card.backbone_sha256 != given.backbone.weights_sha256
    assert told[-1].epoch == told[-1].epochs == 110  # 100 of the head, 10 of both


@pytest.mark.skipif(find_spec("openvino") is None, reason="openvino is not installed")
@pytest.mark.parametrize("method", ["rapl", "imagenet"])
def test_features_come_from_the_engine_that_the_node_is_told(
    tmp_path: Path, rclpy_context: None, method: str
) -> None:
    outcome, _ = align(tmp_path, method, "paper", "engine:=openvino")
    assert [path.name.split("-")[1] for path in (tmp_path / "features").iterdir()] == ["openvino"]
    load_encoder(tmp_path / outcome.uri)
