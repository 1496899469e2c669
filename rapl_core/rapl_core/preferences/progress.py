"""How far the asking is: rankings given and needed still, and how each annotator gets on."""

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np

from rapl_core.preferences.agreement import AgreementTable, Share, agreement_table
from rapl_core.preferences.ledger import Ledger
from rapl_core.types import Verdict


@dataclass(frozen=True)
class AnnotatorProgress:
    """One annotator."""

    annotator: str
    counts: dict[Verdict, int]
    """Rows that count by verdict, and those withdrawn."""
    consistency: Share
    """With the same person's earlier answers."""
    agreement: Share
    """With all others."""
    median_response_s: float
    """NaN when unknown."""
    newest_ns: int
    """Wall clock of the newest ranking."""


@dataclass(frozen=True)
class RankingProgress:
    """All annotators."""

    wanted: int
    """0: no number was set."""
    given: int
    """Rankings that count: ranked, not corrected or taken back."""
    open_queries: int
    agreement: Share
    """Over all pairs of different annotators."""
    annotators: tuple[AnnotatorProgress, ...]

    @property
    def needed(self) -> int:
        """Rankings still wanted."""
        return needed(self.wanted, self.given)


def needed(wanted: int, given: int) -> int:
    """Rankings still wanted; none when no number was set."""
    return max(0, wanted - given)


def measure_progress(
    ledger: Ledger, wanted: int, now_ns: int, table: AgreementTable | None = None
) -> RankingProgress:
    """Return how far the asking is.

    :param wanted: rankings wanted in all; 0: no number was set.
    :param table: agreement measured a moment ago; None: measure it, which takes most of a second
        for 10,000 rankings, the rest some hundredths.
    """
    effective = list(ledger.effective())
    if table is None:
        table = agreement_table(effective)
    counts: defaultdict[str, Counter[Verdict]] = defaultdict(Counter)
    times: defaultdict[str, list[float]] = defaultdict(list)
    newest: dict[str, int] = {}
    for ranking in effective:
        counts[ranking.annotator][ranking.verdict] += 1
        if np.isfinite(ranking.response_s):
            times[ranking.annotator].append(ranking.response_s)
    for ranking in ledger.rankings:
        newest[ranking.annotator] = max(newest.get(ranking.annotator, 0), ranking.created_ns)
        if ranking.verdict == "withdrawn":
            counts[ranking.annotator]["withdrawn"] += 1
    nothing = Share(float("nan"), 0)
    people = []
    for name in ledger.annotators():
        ranked = name in table.annotators
        people.append(
            AnnotatorProgress(
                annotator=name,
                counts=dict(counts[name]),
                consistency=table.consistency(name) if ranked else nothing,
                agreement=table.with_others(name) if ranked else nothing,
                median_response_s=float(np.median(times[name])) if times[name] else float("nan"),
                newest_ns=newest[name],
            )
        )
    return RankingProgress(
        wanted=wanted,
        given=ledger.given(),
        open_queries=len(ledger.open_queries(now_ns)),
        agreement=table.overall(),
        annotators=tuple(people),
    )
