"""Held-out triplets."""

import numpy as np
import pytest

from rapl_core.errors import RankingError
from rapl_core.representations.split import split_triplets
from rapl_core.types import Triplet


def triplets(count: int, videos: int) -> list[Triplet]:
    rng = np.random.default_rng(0)
    names = [f"v{i}" for i in range(videos)]
    return [Triplet(*rng.choice(names, 3, replace=False)) for _ in range(count)]


def test_every_triplet_is_on_one_side():
    given = triplets(50, 500)
    split = split_triplets(given, 0.2, np.random.default_rng(1))
    assert len(split.held_out) == 10 and len(split.train) == 40 and not split.dropped
    assert set(split.train) | set(split.held_out) == set(given)


def test_disjoint_videos_are_disjoint_and_what_it_costs_is_told():
    given = triplets(60, 150)
    split = split_triplets(given, 0.1, np.random.default_rng(1), disjoint_videos=True)
    train = {v for t in split.train for v in (t.best, t.middle, t.worst)}
    held = {v for t in split.held_out for v in (t.best, t.middle, t.worst)}
    assert train.isdisjoint(held) and split.unseen_videos == held
    assert len(split.train) + len(split.held_out) + len(split.dropped) == 60
    assert split.dropped


def test_unseen_videos_are_those_of_held_out_triplets_alone():
    split = split_triplets(triplets(40, 40), 0.2, np.random.default_rng(1))
    train = {v for t in split.train for v in (t.best, t.middle, t.worst)}
    assert split.unseen_videos.isdisjoint(train)


def test_a_handful_of_triplets_is_not_split():
    split = split_triplets(triplets(4, 9), 0.5, np.random.default_rng(1))
    assert len(split.train) == 4 and not split.held_out


def test_nothing_to_learn_from_is_refused():
    with pytest.raises(RankingError, match="no triplet"):
        split_triplets([], 0.2, np.random.default_rng(0))
    same = [Triplet("a", "b", "c")] * 8
    with pytest.raises(RankingError, match="all 6 triplets share a video with the 2 held out"):
        split_triplets(same, 0.2, np.random.default_rng(0), disjoint_videos=True)
