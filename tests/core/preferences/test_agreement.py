"""Consistency with oneself, agreement with others, and the figures of progress."""

import math
import time
from pathlib import Path

import pytest

from rapl_core.preferences import RankingStore
from rapl_core.preferences.agreement import agreement_table
from rapl_core.preferences.progress import measure_progress
from rapl_core.types import Ranking


def given(name: str, who: str, videos: str, ranks: tuple[int, ...], **more: object) -> Ranking:
    return Ranking(name, who, tuple(videos), ranks, **more)  # type: ignore[arg-type]


def test_agreement_counts_pairs_wherever_they_were_ranked() -> None:
    table = agreement_table(
        [
            given("1", "ada", "abc", (1, 2, 3)),
            given("2", "bob", "cba", (3, 2, 1)),  # the same order, shown the other way round
            given("3", "cyd", "abd", (2, 1, 3)),  # a and b the other way, one pair in common
        ]
    )
    assert table.annotators == ("ada", "bob", "cyd")
    assert (table.share[0, 1], table.pairs[0, 1]) == (1.0, 3)
    assert (table.share[0, 2], table.pairs[0, 2]) == (0.0, 1)
    assert (table.share[1, 2], table.pairs[1, 2]) == (0.0, 1)
    assert (table.with_others("ada").value, table.with_others("ada").pairs) == (0.75, 4)
    assert (table.overall().value, table.overall().pairs) == (pytest.approx(3 / 5), 5)
    assert math.isnan(table.consistency("ada").value)


def test_consistency_compares_a_persons_answers_and_a_tie_is_half() -> None:
    table = agreement_table(
        [
            given("1", "ada", "abc", (1, 2, 3)),
            given("2", "ada", "bca", (3, 2, 1)),  # a best again, b and c exchanged
            given("3", "bob", "ab", (1, 1)),
        ]
    )
    assert (table.consistency("ada").value, table.consistency("ada").pairs) == (
        pytest.approx(2 / 3),
        3,
    )
    assert (table.with_others("bob").value, table.with_others("bob").pairs) == (0.5, 2)


def test_answers_without_an_order_say_nothing() -> None:
    table = agreement_table([given("1", "ada", "ab", (), verdict="skipped")])
    assert table.annotators == () and math.isnan(table.overall().value)


def test_progress_counts_what_counts(tmp_path: Path) -> None:
    with RankingStore(tmp_path / "r.sqlite") as store:
        store.add(given("1", "ada", "abc", (1, 2, 3), response_s=2.0, created_ns=10))
        store.add(given("2", "ada", "abd", (1, 2, 3), response_s=4.0, created_ns=20))
        store.add(given("3", "ada", "abd", (2, 1, 3), response_s=9.0, created_ns=30, replaces="2"))
        store.add(given("4", "bob", "abc", (), verdict="undecided"))
        store.add(given("5", "bob", "abe", (1, 2, 3)))
        store.undo("bob", "6", "5")
        store.lease(("a", "b", "f"), "bob", "uniform", 60)
        with store.reading() as ledger:
            progress = measure_progress(ledger, wanted=5, now_ns=time.time_ns())
    assert (progress.given, progress.needed, progress.open_queries) == (2, 3, 1)
    ada, bob = progress.annotators
    assert ada.counts == {"ranked": 2} and ada.median_response_s == 5.5 and ada.newest_ns == 30
    assert bob.counts == {"undecided": 1, "withdrawn": 1} and math.isnan(bob.consistency.value)
    assert ada.consistency.pairs == 0, "a and b came twice, but nothing was asked again"
