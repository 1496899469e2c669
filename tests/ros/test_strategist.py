"""The thread behind the preference node that learns which queries to ask next."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_episodes import small_episode

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RankingError
from rapl_core.preferences import DeskConfig, QueryDesk, QueryRequest, RankingStore
from rapl_core.types import Ranking
from rapl_ros.strategist import Strategist

pytestmark = pytest.mark.timeout(240)

VIDEOS, SIZE = 10, 32


def add_video(episodes: EpisodeStore, number: int) -> str:
    """A bright square that moves; the higher the number, the farther."""
    frames = np.full((5, SIZE, SIZE, 3), 40, np.uint8)
    for step in range(5):
        x = step * number * 5 // VIDEOS
        frames[step, 12:20, x : x + 8] = (240, 200, 30)
    name = f"video-{number:02d}"
    episodes.add(small_episode(name, frames))
    return name


def until(condition: Callable[[], bool], what: str, deadline_s: float = 150.0) -> None:
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s, f"not within {deadline_s:g} s: {what}"
        time.sleep(0.05)


def test_it_asks_uniformly_until_it_has_looked_and_then_by_its_strategy(tmp_path: Path) -> None:
    episodes = EpisodeStore(tmp_path / "episodes")
    pool = {add_video(episodes, number) for number in range(VIDEOS)}
    store = RankingStore(tmp_path / "rankings.sqlite", episodes.__contains__)
    strategist = Strategist(store, tmp_path, lambda: pool.copy(), "paper", "float32", seed=0)
    desk = QueryDesk(store, DeskConfig())
    try:
        assert strategist.selector("uniform", 3) is None
        assert strategist.detail("uniform") == ""
        assert strategist.selector("information", 3) is None
        assert strategist.detail("information").startswith("uniform until")
        until(lambda: not strategist.detail("information"), "information is ready")
        strategies = []
        for number in range(3):
            selector = strategist.selector("information", 3)
            query = desk.next(QueryRequest("ada"), pool, selector)
            strategies.append(query.strategy)
            order = sorted(query.episode_ids, reverse=True)
            ranks = tuple(order.index(name) + 1 for name in query.episode_ids)
            store.add(Ranking(f"r{number}", "ada", query.episode_ids, ranks,
                              query_id=query.query_id))  # fmt: skip
            strategist.notice()
        assert strategies == ["information"] * 3

        pool.add(add_video(episodes, VIDEOS))  # a new video comes while people rank
        strategist.notice()
        until(lambda: len(list((tmp_path / "features").rglob("*.safetensors"))) == VIDEOS + 1,
              "the new video is read")  # fmt: skip
        with pytest.raises(RankingError, match="no query"):
            desk.next(QueryRequest("ada"), set(sorted(pool)[:2]), strategist.selector("uniform", 3))

        assert strategist.selector("transport", 4) is None
        until(lambda: "three videos, not 4" in strategist.detail("transport"), "it says why not")
        assert len(desk.next(QueryRequest("ada", size=4), pool, None).episode_ids) == 4
    finally:
        strategist.close(5.0)
        store.close()
