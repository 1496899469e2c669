"""Synthetic videos: a red square that ends at some distance from a goal, behind a moving blob."""

from dataclasses import dataclass, replace

import numpy as np

from rapl_core.representations.extractor import FeatureRecipe
from rapl_core.representations.pooling import Pooling
from rapl_core.representations.presets import TUNED
from rapl_core.types import Triplet

FRAMES, SIZE = 8, 64
GOAL = np.array([44.0, 10.0])

SMALL = replace(
    TUNED,
    name="small",
    recipe=FeatureRecipe(stages=("stride8",), poolings=(Pooling("grid", grid=4),), size=(64, 64)),
    components=64,
    mirror=False,
    slow_weight=0.0,  # everything moves all the time in these videos
    epochs=30,
    held_out=0.2,
)


def square_video(end: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(FRAMES, SIZE, SIZE, 3) of a red square that moves to ``end``, and a blue one anywhere."""
    frames = np.full((FRAMES, SIZE, SIZE, 3), 230, np.uint8)
    start = rng.uniform(4, 50, 2)
    for t, share in enumerate(np.linspace(0, 1, FRAMES)):
        x, y = (start + share * (end - start)).astype(int)
        frames[t, y : y + 10, x : x + 10] = (200, 30, 30)
        x, y = rng.integers(0, SIZE - 8, 2)
        frames[t, y : y + 8, x : x + 8] = (30, 30, 200)
    return frames


@dataclass(frozen=True)
class Pool:
    """Videos, the better the nearer to the goal they end, and triplets of them."""

    videos: dict[str, np.ndarray]
    names: list[str]
    """Best first."""
    triplets: list[Triplet]

    @property
    def expert_ids(self) -> list[str]:
        return self.names[:5]


def make_pool(prefix: str, videos: int, triplets: int, rng: np.random.Generator) -> Pool:
    ends = rng.uniform(4, 50, size=(videos, 2))
    ends[:5] = GOAL + rng.uniform(-3, 3, size=(5, 2))
    order = np.argsort(np.linalg.norm(ends - GOAL, axis=1))
    names = [f"{prefix}-{i}" for i in range(videos)]
    shown = {name: square_video(ends[i], rng) for name, i in zip(names, order, strict=True)}
    drawn = [np.sort(rng.choice(videos, 3, replace=False)) for _ in range(triplets)]
    return Pool(shown, names, [Triplet(*(names[i] for i in three)) for three in drawn])
