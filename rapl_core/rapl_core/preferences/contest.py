"""Queries that first look around and then let the best videos compete."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from rapl_core.preferences.expert_set import strengths
from rapl_core.preferences.queries import UniformQueries, sets_of
from rapl_core.types import Ranking

UNIFORM_SHARE = 0.6
"""Of the rankings wanted are asked for uniformly, before the contest."""
FIELDS = (30, 15)
"""How many of the strongest videos compete in the first and in the second half of the contest;
the expert set has ten."""
NEAR = 0.5
"""Rivals are drawn by strength, give or take up to this (log-odds), so that pairings differ."""
_TRIES = 50


class ContestQueries:
    """Uniform for 60 % of the rankings wanted, then the strongest videos among themselves.

    The robot imitates the few most preferred videos, so these should be known best; asked
    uniformly, 150 triplets of 300 videos leave it to chance which of the good ones they are
    (docs/paper_notes.md). Each query of the contest shows the competitor that has had the fewest
    turns and those nearest to it in Bradley-Terry strength. Sees rankings alone, never a return.

    :param rng: candidates follow from it.
    :param rankings: those that count so far, in the order given.
    :param wanted: rankings wanted in all; 0: not known, then every query is uniform.
    :param size: videos in a query.
    """

    def __init__(
        self, rng: np.random.Generator, rankings: Sequence[Ranking], wanted: int, size: int = 3
    ) -> None:
        self.name = "contest"
        self._rng = rng
        self._rankings = [ranking for ranking in rankings if ranking.ranks]
        self._wanted = wanted
        self._size = size
        self._uniform = UniformQueries(rng, size)

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """Return the next query; :attr:`name` then says whether it was a uniform one.

        :raises RankingError: if there are too few videos, or all combinations were asked.
        """
        past = sets_of(asked)
        field = self._field()
        known = set(episode_ids)
        strength = (
            {v: s for v, s in strengths(self._rankings).items() if v in known} if field else {}
        )
        rivals = sorted(strength, key=lambda video: (-strength[video], video))[:field]
        for _ in range(_TRIES if len(rivals) > self._size else 0):
            query = self._pairing(rivals, strength)
            if frozenset(query) not in past:
                self.name = "contest"
                return query
        self.name = "uniform"
        return self._uniform.next(episode_ids, past)

    def _field(self) -> int:
        """How many videos compete now; 0: the contest has not begun."""
        given, begins = len(self._rankings), self._begins
        if not self._wanted or given < begins:
            return 0
        return FIELDS[0] if given < (begins + self._wanted) // 2 else FIELDS[1]

    @property
    def _begins(self) -> int:
        return round(UNIFORM_SHARE * self._wanted)

    def _pairing(self, rivals: Sequence[str], strength: dict[str, float]) -> tuple[str, ...]:
        turns = Counter(v for r in self._rankings[self._begins :] for v in r.episode_ids)
        order = [rivals[int(i)] for i in self._rng.permutation(len(rivals))]
        first = min(order, key=lambda video: turns[video])
        others = [video for video in order if video != first]
        luck = self._rng.random(len(others)) * NEAR
        apart = {
            v: abs(strength[v] - strength[first]) + x for v, x in zip(others, luck, strict=True)
        }
        nearest = sorted(others, key=lambda video: apart[video])[: self._size - 1]
        shown = [first, *nearest]
        return tuple(shown[int(i)] for i in self._rng.permutation(len(shown)))
