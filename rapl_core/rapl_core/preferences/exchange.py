"""Rankings to and from JSON lines, for people and for other programs."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from rapl_core.atomic import write_atomically
from rapl_core.errors import RankingError
from rapl_core.preferences.query import Query
from rapl_core.preferences.ranking_json import ranking_from_json, ranking_to_json
from rapl_core.preferences.store import RankingStore
from rapl_core.types import Ranking


def export_jsonl(store: RankingStore, path: Path | str) -> int:
    """Write every ranking of ``store``, one a line, and return how many; atomic.

    :raises RankingError: if ``path`` cannot be written.
    """
    rankings = store.all()
    _write_lines(Path(path), (ranking_to_json(ranking) for ranking in rankings), "rankings")
    return len(rankings)


def export_queries(store: RankingStore, path: Path | str) -> int:
    """Write every query ever handed out, one a line, and return how many; atomic.

    Who was asked what, why and when, answered or not; rankings name them in ``query_id``.

    :raises RankingError: if ``path`` cannot be written.
    """
    with store.reading() as ledger:
        queries = list(ledger.queries_handed_out())
    _write_lines(Path(path), map(_query_to_json, queries), "queries")
    return len(queries)


def _query_to_json(query: Query) -> str:
    return json.dumps(asdict(query), sort_keys=True, ensure_ascii=False)


def _write_lines(path: Path, lines: Iterable[str], what: str) -> None:
    text = "".join(f"{line}\n" for line in lines)
    write_atomically(path, text, f"{what} to", error=RankingError)


def read_jsonl(path: Path | str) -> list[Ranking]:
    """Return the rankings in a file of JSON lines.

    :raises RankingError: if the file cannot be read or a line is no ranking; names the line.
    """
    rankings = []
    try:
        # Not splitlines: JSON leaves line separators such as U+2028 in a name as they are.
        lines = Path(path).read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise RankingError(f"cannot read rankings from {path}: {error}") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            rankings.append(ranking_from_json(line))
        except RankingError as error:
            raise RankingError(f"{path}, line {number}: {error}") from error
    return rankings
