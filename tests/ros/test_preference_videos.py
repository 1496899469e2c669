"""The preference node's videos: those that cannot be read, and the robot's own."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ranked_videos import STEPS, make_videos
from rapl_msgs.srv import GetQuery
from std_msgs.msg import String

from rapl_core.episodes import EpisodeStore
from rapl_core.types import Ranking
from rapl_ros.preference_node import PreferenceNode

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


def test_a_video_that_cannot_be_read_is_asked_about_no_more_and_told(
    tmp_path: Path, rclpy_context: None
) -> None:
    make_videos(tmp_path)
    episodes = tmp_path / "episodes"
    (bag,) = (episodes / "video-03").glob("*.mcap")
    bag.write_bytes(b"damaged")
    shutil.rmtree(episodes / "video-04")
    node = PreferenceNode(cli_args=["--ros-args", "-p", f"run_folder:={tmp_path}"])
    try:
        for video in ("video-03", "video-05", "elsewhere"):
            node._on_unreadable(String(data=video))
        shutil.rmtree(episodes / "video-06")
        for _ in range(40):
            request = GetQuery.Request(annotator="ada")
            shown = node._on_get_query(request, GetQuery.Response())
            assert shown.success, shown.message
            assert not {"video-03", "video-04", "video-06"} & set(shown.query.episode_ids)
        text = node.diagnostics.conditions["unreadable videos"]
        assert "video-03" in text and "video-06" in text and "video-05" not in text
    finally:
        node.close()
        node.destroy_node()


def test_own_videos_that_cannot_be_read_or_are_old_are_not_given_back(
    tmp_path: Path, rclpy_context: None
) -> None:
    make_videos(tmp_path)
    store = EpisodeStore(tmp_path / "episodes")
    base = store.load("video-05")

    def record(number: int) -> tuple[str, int]:
        stamps = np.arange(100, 100 + STEPS + 1) * (number + 1)
        name = f"train-{number}"
        store.add(replace(base, episode_id=name, purpose="train", stamps_ns=stamps))
        return name, int(stamps[-1])

    for number in range(6):
        record(number)
    node = PreferenceNode(cli_args=["--ros-args", "-p", f"run_folder:={tmp_path}"])

    def shown(strategy: str, *held: str) -> Any:
        request = GetQuery.Request(annotator="ada", strategy=strategy, resume=True, held=held)
        response = node._on_get_query(request, GetQuery.Response())
        assert response.success, response.message
        return response.query

    try:
        videos = ("video-00", "video-01", "video-02")
        node._store.add(Ranking("first", "ada", videos, (1, 2, 3)))
        pool = shown("uniform").query_id
        assert shown("uniform").query_id == pool, "as after a reload"
        own = shown("own")
        assert own.query_id != pool and shown("own").query_id == own.query_id
        broken = next(name for name in own.episode_ids if name.startswith("train-"))
        (bag,) = (tmp_path / "episodes" / broken).glob("*.mcap")
        bag.write_bytes(b"damaged")
        node._on_unreadable(String(data=broken))
        for _ in range(10):
            assert broken not in shown("own", own.query_id).episode_ids
        after = shown("own")
        assert after.query_id != own.query_id
        node._own.aligned(node._own.newest_ns)
        for number in (6, 7):
            name, stamp_ns = record(number)
            node._take_in(name, "train", stamp_ns)
        assert {"train-6", "train-7"} < set(shown("own").episode_ids)
        assert shown("uniform").query_id == pool, "nor is it lost"
    finally:
        node.close()
        node.destroy_node()
