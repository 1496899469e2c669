"""The command line ``ros2``."""

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from rapl_ros.ros2_standin import VERSION

VERBS = {
    "action": ("list",),
    "interface": ("show",),
    "node": ("list",),
    "param": ("describe", "get", "list", "set"),
    "service": ("call", "list"),
    "topic": ("echo", "hz", "info", "list"),
}
VERSION_TEXT = f"ros2 stand-in {VERSION} of RAPL, not ros2cli: " + "; ".join(
    f"{command} {'|'.join(verbs)}" for command, verbs in VERBS.items()
)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(2, f"{self.prog}: error: {message}\nThis is {VERSION_TEXT}\n")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = _Parser(prog="ros2", description=VERSION_TEXT)
    parser.add_argument("--version", action="version", version=VERSION_TEXT)
    commands = parser.add_subparsers(dest="command", metavar="command", required=True)
    for command, adders in _adders().items():
        text = ", ".join(VERBS[command])
        sub = commands.add_parser(command, help=f"{command} {text}")
        verbs = sub.add_subparsers(dest="verb", metavar="verb", required=True)
        for add in adders:
            add(verbs)
    return parser


def _adders() -> dict[str, list[Callable[[Any], None]]]:
    from rapl_ros.ros2_standin import interface, listing, param, service, topic

    return {
        "action": [lambda verbs: listing.add_list(verbs, "action")],
        "interface": [interface.add_show],
        "node": [listing.add_node_list],
        "param": [param.add_describe, param.add_get, param.add_list, param.add_set],
        "service": [service.add_call, lambda verbs: listing.add_list(verbs, "service")],
        "topic": [
            topic.add_echo, topic.add_hz, topic.add_info,
            lambda verbs: listing.add_list(verbs, "topic"),
        ],
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int | str | None:
    """Run a command; the result is the exit code, or the message of a failure (code 1)."""
    given = sys.argv[1:] if argv is None else list(argv)
    if given == ["--version"]:  # without the second that importing rclpy takes
        print(VERSION_TEXT)
        return 0
    arguments = build_parser().parse_args(given)
    from rclpy.executors import ExternalShutdownException

    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    try:
        arguments.run(arguments)
    except KeyboardInterrupt:
        return int(signal.SIGINT)
    except ExternalShutdownException:
        return int(signal.SIGTERM)
    except BrokenPipeError:  # ros2 topic echo ... | head
        sys.stderr.close()
        return 0
    except RuntimeError as error:
        return str(error)
    return 0


if __name__ == "__main__":
    sys.exit(main())
