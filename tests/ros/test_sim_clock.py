"""Simulation time only goes forward."""

import json
import time

import pytest

from rapl_core.errors import RaplError
from rapl_ros import sim_clock
from rapl_ros.sim_clock import SimClock


def test_instants_are_one_period_apart(tmp_path):
    clock = SimClock(tmp_path / "deep" / "clock.json", 0.08)
    stamps = [clock.advance() for _ in range(5)]
    assert {late - early for early, late in zip(stamps, stamps[1:], strict=False)} == {80_000_000}
    assert clock.now_ns == stamps[-1]


def test_it_begins_at_the_wall_clock(tmp_path):
    assert 0 <= SimClock(tmp_path / "clock.json", 0.08).now_ns - time.time_ns() < 2e9


def test_a_restart_goes_on_later_even_if_it_ran_faster_than_the_wall_clock(tmp_path):
    file = tmp_path / "clock.json"
    first = SimClock(file, 60.0)
    for _ in range(1000):  # 16 simulated hours within a moment
        last = first.advance()
    assert last > time.time_ns() + 10 * 3600 * 10**9
    assert SimClock(file, 60.0).advance() > last  # and nothing was closed: as after kill -9


def test_the_file_is_written_once_a_simulated_hour(tmp_path, monkeypatch):
    writes = []
    dumps = json.dumps
    monkeypatch.setattr(sim_clock.json, "dumps", lambda x: (writes.append(x), dumps(x))[1])
    clock = SimClock(tmp_path / "clock.json", 1.0)
    for _ in range(2 * 3600 + 10):
        clock.advance()
    assert len(writes) == 3


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"reserved_until_ns": "soon"}'])
def test_a_damaged_file_is_named_and_not_ignored(tmp_path, content):
    file = tmp_path / "clock.json"
    file.write_text(content)
    with pytest.raises(RaplError, match="clock.json"):
        SimClock(file, 0.08)


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RaplError, match="cannot write simulation time|does not say"):
        SimClock(tmp_path / "file" / "clock.json", 0.08)
