"""Triplets that nobody was asked about and that follow from those that somebody was."""

from collections.abc import Sequence

import numpy as np

from rapl_core.preferences.expert_set import strengths
from rapl_core.types import Ranking, Triplet

APART = 0.5
"""Neighbours in an inferred triplet differ by more than this in Bradley-Terry strength."""
_TRIES = 20
"""A triplet; where videos lie closer together there are fewer triplets."""


def inferred_triplets(
    triplets: Sequence[Triplet], count: int, rng: np.random.Generator
) -> list[Triplet]:
    """Return up to ``count`` triplets of ranked videos, ordered by strength.

    The Bradley-Terry strengths of the triplets order all their videos: what a beat b and b beat c
    says of a and c, which no answer does by itself. Three videos are drawn at random and taken
    if their strengths are more than :data:`APART` apart. An addition to the paper's loss, which
    sees only videos that were shown together.
    """
    rankings = [
        Ranking(str(number), "inferred", (t.best, t.middle, t.worst), (1, 2, 3))
        for number, t in enumerate(triplets)
    ]
    strength = strengths(rankings)
    videos = sorted(strength)
    found: list[Triplet] = []
    for _ in range(_TRIES * count if len(videos) > 2 else 0):
        drawn = [videos[int(i)] for i in rng.choice(len(videos), 3, replace=False)]
        best, middle, worst = sorted(drawn, key=lambda video: -strength[video])
        if min(strength[best] - strength[middle], strength[middle] - strength[worst]) > APART:
            found.append(Triplet(best, middle, worst))
            if len(found) == count:
                break
    return found
