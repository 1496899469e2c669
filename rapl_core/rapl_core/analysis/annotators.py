"""The people behind the rankings of a run, for the report."""

import json
import math
from dataclasses import dataclass
from typing import Any

from rapl_core.analysis.record import RunRecord
from rapl_core.errors import CorruptFileError
from rapl_core.preferences.agreement import agreement_table
from rapl_core.preferences.people import PEOPLE_FILE


@dataclass(frozen=True)
class AnnotatorRow:
    """One annotator."""

    annotator: str
    rankings: int
    consistency: float
    """NaN where nothing was asked twice."""
    agreement: float
    """NaN where nobody else ranked the same videos."""
    mistakes: float
    """NaN where it was not estimated."""
    group: str
    """Empty with one group."""


@dataclass(frozen=True)
class People:
    """All of them."""

    text: str
    rows: tuple[AnnotatorRow, ...]


def people_of(record: RunRecord) -> People:
    """Return who ranked, how well they agree, and what alignment made of it.

    :raises CorruptFileError: if what alignment wrote cannot be read.
    """
    found = _read(record)
    rankings = [ranking for ranking in record.rankings if ranking.ranks]
    table = agreement_table(rankings)
    groups = found.get("groups", [])
    rows = []
    for name in table.annotators:
        group = next((i for i, g in enumerate(groups, 1) if name in g["annotators"]), 0)
        estimated = groups[group - 1]["mistakes"].get(name) if group else None
        rows.append(
            AnnotatorRow(
                annotator=name,
                rankings=sum(ranking.annotator == name for ranking in rankings),
                consistency=table.consistency(name).value,
                agreement=table.with_others(name).value,
                mistakes=math.nan if estimated is None else float(estimated),
                group=str(group) if len(groups) > 1 and group else "",
            )
        )
    return People(str(found.get("text", "")), tuple(rows))


def _read(record: RunRecord) -> dict[str, Any]:
    path = record.folder / PEOPLE_FILE
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CorruptFileError(f"cannot read {path}: {error}") from error
    return found if isinstance(found, dict) else {}
