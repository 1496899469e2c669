"""From rankings to triplets, pairs and a held-out part."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rapl_core.errors import RankingError
from rapl_core.types import Ranking, Triplet


@dataclass(frozen=True)
class Pair:
    """Two videos of one ranking."""

    better: str
    worse: str
    tie: bool = False
    """Equally good: ``better`` and ``worse`` mean nothing then."""


@dataclass(frozen=True)
class RankingSplit:
    """Rankings to learn from and rankings to test with."""

    train: tuple[Ranking, ...]
    held_out: tuple[Ranking, ...]
    dropped: tuple[Ranking, ...]
    """Neither: they share a video with a held-out one (only when the videos must be disjoint)."""


def triplets_from(rankings: Iterable[Ranking]) -> list[Triplet]:
    """Return every three videos that one ranking puts in strict order (paper, Definition 1).

    A ranking of three different ranks gives one triplet, of n gives all n (n-1) (n-2) / 6;
    three videos of which two tie give none. Order: that of the rankings, then of the ranks.
    """
    triplets = []
    for ranking in rankings:
        for first, second, third in combinations(_ordered(ranking), 3):
            if first[0] < second[0] < third[0]:
                triplets.append(Triplet(best=first[1], middle=second[1], worst=third[1]))
    return triplets


def pairs_from(rankings: Iterable[Ranking]) -> list[Pair]:
    """Return every two videos of each ranking, ties included and marked."""
    return [
        Pair(better=first[1], worse=second[1], tie=first[0] == second[0])
        for ranking in rankings
        for first, second in combinations(_ordered(ranking), 2)
    ]


def split_rankings(
    rankings: Sequence[Ranking],
    held_out: float,
    rng: np.random.Generator,
    disjoint_videos: bool = False,
) -> RankingSplit:
    """Split rankings at random into those to learn from and those to test with.

    :param held_out: share to hold out, in [0, 1); at least one when greater than zero.
    :param disjoint_videos: drop from training what shares a video with a held-out ranking, so
        that the test is about videos never seen; costs training data when videos recur.
    :raises RankingError: if ``held_out`` is out of range or leaves nothing to learn from.
    """
    if not 0 <= held_out < 1:
        raise RankingError(f"the held-out share is {held_out}, expected 0 <= share < 1")
    size = max(1, round(held_out * len(rankings))) if held_out > 0 else 0
    if size >= len(rankings):
        raise RankingError(
            f"cannot hold out {size} of {len(rankings)} rankings and learn from the others"
        )
    chosen = {int(i) for i in rng.permutation(len(rankings))[:size]}
    test = tuple(r for i, r in enumerate(rankings) if i in chosen)
    rest = tuple(r for i, r in enumerate(rankings) if i not in chosen)
    if not disjoint_videos:
        return RankingSplit(train=rest, held_out=test, dropped=())
    tested = {episode_id for ranking in test for episode_id in ranking.episode_ids}
    train = tuple(r for r in rest if tested.isdisjoint(r.episode_ids))
    if not train:
        raise RankingError(
            f"every ranking shares a video with the {size} held out: none is left to learn from"
        )
    return RankingSplit(train, test, tuple(r for r in rest if not tested.isdisjoint(r.episode_ids)))


def _ordered(ranking: Ranking) -> list[tuple[int, str]]:
    """Rank and video, best first, equal ranks as shown; empty unless ranked."""
    return sorted(
        zip(ranking.ranks, ranking.episode_ids, strict=bool(ranking.ranks)),
        key=lambda ranked: ranked[0],
    )
