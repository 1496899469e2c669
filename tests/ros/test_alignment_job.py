"""The preference node's long work: what it is told to train is what learns."""

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


def test_the_last_block_is_trained_where_the_node_is_told_to(
    tmp_path: Path, rclpy_context: None
) -> None:
    returns = make_videos(tmp_path)
    with RankingStore(tmp_path / "rankings.sqlite") as store:
        for number, three in enumerate(list(combinations(returns, 3))[::28]):
            best_first = sorted(three, key=returns.__getitem__, reverse=True)
            store.add(Ranking(f"r{number}", "ada", tuple(best_first), (1, 2, 3)))
    told: list[Any] = []
    request = Align.Goal(encoder="rlhf", preset="paper", seed=1)
    goal = SimpleNamespace(request=request, is_cancel_requested=False, publish_feedback=told.append)
    parameters = ["-p", f"run_folder:={tmp_path}", "-p", "trained:=last_block"]
    node = PreferenceNode(cli_args=["--ros-args", *parameters])
    try:
        outcome = node._work(goal).groups[0]  # type: ignore[arg-type]
    finally:
        node.close()
        node.destroy_node()
    encoder = load_encoder(tmp_path / outcome.uri)
    given = make_extractor("efficientnet_lite0", encoder.card.recipe)
    assert encoder.card.has_own_backbone
    assert (tmp_path / outcome.uri / "backbone.safetensors").is_file()
    assert encoder.card.backbone_sha256 != given.backbone.weights_sha256
    assert told[-1].epoch == told[-1].epochs == 110  # 100 of the head, 10 of both
