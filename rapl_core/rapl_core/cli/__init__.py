"""The command ``rapl``: looks at tasks and runs, and makes encoders, without a ROS graph."""

import argparse
import sys
from collections.abc import Sequence

from rapl_core.cli import encoders, rankings, report, tasks
from rapl_core.errors import RaplError, RefusedError, UnknownNameError

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: it did not work; what was asked for is not to be had, as for a faulty command line;
Ctrl-C."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="rapl", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for room in (tasks, report, rankings, encoders):
        room.add_to(commands)
    arguments = parser.parse_args(argv)
    try:
        arguments.work(arguments)
    except RaplError as error:
        print(f"rapl: {error}", file=sys.stderr)
        return REFUSED if isinstance(error, RefusedError | UnknownNameError) else FAILED
    except KeyboardInterrupt:
        print("\nrapl: stopped", file=sys.stderr)
        return INTERRUPTED
    return 0
