"""Rankings and queries as lines of JSON: out of one store and into another."""

import json
from pathlib import Path

import pytest
from rankings import ranking

from rapl_core.errors import RankingError
from rapl_core.preferences import RankingStore, export_jsonl, export_queries, read_jsonl


def test_an_export_brings_everything_into_another_store(tmp_path: Path) -> None:
    with RankingStore(tmp_path / "one.sqlite") as one, RankingStore(tmp_path / "two.sqlite") as two:
        query = one.lease(("a", "b", "c"), "ada", "uniform", 60)
        one.add(ranking("r1", query_id=query.query_id))
        one.add(ranking("r2", replaces="r1", response_s=1.25))
        one.add(ranking("r3", ranks=(), verdict="skipped"))
        lines = tmp_path / "rankings.jsonl"
        assert export_jsonl(one, lines) == 3
        for _ in range(2):
            for row in read_jsonl(lines):
                two.add_imported(row)
        assert two.count() == 3
        export_jsonl(two, tmp_path / "again.jsonl")
        assert export_queries(one, tmp_path / "queries.jsonl") == 1
    assert (tmp_path / "again.jsonl").read_text() == lines.read_text()
    (asked,) = (tmp_path / "queries.jsonl").read_text().splitlines()
    assert json.loads(asked)["query_id"] == query.query_id
    assert json.loads(asked)["episode_ids"] == ["a", "b", "c"]


def test_a_name_with_a_line_separator_in_it_is_read_back(tmp_path: Path) -> None:
    given = ranking(response_s=1.0, annotator="anna\u2028\x85b")
    with RankingStore(tmp_path / "r.sqlite") as store:
        store.add(given)
        export_jsonl(store, tmp_path / "r.jsonl")
    assert read_jsonl(tmp_path / "r.jsonl") == [given]


ABC = '{"ranking_id": "r", "annotator": "a", "episode_ids": ["a", "b", "c"], '


def test_what_another_program_does_not_know_is_null(tmp_path: Path) -> None:
    path = tmp_path / "rankings.jsonl"
    unknown = ("query_id", "replaces", "source", "created_ns", "shown_ns", "response_s")
    nulls = ", ".join(f'"{name}": null' for name in unknown)
    path.write_text(ABC + '"ranks": [1, 2, 3], ' + nulls + "}")
    (found,) = read_jsonl(path)
    assert (found.query_id, found.replaces, found.source) == ("", "", "")
    assert (found.created_ns, found.shown_ns) == (0, 0)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("{", "not JSON"),
        ("[]", "is a JSON object"),
        ('{"ranking_id": "r"}', "lacks the field 'annotator'"),
        ('{"rank": 1}', "unknown fields rank"),
        (
            '{"ranking_id": "r", "annotator": "a", "episode_ids": ["a", "a"], "ranks": [1, 2]}',
            "repeats a",
        ),
        (
            '{"ranking_id": "r", "annotator": "a", "episode_ids": 3, "ranks": [1, 2]}',
            "of the wrong kind",
        ),
        (ABC + '"ranks": [1.9, 2.2, 3]}', r"a rank is 1\.9, expected a whole number"),
        (ABC + '"ranks": [true, 2, 3]}', "a rank is True"),
        (ABC + '"ranks": [1, 2, 3], "created_ns": 1e30}', r"created_ns is 1e\+30"),
        (ABC + '"ranks": [1, 2, 3], "created_ns": 9223372036854775808}', "created_ns is 9223"),
        (ABC + '"ranks": [1, 2, 3], "shown_ns": -1}', "shown_ns is -1"),
        (ABC + '"ranks": [1, 2, 3], "query_id": 5}', "query_id is 5, expected text"),
    ],
)
def test_a_bad_line_is_named_with_its_number(tmp_path: Path, line: str, complaint: str) -> None:
    path = tmp_path / "rankings.jsonl"
    path.write_text(f"\n{line}\n")
    with pytest.raises(RankingError, match=f"rankings.jsonl, line 2: .*{complaint}"):
        read_jsonl(path)
