"""Starts the processes of a run, restarts one that dies, and ends them all within seconds."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rapl_core.errors import RaplError

UNFINISHED = 128 + signal.SIGTERM
"""Exit code of a process that ends when its work is done, and was told to end before."""
RESTART_LIMIT = 3
"""Restarts of one node before the run is given up; see RESTART_MEMORY_S."""
RESTART_MEMORY_S = 600.0
"""A restart longer ago than this is forgotten."""
STOP_PLAN = ((signal.SIGINT, 2.4), (signal.SIGTERM, 1.1), (signal.SIGKILL, 1.0))
"""What a process is sent to end it, and for how many seconds it may then take."""
HEAD_START_S = 0.3
"""For so long the others end before one that stops last; it has 3.2 s then before it is killed."""


class ProcessFailedError(RaplError):
    """A process died too often, or one that must not die did."""


@dataclass(frozen=True)
class ProcessSpec:
    """One process of the run."""

    name: str
    module: str
    """Python module with a ``main``, run as ``python -m``."""
    arguments: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    restarts: int = RESTART_LIMIT
    ends: bool = False
    """True for a process that exits when its work is done; only a signal's victim is restarted,
    also one that was asked to end and says so by UNFINISHED."""
    stops_last: bool = False
    """True for a process that keeps what the others made."""


@dataclass
class _Running:
    spec: ProcessSpec
    process: subprocess.Popen[bytes]
    restarted_at: list[float]
    exit_code: int | None = None


class Supervisor:
    """Owns the processes of one run; call :meth:`poll` several times a second.

    :param specs: what to start, in this order.
    :param log_folder: one ``<name>.log`` per process, appended to.
    :param environment: added to this process's own for all of them.
    :param say: told in one line about every death and restart.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        log_folder: Path,
        environment: Mapping[str, str],
        say: Callable[[str], None],
    ) -> None:
        self._specs = tuple(specs)
        self._log_folder = log_folder
        self._environment = dict(environment)
        self._say = say
        self._running: dict[str, _Running] = {}

    def start(self) -> None:
        """Start every process."""
        self._log_folder.mkdir(parents=True, exist_ok=True)
        for spec in self._specs:
            self._running[spec.name] = _Running(spec, self._spawn(spec), [])

    def log_path(self, name: str) -> Path:
        """Return where the process ``name`` logs."""
        return self._log_folder / f"{name}.log"

    def pids(self) -> dict[str, int]:
        """Return the process id of each live process."""
        return {
            name: running.process.pid
            for name, running in self._running.items()
            if running.process.poll() is None
        }

    def exit_code(self, name: str) -> int | None:
        """Return with what ``name``, a process that ends, has exited; None while it has not."""
        return self._running[name].exit_code

    def poll(self) -> None:
        """Restart what died.

        :raises ProcessFailedError: if something died that may not be restarted (any more); the
            message says what, why and where its log is.
        """
        for running in self._running.values():
            code = running.process.poll()
            if code is None or running.exit_code is not None:
                continue
            if running.spec.ends and code >= 0 and code != UNFINISHED:
                running.exit_code = code
                continue
            self._restart(running, code)

    def stop(self) -> list[str]:
        """End every process: SIGINT, then SIGTERM, then SIGKILL.

        :return: names of the processes that had to be killed.
        """
        killed: list[str] = []
        for number, patience_s in STOP_PLAN:
            alive = self._alive()
            if not alive:
                break
            deadline = time.monotonic() + patience_s
            last = [running for running in alive if running.spec.stops_last]
            for running in alive:
                if running not in last:
                    _signal_group(running.process, number)
            if number == signal.SIGINT and last:
                self._wait_for_others(last)
            for running in last:
                _signal_group(running.process, number)
            if number == signal.SIGKILL:
                killed = [running.spec.name for running in alive]
            while self._alive() and time.monotonic() < deadline:
                time.sleep(0.02)
        return killed

    def _wait_for_others(self, last: Sequence[_Running]) -> None:
        deadline = time.monotonic() + HEAD_START_S
        while len(self._alive()) > len(last) and time.monotonic() < deadline:
            time.sleep(0.02)

    def _alive(self) -> list[_Running]:
        return [r for r in self._running.values() if r.process.poll() is None]

    def _restart(self, running: _Running, code: int) -> None:
        now = time.monotonic()
        running.restarted_at = [t for t in running.restarted_at if now - t < RESTART_MEMORY_S]
        name, how = running.spec.name, describe_exit(code)
        if len(running.restarted_at) >= running.spec.restarts:
            times = (
                f" for the {len(running.restarted_at) + 1}. time" if running.restarted_at else ""
            )
            raise ProcessFailedError(
                f"{name} {how}{times}; its log: {self.log_path(name)}{self.last_lines(name)}"
            )
        self._say(f"{name} {how}; restarting it (log: {self.log_path(name)})")
        _signal_group(running.process, signal.SIGKILL)  # children it may have left behind
        running.restarted_at.append(now)
        running.process = self._spawn(running.spec)

    def last_lines(self, name: str, lines: int = 6) -> str:
        """Return the end of a process's log, each line on a new one, indented."""
        try:
            tail = self.log_path(name).read_text(errors="replace").rstrip().splitlines()[-lines:]
        except OSError:
            return ""
        return "".join(f"\n    {line}" for line in tail)

    def _spawn(self, spec: ProcessSpec) -> subprocess.Popen[bytes]:
        command = [
            sys.executable,
            "-m",
            "rapl_ros.tethered",
            str(os.getpid()),
            spec.module,
            *spec.arguments,
        ]
        with self.log_path(spec.name).open("ab") as log:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **self._environment, **spec.environment},
                # Ctrl-C in the terminal must reach the supervisor alone.
                start_new_session=True,
            )


def describe_exit(code: int) -> str:
    """Return ``exited with code 3`` or ``was killed by SIGKILL`` for a Popen return code."""
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    if code == UNFINISHED:
        return "was told to end before its work was done"
    return f"exited with code {code}"


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        pass  # it and its children are gone
