"""How far people agree with themselves and with each other, pair of videos by pair of videos."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rapl_core.types import Ranking

VideoPair = tuple[str, str]
"""Two episode ids in the order of their names."""

Signs = Mapping[VideoPair, Mapping[str, tuple[int, ...]]]
"""By pair and annotator, an entry an answer: 1 the first is better, -1 the second, 0 a tie."""


@dataclass(frozen=True)
class Share:
    """So many of so many."""

    value: float
    """In [0, 1]; NaN of none."""
    pairs: int


@dataclass(frozen=True)
class AgreementTable:
    """Each annotator against each other one."""

    annotators: tuple[str, ...]
    share: NDArray[np.float64]
    """(A, A) of pairs that both ranked, those ordered alike; NaN without any; the diagonal is
    consistency, of the same videos asked again."""
    pairs: NDArray[np.int64]
    """(A, A) comparisons behind it."""

    def consistency(self, annotator: str) -> Share:
        """Of an annotator with the same one's earlier answers."""
        i = self.annotators.index(annotator)
        return Share(float(self.share[i, i]), int(self.pairs[i, i]))

    def with_others(self, annotator: str) -> Share:
        """Of an annotator with all others together, by pairs."""
        i = self.annotators.index(annotator)
        others = np.arange(len(self.annotators)) != i
        return _mean(self.share[i, others], self.pairs[i, others])

    def overall(self) -> Share:
        """Over all pairs of different annotators."""
        upper = np.triu_indices(len(self.annotators), 1)
        return _mean(self.share[upper], self.pairs[upper])


def pair_signs(rankings: Iterable[Ranking]) -> Signs:
    """Return who ordered which two videos how; unranked answers say nothing."""
    found: defaultdict[VideoPair, defaultdict[str, list[int]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for ranking in rankings:
        if not ranking.ranks:
            continue
        ranked = sorted(zip(ranking.episode_ids, ranking.ranks, strict=True))
        for (first, rank), (second, other) in combinations(ranked, 2):
            found[first, second][ranking.annotator].append((other > rank) - (other < rank))
    return {
        pair: {name: tuple(signs) for name, signs in people.items()}
        for pair, people in found.items()
    }


def agreement_table(rankings: Iterable[Ranking]) -> AgreementTable:
    """Return how far each annotator agrees with each, and with their own repeated answers.

    Two answers about a pair agree to 1 if they order it alike or both tie, to 1/2 if one of them
    ties, to 0 if they contradict. Between people pairs count wherever both were ranked, in the same
    query or not; consistency is of the same videos asked again.

    :param rankings: those that count (:meth:`RankingStore.effective`).
    """
    rankings = [ranking for ranking in rankings if ranking.ranks]
    names = tuple(sorted({ranking.annotator for ranking in rankings}))
    number = {name: i for i, name in enumerate(names)}
    alike = np.zeros((len(names), len(names)))
    pairs = np.zeros((len(names), len(names)), dtype=np.int64)
    for people in pair_signs(rankings).values():
        for (name, signs), (other, others) in combinations(people.items(), 2):
            i, j = number[name], number[other]
            likeness = sum(_likeness(sign, second) for sign in signs for second in others)
            for place in ((i, j), (j, i)):
                alike[place] += likeness
                pairs[place] += len(signs) * len(others)
    for name, repeated in _repeats(rankings):
        i = number[name]
        for own in pair_signs(repeated).values():
            for first, second in combinations(own[name], 2):
                alike[i, i] += _likeness(first, second)
                pairs[i, i] += 1
    with np.errstate(invalid="ignore"):
        return AgreementTable(names, alike / pairs, pairs)


def _repeats(rankings: Iterable[Ranking]) -> list[tuple[str, list[Ranking]]]:
    """Annotators' answers about the same videos, where there are several."""
    found: defaultdict[tuple[str, frozenset[str]], list[Ranking]] = defaultdict(list)
    for ranking in rankings:
        found[ranking.annotator, frozenset(ranking.episode_ids)].append(ranking)
    return [(name, answers) for (name, _), answers in found.items() if len(answers) > 1]


def _likeness(sign: int, other: int) -> float:
    return 1.0 - abs(sign - other) / 2


def _mean(share: NDArray[np.float64], pairs: NDArray[np.int64]) -> Share:
    total = int(pairs.sum())
    if total == 0:
        return Share(math.nan, 0)
    return Share(float(np.nansum(share * pairs) / total), total)
