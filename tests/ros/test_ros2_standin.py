"""The stand-in for ros2, as a command line, on a real node in another process."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from rapl_ros.ros2_standin import path as standin_path
from rapl_ros.ros2_standin.topic import RateMeter

SUBJECT = Path(__file__).with_name("standin_subject.py")
DEADLINE_S = 30.0
COMMAND = [sys.executable, "-m", "rapl_ros.ros2_standin"]


def ros2(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )


def output(*arguments: str) -> str:
    done = ros2(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module", autouse=True)
def subject() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, str(SUBJECT)])
    try:
        deadline = time.monotonic() + DEADLINE_S
        while "/rapl/subject" not in output("node", "list").splitlines():
            assert process.poll() is None and time.monotonic() < deadline
        yield
    finally:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def test_version_says_that_it_is_a_stand_in() -> None:
    assert "stand-in" in output("--version")


def test_node_list_hides_its_own_node() -> None:
    assert output("node", "list") == "/rapl/subject\n"


def test_topic_list_shows_types_in_brackets() -> None:
    plain = output("topic", "list").splitlines()
    assert plain == sorted(plain)
    assert {"/rapl/reward", "/rapl/camera/image_raw", "/rosout"} <= set(plain)
    assert "/rapl/reward [rapl_msgs/msg/Reward]" in output("topic", "list", "-t").splitlines()
    assert int(output("topic", "list", "-c")) == len(plain)


def test_topic_info_counts_publishers() -> None:
    assert output("topic", "info", "/rapl/reward") == (
        "Type: rapl_msgs/msg/Reward\nPublisher count: 1\nSubscription count: 0\n"
    )
    assert "Reliability: BEST_EFFORT" in output("topic", "info", "-v", "/rapl/camera/image_raw")
    unknown = ros2("topic", "info", "/nowhere")
    assert (unknown.returncode, unknown.stderr) == (1, "Unknown topic '/nowhere'\n")


def test_echo_prints_yaml_in_the_order_of_the_definition_and_truncates_arrays() -> None:
    text = output("topic", "echo", "/rapl/reward", "--once")
    assert text.startswith("header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: ''\n")
    assert text.endswith("\n- 127.0\n- '...'\n---\n")
    message = yaml.safe_load(text.removesuffix("---\n"))
    assert (message["episode_id"], message["valid"], message["total"]) == ("e-1", True, -1.5)
    assert len(message["values"]) == 129
    full = output("topic", "echo", "/rapl/reward", "--once", "--full-length")
    assert yaml.safe_load(full.removesuffix("---\n"))["values"] == [float(i) for i in range(130)]


def test_echo_follows_the_publishers_quality_of_service() -> None:
    latched = output("topic", "echo", "/rapl/world_info", "--once")
    assert "task: franka_group\n" in latched
    assert "state_names:\n- x\n- y\n" in latched
    best_effort = output("topic", "echo", "/rapl/camera/image_raw", "--once", "--no-arr")
    assert "data: '<sequence type: uint8, length: 600>'\n" in best_effort
    assert "encoding: rgb8\n" in best_effort


def test_an_asked_profile_replaces_the_followed_one() -> None:
    volatile = ros2(
        "topic", "echo", "/rapl/world_info", "--qos-durability", "volatile", "--timeout", "1.5"
    )
    assert (volatile.returncode, volatile.stdout) == (0, "")


def test_echo_of_one_field() -> None:
    assert output("topic", "echo", "/rapl/reward", "--once", "--field", "total") == "-1.5\n---\n"


def test_echo_of_an_unpublished_topic_says_so() -> None:
    done = ros2("topic", "echo", "/nowhere", "--once")
    assert done.returncode == 1
    assert done.stdout == "WARNING: topic [/nowhere] does not appear to be published yet\n"
    assert done.stderr == "Could not determine the type for the passed topic\n"


def test_hz_prints_a_block_a_second_until_it_is_interrupted() -> None:
    process = subprocess.Popen(
        [*COMMAND, "topic", "hz", "/rapl/camera/image_raw"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(4)]
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(10)
    assert code == signal.SIGINT
    rate = re.fullmatch(r"average rate: (\d+\.\d{3})\n", lines[2])
    assert rate is not None and 10 < float(rate[1]) < 30
    number = r"\d+\.\d{3}s"
    detail = rf"\tmin: {number} max: {number} std dev: \d+\.\d{{5}}s window: \d+\n"
    assert re.fullmatch(detail, lines[3])


def test_the_rate_is_that_of_the_window() -> None:
    meter = RateMeter(window=2)
    assert meter.text() is None
    for now_s in (0.0, 10.0, 10.1, 10.3):
        meter.arrive(now_s)
    assert meter.text() == (
        "average rate: 6.667\n\tmin: 0.100s max: 0.200s std dev: 0.05000s window: 2"
    )


def test_param_list_indents_below_the_name_of_each_node() -> None:
    text = output("param", "list")
    assert text.startswith("/rapl/subject:\n  encoder\n")
    assert "  rate_hz\n" in text
    alone = output("param", "list", "/rapl/subject")
    assert alone == text.split("\n", 1)[1]
    assert "  rate_hz (type: double)\n" in output("param", "list", "rapl/subject", "--param-type")


def test_param_get_names_the_type() -> None:
    assert output("param", "get", "/rapl/subject", "rate_hz") == "Double value is: 2.0\n"
    assert output("param", "get", "/rapl/subject", "rate_hz", "--hide-type") == "2.0\n"
    missing = ros2("param", "get", "/rapl/subject", "colour")
    assert (missing.returncode, missing.stderr) == (1, "Parameter not set\n")


def test_param_set_succeeds_or_gives_the_nodes_reason() -> None:
    assert output("param", "set", "/rapl/subject", "encoder", "imagenet") == (
        "Set parameter successful\n"
    )
    refused = ros2("param", "set", "/rapl/subject", "encoder", "nonsense")
    assert refused.stderr == (
        "Setting parameter failed: unknown encoder 'nonsense'; known: imagenet, rapl\n"
    )
    assert output("param", "get", "/rapl/subject", "encoder") == "String value is: imagenet\n"


def test_param_describe_shows_description_and_constraints() -> None:
    assert output("param", "describe", "/rapl/subject", "encoder", "rate_hz") == (
        "Parameter name: encoder\n  Type: string\n  Description: which encoder\n  Constraints:\n"
        "Parameter name: rate_hz\n  Type: double\n  Constraints:\n    Read only: true\n"
        "    Min value: 0.5\n    Max value: 4.0\n"
    )


def test_a_missing_node_is_named_missing() -> None:
    missing = ros2("param", "get", "/nobody", "x", "--timeout", "1")
    assert (missing.returncode, missing.stderr) == (1, "Node not found\n")


def test_service_list_and_call() -> None:
    assert (
        "/rapl/subject/switch [std_srvs/srv/SetBool]"
        in output("service", "list", "-t").splitlines()
    )
    answer = output(
        "service", "call", "/rapl/subject/switch", "std_srvs/srv/SetBool", "{data: true}"
    )
    # like the real one it says so first, where discovery takes more than a second
    assert answer.removeprefix("waiting for service to become available...\n") == (
        "requester: making request: std_srvs.srv.SetBool_Request(data=True)\n\n"
        "response:\nstd_srvs.srv.SetBool_Response(success=True, message='switched to True')\n\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("std_srvs/srv/Nothing",), "The passed service type is invalid"),
        (("std_srvs/srv/SetBool", "{speed: 1}"), "Failed to populate field: .*speed"),
        (("std_srvs/srv/SetBool", "true"), "Failed to populate field: Value 'True' is expected"),
    ],
)
def test_a_bad_call_is_refused(arguments: tuple[str, ...], message: str) -> None:
    done = ros2("service", "call", "/rapl/subject/switch", *arguments)
    assert done.returncode == 1
    assert re.match(message, done.stderr)


def test_nested_messages_and_arrays_of_a_request_are_filled() -> None:
    from rapl_msgs.srv import SubmitRanking

    from rapl_ros.ros2_standin.message_text import fill

    request = SubmitRanking.Request()
    fill(request, {"ranking": {"episode_ids": ["a", "b"], "ranks": [2, 1], "response_s": 3,
                               "created": {"sec": 7}}})  # fmt: skip
    assert list(request.ranking.episode_ids) == ["a", "b"]
    assert list(request.ranking.ranks) == [2, 1]
    assert (request.ranking.response_s, request.ranking.created.sec) == (3.0, 7)


def test_interface_show_indents_nested_types_without_their_comments() -> None:
    text = output("interface", "show", "rapl_msgs/srv/SubmitRanking")
    assert text.startswith("Ranking ranking\n\tuint8 RANKED=0\n\tuint8 UNDECIDED=1\n")
    assert "\tbuiltin_interfaces/Time created\n\t\tint32 sec\n\t\tuint32 nanosec\n" in text
    assert "\n---\n" in text
    assert "#" not in output("interface", "show", "--no-comments", "rapl_msgs/msg/Reward")
    unknown = ros2("interface", "show", "nothing/msg/Here")
    assert (unknown.returncode, unknown.stderr) == (1, "Unknown package 'nothing'\n")


def test_action_list_is_empty_without_actions() -> None:
    assert output("action", "list") == ""


def test_an_unknown_verb_names_the_known_ones() -> None:
    done = ros2("bag", "record")
    assert done.returncode == 2
    assert "topic echo|hz|info|list" in done.stderr


def test_the_shell_line_makes_ros2_work_in_another_terminal(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    line = standin_path.shell_line()
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run(
        ["bash", "-c", f"{line}; ros2 node list"], env=environment, capture_output=True, text=True,
        timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert done.stdout == "/rapl/subject\n", done.stderr


def test_a_real_ros2_on_the_path_takes_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    real = tmp_path / "ros2"
    real.write_text('#!/bin/sh\necho "the real one: $*"\n')
    real.chmod(0o755)
    path = f"{standin_path.standin_folder()}:{tmp_path}:/usr/bin:/bin"
    done = subprocess.run(
        ["ros2", "topic", "list"], env={**os.environ, "PATH": path}, capture_output=True, text=True,
        timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert done.stdout == "the real one: topic list\n"
    monkeypatch.setenv("PATH", path)
    assert standin_path.real_ros2() == real
    assert str(standin_path.standin_folder()) not in standin_path.shell_line()
