"""What the terminal shows: lines, rates, the time left, and where a run's graph lives."""

import io
import math
import socket

import pytest

from rapl_ros.console import Console, clock, stage_line
from rapl_ros.domain import DOMAINS, free_domain, graph_environment, is_free
from rapl_ros.node_table import NODES, process_specs, ros_arguments
from rapl_ros.progress import ProgressMeter, StageProgress, count_in, count_words
from rapl_ros.run_config import RunConfig


def progress(status: str = "running", done: int = 50, detail: str = "") -> StageProgress:
    return StageProgress(
        "train",
        4,
        6,
        status,
        done,
        200,
        "steps",
        25.0,
        6.0,
        detail,  # type: ignore[arg-type]
    )


def test_a_line_has_bar_count_rate_and_time_left() -> None:
    line = stage_line(progress(detail="success 30%"))
    assert line.startswith("4/6 train")
    assert line.count("█") == 5 and line.count("░") == 15
    for words in ("50/200 steps", "25 steps/s", "0:06 left", "success 30%"):
        assert words in line
    assert "waiting: for learner" in stage_line(progress("waiting", detail="for learner"))
    assert "failed: no weights" in stage_line(progress("failed", detail="no weights"))
    assert "done" in stage_line(progress("done", 200)) and "left" not in stage_line(
        progress("done", 200)
    )


def test_a_terminal_rewrites_its_line_and_a_file_gets_few_plain_ones() -> None:
    screen, file = io.StringIO(), io.StringIO()
    for stream, terminal in ((screen, True), (file, False)):
        console = Console(stream, terminal)
        for done in (10, 20, 30):
            console.show(progress(done=done))
        console.say("simulator was killed")
        console.show(progress("done", 200))
        console.show(progress("done", 200))
    assert screen.getvalue().count("\r") == 4
    assert "\nsimulator was killed\n" in screen.getvalue()
    lines = file.getvalue().splitlines()
    assert len(lines) == 3 and "\r" not in file.getvalue() and "█" not in file.getvalue()


def test_the_rate_counts_what_this_process_did_and_gives_the_time_left() -> None:
    now = [0.0]
    meter = ProgressMeter("train", 4, 6, clock=lambda: now[0])
    first = meter.at(1000, 2000, "steps")
    assert first.rate_hz == 0.0 and math.isnan(first.remaining_s)
    now[0] = 10.0
    later = meter.at(1500, 2000, "steps")
    assert later.rate_hz == pytest.approx(50.0)
    assert later.remaining_s == pytest.approx(10.0)
    assert meter.ended("done").done == 2000
    assert meter.ended("failed", "no").done == 1500


@pytest.mark.parametrize(("seconds", "text"), [(0, "0:00"), (65, "1:05"), (3725, "1:02:05")])
def test_times_read_as_on_a_clock(seconds: float, text: str) -> None:
    assert clock(seconds) == text


def test_the_users_domain_is_honoured_and_else_a_free_one_taken(tmp_path) -> None:
    mine = graph_environment(tmp_path, {"ROS_DOMAIN_ID": "77", "OMP_NUM_THREADS": "4"})
    assert mine["ROS_DOMAIN_ID"] == "77" and mine["OMP_NUM_THREADS"] == "4"
    other = graph_environment(tmp_path, {})
    assert int(other["ROS_DOMAIN_ID"]) in DOMAINS
    assert other["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_a_domain_in_use_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    taken, other = [domain for domain in DOMAINS if is_free(domain)][:2]
    monkeypatch.setattr("rapl_ros.domain.DOMAINS", (taken, other))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("", 7410 + 250 * taken + 2))  # the first process has left, the second has not
        assert free_domain() == other


def test_each_node_gets_its_parameters_in_the_form_that_ros_reads(tmp_path) -> None:
    specs = {spec.name: spec for spec in process_specs(RunConfig("franka_group", seed=3), tmp_path)}
    assert set(specs) == {entry.name for entry in NODES} - {"web"}
    assert 'task:="franka_group"' in specs["simulator"].arguments
    assert "seed:=3" in specs["learner"].arguments
    assert 'source:="embedding"' in specs["ot_reward"].arguments
    truth = process_specs(RunConfig("franka_group", reward="ground_truth"), tmp_path)
    assert any('source:="human_reward"' in spec.arguments for spec in truth)
    people = process_specs(RunConfig("franka_group", human="web"), tmp_path)
    assert {spec.name for spec in people} == {entry.name for entry in NODES} - {"simulated_human"}
    watched = process_specs(RunConfig("franka_group"), tmp_path, web_host="0.0.0.0")
    assert 'host:="0.0.0.0"' in next(spec for spec in watched if spec.name == "web").arguments
    assert ros_arguments({"a": True, "b": 0.5}) == ("--ros-args", "-p", "a:=true", "-p", "b:=0.5")


def test_a_count_is_read_out_of_a_heartbeat_and_another_unit_has_its_own_rate() -> None:
    words = count_words("reads features", 3, 12, "videos")
    assert words == "reads features: 3 of 12 videos"
    assert count_in(words) == ("reads features", 3, 12, "videos")
    assert count_in("12 videos, 3 rankings") is None
    now = [0.0]
    meter = ProgressMeter("align", 3, 6, clock=lambda: now[0])
    meter.at(0, 12, "videos")
    now[0] = 2.0
    assert meter.at(12, 12, "videos").rate_hz == 6.0
    assert meter.at(1, 40, "epochs").rate_hz == 0.0
    now[0] = 3.0
    assert meter.at(5, 40, "epochs").rate_hz == 4.0
