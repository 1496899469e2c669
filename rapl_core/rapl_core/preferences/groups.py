"""Groups of annotators who want the same: a mixture of utilities, one a group.

Each annotator belongs to one group whole; groups are found by expectation-maximisation with
annotators as the units. How many there are is decided on answers held out: a further group must
predict them better beyond doubt."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError
from rapl_core.preferences.utility import Comparisons, LinearUtility, comparisons, fit_utility
from rapl_core.preferences.video_features import VideoFeatures
from rapl_core.types import Ranking

STARTS = 8
ITERATIONS = 30
FOLDS = 4
MOST_GROUPS = 4
DOUBT = 2.0
"""Standard errors by which a further group must be better."""


@dataclass(frozen=True)
class Groups:
    """Who goes with whom."""

    members: tuple[tuple[str, ...], ...]
    """Names by group, the group with the most rankings first."""
    held_out_accuracy: tuple[float, ...]
    """By number of groups 1, 2, ...: share of held-out comparisons ordered right."""
    cross_agreement: float
    """Mean share of comparisons of one group that the utility of another orders the same; NaN with
    one group. Near 1: the same wish; 1/2: unrelated; near 0: opposite."""

    @property
    def count(self) -> int:
        """How many groups."""
        return len(self.members)


def find_groups(
    features: VideoFeatures,
    rankings: Sequence[Ranking],
    rng: np.random.Generator,
    count: int | None = None,
) -> Groups:
    """Group annotators by what they want.

    :param rankings: those that count.
    :param count: how many groups; None: as many as the answers speak for, up to four.
    :raises RankingError: if there are fewer annotators than groups.
    """
    pairs = comparisons(features, rankings)
    people = sorted(set(pairs.annotators))
    if count is not None and not 1 <= count <= max(1, len(people)):
        raise RankingError(f"{count} groups of {len(people)} annotators, expected at most as many")
    if len(people) < 2:
        return Groups((tuple(people),), (), math.nan)
    most = min(MOST_GROUPS, len(people)) if count is None else count
    gains = [_held_out(pairs, people, size, rng) for size in range(1, most + 1)]
    chosen = count or _how_many(gains)
    owner, utilities = _fit(pairs, people, chosen, rng)
    sizes = [sum(r.annotator in _named(people, owner, g) for r in rankings) for g in range(chosen)]
    order = [g for g in np.argsort([-size for size in sizes], kind="stable") if sizes[g]]
    members = tuple(tuple(_named(people, owner, int(g))) for g in order)
    return Groups(
        members,
        tuple(float(np.mean(right)) for _, right in gains),
        _cross_agreement(pairs, people, owner, utilities),
    )


def _how_many(gains: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> int:
    """The least number that no larger one beats beyond doubt, one step at a time."""
    chosen = 1
    for count in range(2, len(gains) + 1):
        better = gains[count - 1][0] - gains[chosen - 1][0]  # (m,) gain in log-likelihood
        error = better.std() / math.sqrt(len(better))
        if better.mean() > DOUBT * error:
            chosen = count
    return chosen


def _held_out(
    pairs: Comparisons, people: Sequence[str], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(m,) log-likelihood and (m,) rightness of each comparison when it is held out."""
    folds = _folds(pairs)
    number = {name: i for i, name in enumerate(people)}
    value, right = np.zeros(len(pairs)), np.zeros(len(pairs))
    for fold in range(FOLDS):
        held = folds == fold
        if not held.any():
            continue
        owner, utilities = _fit(pairs.where(~held), people, count, rng)
        tested = pairs.where(held)
        margins = np.array([u.margins(tested) for u in utilities])  # (G, m')
        own = owner[[number[name] for name in tested.annotators]]
        mine = margins[own, np.arange(len(tested))]
        y = tested.wins
        value[held] = -y * np.logaddexp(0, -mine) - (1 - y) * np.logaddexp(0, mine)
        right[held] = np.where(y == 1, mine > 0, 0.5)
    return value, right


def _folds(pairs: Comparisons) -> NDArray[np.int64]:
    """(m,) fold of each comparison: everybody's rankings in turn, so that none holds out a person.

    Whoever is held out whole belongs to no group that their answers could speak for.
    """
    fold_of: dict[int, int] = {}
    given: Counter[str] = Counter()
    for ranking, name in zip(pairs.rankings.tolist(), pairs.annotators, strict=True):
        if ranking not in fold_of:
            fold_of[ranking] = given[name] % FOLDS
            given[name] += 1
    return np.array([fold_of[ranking] for ranking in pairs.rankings.tolist()])


def _fit(
    pairs: Comparisons, people: Sequence[str], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], list[LinearUtility]]:
    """The best of several starts: owner (A,) and the utility of each group."""
    dimension = pairs.differences.shape[1]
    number = {name: i for i, name in enumerate(people)}
    person = np.array([number[name] for name in pairs.annotators], dtype=np.int64)
    best, found = -math.inf, None
    for _ in range(STARTS if count > 1 else 1):
        owner = rng.permutation(len(people)) % count  # (A,)
        for _ in range(ITERATIONS):
            utilities = [
                fit_utility(pairs.where(owner[person] == g), dimension) for g in range(count)
            ]
            margins = np.array([u.margins(pairs) for u in utilities])  # (G, m)
            y = pairs.wins
            fit = -y * np.logaddexp(0, -margins) - (1 - y) * np.logaddexp(0, margins)
            score = np.array([np.bincount(person, row, len(people)) for row in fit])  # (G, A)
            moved = score.argmax(axis=0)
            if (moved == owner).all():
                break
            owner = moved
        total = float(score.max(axis=0).sum())
        if total > best:
            best, found = total, (owner, utilities)
    assert found is not None
    return found


def _cross_agreement(
    pairs: Comparisons,
    people: Sequence[str],
    owner: NDArray[np.int64],
    utilities: Sequence[LinearUtility],
) -> float:
    number = {name: i for i, name in enumerate(people)}
    own = owner[[number[name] for name in pairs.annotators]]
    shares = [
        float(np.mean(utilities[other].margins(pairs.where(own == group)) > 0))
        for group in range(len(utilities))
        for other in range(len(utilities))
        if other != group and (own == group).any()
    ]
    return float(np.mean(shares)) if shares else math.nan


def _named(people: Sequence[str], owner: NDArray[np.int64], group: int) -> list[str]:
    return [name for name, g in zip(people, owner, strict=True) if g == group]
