"""``./run_all.sh TASK``: the main job from an empty folder to a report, on a graph of its own."""

import os
import shlex
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from rapl_core.errors import RaplError
from rapl_ros.console import Console
from rapl_ros.domain import graph_environment
from rapl_ros.options import RunRequest, build_parser, listing, parse
from rapl_ros.run_config import WEB_ADDRESS_FILE, check_writable, save_config, where
from rapl_ros.run_lock import RunLock
from rapl_ros.supervisor import Supervisor, describe_exit

POLL_S = 0.1
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED = 130
"""Exit code after Ctrl-C, as a shell has it."""


class _Interrupt:
    """Notes a signal instead of raising in the middle of something."""

    def __init__(self) -> None:
        self.number = 0
        for number in SIGNALS:
            signal.signal(number, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.number = number


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(arguments):
        build_parser().print_help()
        return 0
    from rapl_core.tasks import get_task, task_names

    if "--list" in arguments:
        print(listing({name: get_task(name).title for name in task_names()}))
        return 0
    request = parse(arguments, task_names(), Path("runs"))
    console = Console(sys.stdout)
    try:
        check_writable(request.folder)
        with RunLock(request.folder):
            return run(request, console)
    except RaplError as error:
        print(f"./run_all.sh: {error}", file=sys.stderr)
        return 1


def run(request: RunRequest, console: Console) -> int:
    """Start the graph, show its progress until the conductor ends, end the graph.

    :return: 0 when every stage is done, 1 when one failed, 130 after Ctrl-C.
    """
    interrupt = _Interrupt()
    environment = graph_environment(request.folder)
    os.environ.update(environment)
    # These import rclpy, which reads the environment; --help and --list do without.
    from rapl_ros.node_table import process_specs, resolved_parameters
    from rapl_ros.progress_view import ProgressView
    from rapl_ros.summary import summary

    config, folder, host = request.config, request.folder, request.web_host
    save_config(config, folder, resolved_parameters(config, folder, environment, host))
    (folder / WEB_ADDRESS_FILE).unlink(missing_ok=True)
    supervisor = Supervisor(
        process_specs(config, folder, host), folder / "logs", environment, console.say
    )
    console.say(_greeting(request, environment))
    code = 1
    view = ProgressView(console)
    try:
        supervisor.start()
        code = _watch(supervisor, view, interrupt, request, console)
    except RaplError as error:
        console.say(f"The run ends: {error}")
    finally:
        began_s = time.monotonic()
        stubborn = supervisor.stop()
        view.close()
        if stubborn:
            console.say(f"had to be killed: {', '.join(stubborn)}")
    if interrupt.number:
        console.say(
            f"Stopped in {time.monotonic() - began_s:.1f} s. Go on with:\n"
            f"  ./run_all.sh --resume {shlex.quote(str(request.folder))}"
        )
    console.say(summary(request.folder))
    return code


def _watch(
    supervisor: Supervisor,
    view: "ProgressView",  # noqa: F821
    interrupt: _Interrupt,
    request: RunRequest,
    console: Console,
) -> int:
    """Supervise until the conductor has ended (and beyond, if asked) or a signal came."""
    told, page = False, ""
    while not interrupt.number:
        supervisor.poll()
        view.spin(POLL_S)
        page = tell_page(request, page, console)
        code = supervisor.exit_code("conductor")
        if code is None or told:
            continue
        if code != 0:
            log = f"{supervisor.log_path('conductor')}{supervisor.last_lines('conductor')}"
            raise RaplError(f"the conductor {describe_exit(code)}; its log: {log}")
        if not request.keep_running:
            return code
        console.say("All stages are done; the graph keeps running until Ctrl-C.")
        told = True
    return 0 if told else INTERRUPTED


def tell_page(request: RunRequest, told: str, console: Console) -> str:
    """Say where the page is, once it is there and when it has moved; return what was said."""
    if not request.web_host:
        return told
    try:
        addresses = (request.folder / WEB_ADDRESS_FILE).read_text().split()
    except FileNotFoundError:
        return told
    said = f"The page is at {where(addresses)}"
    if said != told and addresses:
        console.say(said)
        return said
    return told


def _greeting(request: RunRequest, environment: dict[str, str]) -> str:
    from rapl_ros.ros2_standin.path import shell_line

    verb = "resumes" if request.resume else "run"
    return "\n".join(
        [
            f"{request.config.task}: {verb} {request.folder}",
            f"ROS_DOMAIN_ID={environment['ROS_DOMAIN_ID']}. To look into it from another terminal:",
            f"  {shell_line()}",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
