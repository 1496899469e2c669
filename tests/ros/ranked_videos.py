"""Videos that the preference node asks about, each better than the one before."""

from pathlib import Path

import numpy as np
from small_episodes import small_episode

from rapl_core.episodes import EpisodeStore

VIDEOS, STEPS, SIZE = 12, 6, 32


def make_videos(folder: Path) -> dict[str, float]:
    """Videos of a bright square; the better, the farther it gets. Returns by id."""
    store = EpisodeStore(folder / "episodes")
    returns = {}
    for number in range(VIDEOS):
        frames = np.full((STEPS + 1, SIZE, SIZE, 3), 40, np.uint8)
        for step in range(STEPS + 1):
            x = round(step / STEPS * number * 24 / VIDEOS)
            frames[step, 12:20, x : x + 8] = (240, 200, 30)
        rewards = -np.linspace(1.0, 1.0 - number / VIDEOS, STEPS + 1)
        episode = small_episode(f"video-{number:02d}", frames, human_rewards=rewards, success=False)
        store.add(episode)
        returns[episode.episode_id] = episode.human_return
    return returns
