"""Every measure of a reward on videos and scenes that nothing was learnt from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rapl_core.analysis import measures
from rapl_core.analysis.scenes import Landscape
from rapl_core.representations.report import wilson_interval
from rapl_core.types import Episode

TEST_TRIPLETS = 1000


def human(video: Episode) -> NDArray[np.float64]:
    """(T,) r* of the frames arrived in."""
    assert video.human_rewards is not None
    return video.human_rewards[1:]


def judge(
    rewards: Sequence[NDArray[np.float64]],
    videos: Sequence[Episode],
    landscape: Landscape,
    seed: int,
) -> dict[str, Any]:
    """Every measure of a reward.

    :param rewards: (T,) of each test video.
    :param landscape: of the same reward.
    :param seed: of the triplets.
    """
    felt = [human(v) for v in videos]
    partial = measures.partial_spearman_given_time(rewards, felt)
    disliked = [i for i, v in enumerate(videos) if v.behaviour == "one_at_a_time"]
    returns = {v.episode_id: float(r.sum()) for v, r in zip(videos, rewards, strict=True)}
    triplets = draw_triplets(videos, np.random.default_rng([seed, 401]))
    accuracy = measures.triplet_accuracy(returns, triplets)

    def of(is_one: Callable[[Episode], bool]) -> list[NDArray[np.float64]]:
        return [r for v, r in zip(videos, rewards, strict=True) if is_one(v)]

    successes, mimes = of(lambda v: bool(v.success)), of(lambda v: v.behaviour == "mime")
    return {
        **asdict(measures.agreement(rewards, felt)),
        "step_given_time": partial.mean,
        "step_given_time_undefined": partial.undefined,
        "step_one_at_a_time": measures.spearman_per_step(
            [rewards[i] for i in disliked], [felt[i] for i in disliked]
        ).mean,
        "arm_only": measures.arm_only_share(successes, mimes),
        "success_gain": measures.mean_gain(successes) / float(np.std(np.concatenate(rewards))),
        "triplets": len(triplets),
        "triplet_accuracy": accuracy,
        "triplet_interval": wilson_interval(accuracy, len(triplets)),
        "video_mix": measures.video_mix([v.behaviour for v in videos]),
        "landscape": _landscape(landscape),
    }


def draw_triplets(
    videos: Sequence[Episode], rng: np.random.Generator
) -> list[tuple[str, str, str]]:
    """Distinct triplets of test videos alone, best first by the human's reward."""
    returns = {v.episode_id: v.human_return for v in videos}
    names, drawn = sorted(returns), set()
    while len(drawn) < TEST_TRIPLETS:
        three = [names[i] for i in rng.choice(len(names), 3, replace=False)]
        drawn.add(tuple(sorted(three, key=lambda name: -returns[name])))
    return sorted(drawn)


def _landscape(landscape: Landscape) -> dict[str, Any]:
    found: Mapping[str, Any] = asdict(landscape.wishes())
    ways = {name: way.tolist() for name, way in landscape.ways.items()}
    return {**found, "random": landscape.spearman, "ways": ways}
