"""Videos, features and returns of franka_group for the studies beside this file; kept on disk.

Seed s has a pool of 300 videos to ask about and 100 test videos that nobody is asked about, from
separate seed streams. Features are read once as the preset wants them.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.preferences.wishes import wish_rewards
from rapl_core.representations import FeatureStore, Preset, find_parts, make_extractor
from rapl_core.representations.features import MIRRORED
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.tasks import get_task
from rapl_core.types import Episode

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "franka_group"))

from videos import TASK, make_videos  # noqa: E402

POOL, TEST = 300, 100


@dataclass(frozen=True)
class Videos:
    """Videos of one seed stream."""

    features: dict[str, NDArray[np.float32]]
    """(T, F) by episode id; of a pool also the mirrored twins, where the preset has them."""
    rewards: dict[str, dict[str, NDArray[np.float64]]]
    """By wish and episode id: (T,) what a person of this wish feels."""

    @property
    def originals(self) -> dict[str, NDArray[np.float32]]:
        """The videos that there are, without twins."""
        return {n: f for n, f in self.features.items() if not n.startswith(MIRRORED)}

    def returns(self, wish: str = "task") -> dict[str, float]:
        """What each video is worth to a person of this wish."""
        return {name: float(values.sum()) for name, values in self.rewards[wish].items()}


def load(seed: int, preset: Preset, work: Path, wishes: tuple[str, ...]) -> tuple[Videos, Videos]:
    """Return the pool and the test videos of a seed; what the features are is found in the pool.

    :param work: where videos and features are kept.
    """
    pool = make_videos(seed, "demonstrate", POOL, work)
    extractor = make_extractor(DEFAULT_BACKBONE, preset.recipe)
    frames = {video.episode_id: video.frames[1:] for video in pool}
    find_parts(extractor, list(frames), frames.__getitem__, seed)
    store = FeatureStore(extractor, work / "features", precision="bfloat16", mirror=preset.mirror)
    found = _videos(seed, pool, store, wishes)
    del pool, frames
    store = FeatureStore(extractor, work / "features", precision="bfloat16")
    return found, _videos(seed, make_videos(seed, "test", TEST, work), store, wishes)


def _videos(
    seed: int, videos: list[Episode], store: FeatureStore, wishes: tuple[str, ...]
) -> Videos:
    names = get_task(TASK).state_names
    rewards = {wish: {v.episode_id: _felt(wish, v, names)[1:] for v in videos} for wish in wishes}
    for number, video in enumerate(videos):
        store.add_episode(video)
        if store.computed and number % 100 == 0:
            print(f"seed {seed}: features of {number} of {len(videos)}", flush=True)
    return Videos({name: store[name] for name in store}, rewards)


def _felt(wish: str, video: Episode, names: tuple[str, ...]) -> NDArray[np.float64]:
    return wish_rewards(wish, video.human_rewards, video.states, names)
