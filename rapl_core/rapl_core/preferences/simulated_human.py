"""A human whose preferences are known: ranks videos by the human's true returns.

The ways to err are those of B-Pref (Lee et al. 2021): rationality beta, myopia, mistakes, skipping
and equality, carried over from two videos to rankings.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.types import Verdict

MistakeKind = Literal["neighbours", "any"]


class Answer(NamedTuple):
    """What a human says about the videos of a query."""

    verdict: Verdict
    ranks: tuple[int, ...]
    """1 = best, equal numbers tie; empty unless ranked."""


@dataclass(frozen=True)
class HumanKnobs:
    """How a simulated human errs; without them it never does, like the paper's."""

    beta: float = math.inf
    """Rationality, in units of 1 / return: the smaller, the more random. inf: never errs."""
    myopia: float = field(default=1.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Weight of a step relative to the next one, B-Pref's gamma: below 1 the end of a video counts
    more than its start. 1: all steps count the same."""
    mistakes: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of rankings that are wrong."""
    mistake_kind: MistakeKind = "neighbours"
    """neighbours: two neighbours are exchanged. any: another order at random."""
    equal_threshold: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1e9})
    """Videos whose returns differ by at most this are ranked equal."""
    skip: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of queries that are not answered."""
    skip_below: float = -math.inf
    """A query in which no video's return reaches this is not answered: nothing to like."""

    def __post_init__(self) -> None:
        for name in ("mistakes", "skip", "myopia"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise RankingError(f"{name} is {value}, expected a number in [0, 1]")
        if self.mistake_kind not in get_args(MistakeKind):
            raise UnknownNameError("kind of mistake", self.mistake_kind, get_args(MistakeKind))
        if not self.beta > 0:
            raise RankingError(f"beta is {self.beta}, expected more than 0")
        if not self.equal_threshold >= 0:
            raise RankingError(f"equal_threshold is {self.equal_threshold}, expected 0 or more")


def knobs_from(text: str) -> HumanKnobs:
    """Read ``beta=2,mistakes=0.1``; the empty text is a human who never errs.

    :raises UnknownNameError: naming the known knobs.
    :raises RankingError: if a value is not what its knob takes.
    """
    known = {knob.name: type(getattr(HumanKnobs(), knob.name)) for knob in fields(HumanKnobs)}
    values: dict[str, Any] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = part.partition("=")
        if name not in known:
            raise UnknownNameError("knob of the simulated human", name, known)
        try:
            values[name] = known[name](value)
        except ValueError as error:
            raise RankingError(f"knob {name} is {value!r}, expected a number") from error
    return HumanKnobs(**values)


class SimulatedHuman:
    """Ranks by the sum of r*.

    :param rng: the errors follow from it.
    :param knobs: how it errs, as a whole or by their names (``beta=2.0``).
    """

    def __init__(
        self, rng: np.random.Generator, knobs: HumanKnobs | None = None, **by_name: float
    ) -> None:
        self._rng = rng
        self.knobs = knobs or HumanKnobs(**by_name)  # type: ignore[arg-type]

    def utility(self, rewards: NDArray[np.float64]) -> float:
        """Return of a video as this human feels it: later steps count more where it is myopic.

        :param rewards: (T,) r* of the states arrived in.
        """
        ages = np.arange(len(rewards))[::-1]  # steps before the end
        return float((self.knobs.myopia**ages * rewards).sum())

    def rank(self, returns: Sequence[float]) -> tuple[int, ...]:
        """Return the rank of each video, 1 = best, equal numbers tie.

        :param returns: the human's return of each video, as shown.
        :raises RankingError: if a return is NaN: the truth is unknown.
        """
        utilities = np.asarray(returns, dtype=np.float64)  # (n,)
        if not np.all(np.isfinite(utilities)):
            raise RankingError(f"cannot rank by the returns {list(returns)}: the truth is unknown")
        if np.isfinite(self.knobs.beta):
            # Sorting utilities plus Gumbel noise draws from Plackett-Luce.
            utilities = utilities + self._rng.gumbel(size=len(utilities)) / self.knobs.beta
        order = np.argsort(-utilities, kind="stable")
        ranks = np.empty(len(utilities), dtype=np.int64)
        leader, place = utilities[order[0]], 1
        for position, video in enumerate(order, start=1):
            if leader - utilities[video] > self.knobs.equal_threshold:
                leader, place = utilities[video], position
            ranks[video] = place
        if self.knobs.mistakes > 0 and self._rng.random() < self.knobs.mistakes:
            ranks = self._mistaken(ranks, order)
        return tuple(int(rank) for rank in ranks)

    def answer(self, returns: Sequence[float]) -> Answer:
        """Return a ranking of the videos; now and then none, if made to skip."""
        if self.knobs.skip > 0 and self._rng.random() < self.knobs.skip:
            return Answer("skipped", ())
        if returns and max(returns) < self.knobs.skip_below:
            return Answer("skipped", ())
        return Answer("ranked", self.rank(returns))

    def _mistaken(self, ranks: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.int64]:
        wrong = ranks.copy()
        if self.knobs.mistake_kind == "neighbours":
            first = int(self._rng.integers(len(order) - 1))
            a, b = order[first], order[first + 1]
            wrong[a], wrong[b] = ranks[b], ranks[a]
            return wrong
        if len(set(ranks.tolist())) == 1:
            return wrong  # all equal: there is no other order of these ranks
        while np.array_equal(wrong, ranks):
            wrong = ranks[self._rng.permutation(len(ranks))]
        return wrong
