"""Which triplets teach and which choose the best epoch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rapl_core.errors import RankingError
from rapl_core.types import Triplet

_FEWEST_TO_SPLIT = 5


@dataclass(frozen=True)
class TripletSplit:
    """Triplets to learn from, held out, and left out of both."""

    train: tuple[Triplet, ...]
    held_out: tuple[Triplet, ...]
    dropped: tuple[Triplet, ...] = ()

    @property
    def unseen_videos(self) -> frozenset[str]:
        """Videos of held-out triplets that no triplet to learn from shows."""
        return _videos(self.held_out) - _videos(self.train)


def split_triplets(
    triplets: Sequence[Triplet],
    share: float,
    rng: np.random.Generator,
    disjoint_videos: bool = False,
) -> TripletSplit:
    """Hold out a share of the triplets, at random. Fewer than five are all used to learn from.

    Triplets drawn from one pool overlap: without ``disjoint_videos`` a video may be in a triplet
    to learn from and in a held-out one, though no comparison is. With it, triplets that share a
    video with a held-out one are dropped, and the held-out ones tell of videos never seen.

    :raises RankingError: if nothing is left to learn from.
    """
    if not triplets:
        raise RankingError("no triplet to learn from, expected at least one")
    size = round(share * len(triplets)) if len(triplets) >= _FEWEST_TO_SPLIT else 0
    chosen = {int(i) for i in rng.permutation(len(triplets))[:size]}
    held_out = tuple(t for i, t in enumerate(triplets) if i in chosen)
    rest = tuple(t for i, t in enumerate(triplets) if i not in chosen)
    if not disjoint_videos:
        return TripletSplit(rest, held_out)
    held_videos = _videos(held_out)
    train = tuple(t for t in rest if held_videos.isdisjoint((t.best, t.middle, t.worst)))
    if not train:
        raise RankingError(
            f"all {len(rest)} triplets share a video with the {size} held out: none is left to "
            "learn from; hold out fewer or allow shared videos"
        )
    return TripletSplit(train, held_out, tuple(t for t in rest if t not in set(train)))


def _videos(triplets: Sequence[Triplet]) -> frozenset[str]:
    return frozenset(name for t in triplets for name in (t.best, t.middle, t.worst))
