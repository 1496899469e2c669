"""What an alignment reports."""

import json
from dataclasses import replace

import pytest

from rapl_core.representations.report import wilson_interval


def test_the_interval_is_wilsons():
    # Wilson 1927; values of statsmodels.stats.proportion.proportion_confint(8, 10, method="wilson")
    assert wilson_interval(0.8, 10) == pytest.approx((0.490162, 0.943318), abs=1e-4)
    assert wilson_interval(1.0, 5)[1] == 1.0
    assert wilson_interval(0.5, 0) == (0.0, 1.0)


def test_it_is_written_as_json_with_null_for_what_is_unknown(rapl):
    report = rapl[1]
    unknown = replace(report, held_out_accuracy=float("nan"))
    content = json.loads(json.dumps(unknown.to_json(), allow_nan=False))
    assert content["held_out_accuracy"] is None
    assert len(content["history"]) == len(report.history)
    assert content["history"][0]["epoch"] == 1
