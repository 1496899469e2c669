"""Triplets inferred from those that were ranked."""

import numpy as np

from rapl_core.representations.inferred import APART, inferred_triplets
from rapl_core.types import Triplet

WORTH = {f"v{i:02d}": float(i) for i in range(40)}


def asked(count: int, seed: int = 0) -> list[Triplet]:
    """Triplets of a person who errs never."""
    rng = np.random.default_rng(seed)
    names = sorted(WORTH)
    three = [rng.choice(names, 3, replace=False).tolist() for _ in range(count)]
    return [Triplet(*sorted(t, key=lambda video: -WORTH[video])) for t in three]


def test_most_of_them_are_ordered_as_the_person_would() -> None:
    found = inferred_triplets(asked(60), 300, np.random.default_rng(1))
    assert len(found) == 300
    right = [WORTH[t.best] > WORTH[t.middle] > WORTH[t.worst] for t in found]
    assert np.mean(right) > 0.75  # by chance one in six


def test_they_name_ranked_videos_alone_and_go_beyond_what_was_asked() -> None:
    lesson = asked(20)
    known = {video for t in lesson for video in (t.best, t.middle, t.worst)}
    found = inferred_triplets(lesson, 100, np.random.default_rng(1))
    assert {video for t in found for video in (t.best, t.middle, t.worst)} <= known
    assert len({frozenset((t.best, t.middle, t.worst)) for t in found} - {
        frozenset((t.best, t.middle, t.worst)) for t in lesson
    }) > 50  # fmt: skip


def test_what_cannot_be_told_apart_is_not_inferred() -> None:
    circle = [Triplet("a", "b", "c"), Triplet("b", "c", "a"), Triplet("c", "a", "b")]
    assert inferred_triplets(circle, 50, np.random.default_rng(0)) == []
    assert inferred_triplets([], 50, np.random.default_rng(0)) == []
    assert inferred_triplets(asked(5), 0, np.random.default_rng(0)) == []
    assert APART > 0


def test_the_same_seed_gives_the_same() -> None:
    lesson = asked(30)
    one, other = (inferred_triplets(lesson, 40, np.random.default_rng(3)) for _ in range(2))
    assert one == other
