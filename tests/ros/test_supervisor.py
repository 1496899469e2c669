"""The supervisor on real processes: restart, limit, stop within five seconds, no orphans."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rapl_ros.node_table import NODES
from rapl_ros.recorder_node import FINISH_S
from rapl_ros.supervisor import (
    HEAD_START_S,
    STOP_PLAN,
    ProcessFailedError,
    ProcessSpec,
    Supervisor,
    describe_exit,
)

MODULES = {
    "sleeper": "import time\nprint('awake', flush=True)\ntime.sleep(600)",
    "stubborn": """
        import signal, time
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        print('deaf', flush=True)
        time.sleep(600)
        """,
    "polite": """
        import signal, sys, time
        def end(number, frame):
            print(f"told {time.monotonic()}", flush=True)
            sys.exit(0)
        signal.signal(signal.SIGINT, end)
        print('awake', flush=True)
        time.sleep(600)
        """,
    "brief": "print('done')",
    "faulty": "raise SystemExit('the cable is unplugged')",
    "shows": "import os, sys\nprint(sys.argv[1:], os.environ['COLOUR'], flush=True)",
}


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    folder = tmp_path / "modules"
    folder.mkdir()
    for name, source in MODULES.items():
        (folder / f"{name}_module.py").write_text(textwrap.dedent(source))
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def supervise(
    tmp_path: Path, environment: dict[str, str], said: list[str]
) -> Iterator[Callable[..., Supervisor]]:
    made: list[Supervisor] = []

    def make(*specs: ProcessSpec) -> Supervisor:
        supervisor = Supervisor(specs, tmp_path / "logs", environment, said.append)
        made.append(supervisor)
        supervisor.start()
        return supervisor

    yield make
    for supervisor in made:
        supervisor.stop()


def spec(name: str, **more: object) -> ProcessSpec:
    return ProcessSpec(name, f"{name}_module", **more)  # type: ignore[arg-type]


def wait_for(condition: Callable[[], bool], seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.02)


def logged(supervisor: Supervisor, name: str, text: str) -> Callable[[], bool]:
    return lambda: text in supervisor.log_path(name).read_text()


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_a_killed_process_is_restarted_and_named(
    supervise: Callable[..., Supervisor], said: list[str]
) -> None:
    supervisor = supervise(spec("sleeper"))
    wait_for(logged(supervisor, "sleeper", "awake"))
    first = supervisor.pids()["sleeper"]
    os.kill(first, signal.SIGKILL)

    def restarted() -> bool:
        supervisor.poll()
        return supervisor.pids().get("sleeper", first) != first

    wait_for(restarted)
    assert "sleeper was killed by SIGKILL; restarting it" in said[0]
    assert str(supervisor.log_path("sleeper")) in said[0]


def test_a_process_that_dies_too_often_ends_the_run_with_its_last_words(
    supervise: Callable[..., Supervisor], said: list[str]
) -> None:
    supervisor = supervise(spec("faulty", restarts=2))
    with pytest.raises(ProcessFailedError, match=r"faulty exited with code 1 (?s:.*)unplugged"):
        wait_for(lambda: bool(supervisor.poll()))
    assert len(said) == 2


def test_a_process_whose_work_ends_is_not_restarted_but_one_that_is_killed_is(
    supervise: Callable[..., Supervisor], said: list[str]
) -> None:
    supervisor = supervise(
        spec("brief", ends=True), spec("faulty", ends=True), spec("sleeper", ends=True)
    )
    assert supervisor.exit_code("sleeper") is None

    def ended() -> bool:
        supervisor.poll()
        return None not in (supervisor.exit_code("brief"), supervisor.exit_code("faulty"))

    wait_for(ended)
    supervisor.poll()
    assert (supervisor.exit_code("brief"), supervisor.exit_code("faulty")) == (0, 1)
    assert said == []
    os.kill(supervisor.pids()["sleeper"], signal.SIGKILL)
    wait_for(lambda: bool(supervisor.poll() or said))
    assert supervisor.exit_code("sleeper") is None
    assert "sleeper" in supervisor.pids()


def test_a_process_that_should_not_end_is_restarted_even_after_exit_code_0(
    supervise: Callable[..., Supervisor],
) -> None:
    supervisor = supervise(spec("brief", restarts=0))
    with pytest.raises(ProcessFailedError, match="brief exited with code 0"):
        wait_for(lambda: bool(supervisor.poll()))


def test_stop_ends_a_process_that_ignores_signals_within_five_seconds(
    supervise: Callable[..., Supervisor],
) -> None:
    supervisor = supervise(spec("sleeper"), spec("stubborn"))
    wait_for(logged(supervisor, "stubborn", "deaf"))
    wait_for(logged(supervisor, "sleeper", "awake"))
    pids = supervisor.pids()
    began = time.monotonic()
    assert supervisor.stop() == ["stubborn"]
    assert time.monotonic() - began < 5.0
    assert not any(alive(pid) for pid in pids.values())
    assert supervisor.pids() == {}


def test_the_recorder_has_the_time_that_it_asks_for() -> None:
    before_killed_s = sum(patience_s for _, patience_s in STOP_PLAN[:-1])
    assert FINISH_S + HEAD_START_S + 0.5 < before_killed_s
    assert before_killed_s + STOP_PLAN[-1][1] < 5.0
    (recorder,) = (entry for entry in NODES if entry.name == "recorder")
    assert recorder.stops_last


def test_who_keeps_what_the_others_made_is_told_last(
    supervise: Callable[..., Supervisor], environment: dict[str, str]
) -> None:
    supervisor = supervise(
        spec("polite", stops_last=True), ProcessSpec("other", "polite_module"), spec("stubborn")
    )
    for name, word in (("polite", "awake"), ("other", "awake"), ("stubborn", "deaf")):
        wait_for(logged(supervisor, name, word))
    supervisor.stop()
    told = {
        name: float(supervisor.log_path(name).read_text().split()[-1])
        for name in ("polite", "other")
    }
    assert told["polite"] - told["other"] > HEAD_START_S / 2


def test_arguments_and_environment_reach_the_module(
    supervise: Callable[..., Supervisor],
) -> None:
    supervisor = supervise(
        spec("shows", arguments=("--ros-args", "x:=1"), environment={"COLOUR": "green"}, ends=True)
    )
    wait_for(logged(supervisor, "shows", "['--ros-args', 'x:=1'] green"))


def test_children_die_with_a_supervisor_that_is_killed(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    script = textwrap.dedent(
        f"""
        import time
        from pathlib import Path
        from rapl_ros.supervisor import ProcessSpec, Supervisor
        s = Supervisor([ProcessSpec("stubborn", "stubborn_module")], Path({str(tmp_path)!r}), {{}},
                       print)
        s.start()
        while "deaf" not in s.log_path("stubborn").read_text():
            time.sleep(0.02)
        print(s.pids()["stubborn"], flush=True)
        time.sleep(600)
        """
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )
    try:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert alive(child)
    finally:
        parent.kill()
        parent.wait()
    wait_for(lambda: not alive(child), seconds=5.0)


def test_exits_are_described_in_words() -> None:
    assert describe_exit(-9) == "was killed by SIGKILL"
    assert describe_exit(3) == "exited with code 3"
