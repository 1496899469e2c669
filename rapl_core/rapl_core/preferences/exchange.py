"""Rankings to and from JSON lines, for people and for other programs."""

from pathlib import Path

from rapl_core.atomic import write_atomically
from rapl_core.errors import RankingError
from rapl_core.preferences.ranking_json import ranking_from_json, ranking_to_json
from rapl_core.preferences.store import RankingStore
from rapl_core.types import Ranking


def export_jsonl(store: RankingStore, path: Path | str) -> int:
    """Write every ranking of ``store``, one a line, and return how many; atomic.

    :raises RankingError: if ``path`` cannot be written.
    """
    rankings = store.all()
    lines = "".join(f"{ranking_to_json(ranking)}\n" for ranking in rankings)
    write_atomically(path, lines, "rankings to", error=RankingError)
    return len(rankings)


def read_jsonl(path: Path | str) -> list[Ranking]:
    """Return the rankings in a file of JSON lines.

    :raises RankingError: if the file cannot be read or a line is no ranking; names the line.
    """
    rankings = []
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
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


def import_jsonl(path: Path | str, store: RankingStore) -> int:
    """Add the rankings in ``path`` that ``store`` lacks and return how many those were.

    :raises RankingError: if a line is no ranking (nothing is added then) or is refused.
    """
    before = store.count()
    for ranking in read_jsonl(path):
        store.add_imported(ranking)
    return store.count() - before
