"""Rankings to and from Parquet, for data frames: the columns are the fields of a Ranking."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from rapl_core.atomic import write_atomically
from rapl_core.errors import RankingError
from rapl_core.preferences.ranking_json import ranking_from_values, ranking_to_values
from rapl_core.preferences.store import RankingStore
from rapl_core.types import Ranking

SCHEMA = pa.schema(
    [
        ("ranking_id", pa.string()),
        ("annotator", pa.string()),
        ("episode_ids", pa.list_(pa.string())),
        ("ranks", pa.list_(pa.int32())),
        ("verdict", pa.string()),
        ("query_id", pa.string()),
        ("response_s", pa.float64()),
        ("created_ns", pa.int64()),
        ("replaces", pa.string()),
        ("shown_ns", pa.int64()),
        ("source", pa.string()),
    ]
)


def export_parquet(store: RankingStore, path: Path | str) -> int:
    """Write every ranking of ``store``, one a row in the order stored, and return how many; atomic.

    :raises RankingError: if ``path`` cannot be written.
    """
    rows = [ranking_to_values(ranking) for ranking in store.all()]
    content = pa.BufferOutputStream()
    pq.write_table(  # type: ignore[no-untyped-call]
        pa.Table.from_pylist(rows, schema=SCHEMA), content
    )
    write_atomically(path, content.getvalue().to_pybytes(), "rankings to", error=RankingError)
    return len(rows)


def read_parquet(path: Path | str) -> list[Ranking]:
    """Return the rankings in a Parquet file.

    :raises RankingError: if the file cannot be read or a row is no ranking; names the row.
    """
    try:
        rows = pq.read_table(path).to_pylist()  # type: ignore[no-untyped-call]
    except (OSError, pa.ArrowException) as error:
        raise RankingError(f"cannot read rankings from {path}: {error}") from error
    rankings = []
    for number, row in enumerate(rows, start=1):
        try:
            rankings.append(ranking_from_values(row))
        except RankingError as error:
            raise RankingError(f"{path}, row {number}: {error}") from error
    return rankings
