"""``./run_all.sh TASK ... --quick`` again and again, and a table of what came of it."""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rapl_core.analysis.provenance import commit, machine
from rapl_core.analysis.stages import read_stages

ROOT = Path(__file__).parents[1]
LIMIT_S = 3600.0


@dataclass(frozen=True)
class QuickRun:
    """One command line."""

    name: str
    """Of its row in the table."""
    task: str
    options: tuple[str, ...] = ()
    weights: str = ""
    """What the encoder's weights are, in words."""
    expected: int = 0
    """Exit status."""


def add_options(parser: argparse.ArgumentParser, out: Path, results: Path) -> None:
    """What every table of runs can be asked."""
    parser.add_argument("--out", type=Path, default=out, help="run folders (%(default)s)")
    parser.add_argument("--results", type=Path, default=results)
    parser.add_argument("--again", action="store_true", help="run them all again")
    parser.add_argument("--no-setup", action="store_true", help="by this very Python, no set-up")


def run_all(
    names: Sequence[str], of: Callable[[str], QuickRun], options: argparse.Namespace
) -> None:
    """Run what is missing, one after another, and keep the table of it after each.

    :param names: of the rows to run.
    :param of: gives a row's run.
    :param options: see :func:`add_options`.
    :raises SystemExit: naming the rows whose exit status is not what it should be.
    """
    out: Path = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-m", "rapl_ros.run_all"] if options.no_setup else ["./run_all.sh"]
    known: dict[str, Any] = {}
    if options.results.is_file():
        known = {row["row"]: row for row in json.loads(options.results.read_text())["rows"]}
    for name in names:
        if not options.again and name in known and as_expected(known[name]):
            continue
        found = run(of(name), out, program)
        print(found["row"], found["exit_status"], found["seconds"], found["last_line"], flush=True)
        known[name] = found
        content = {"machine": machine(), "rows": [known[n] for n in sorted(known)]}
        options.results.parent.mkdir(parents=True, exist_ok=True)
        options.results.write_text(json.dumps(content, indent=1) + "\n")
    bad = [name for name in names if not as_expected(known[name])]
    sys.exit(f"not as expected: {', '.join(bad)}" if bad else 0)


def as_expected(row: dict[str, Any]) -> bool:
    """Whether a row ended as it should."""
    return bool(row["exit_status"] == row["expected_status"])


def run(wanted: QuickRun, out: Path, program: Sequence[str]) -> dict[str, Any]:
    """Run a row and say what became of it."""
    folder = out / wanted.name.replace(" ", "-")
    command = [*program, wanted.task, *wanted.options, "--quick", "--out", str(folder)]
    began, begun_at = time.monotonic(), commit()  # what runs, whatever is committed meanwhile
    log = out / f"{folder.name}.log"
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, cwd=ROOT)
        try:
            status: int | None = process.wait(LIMIT_S)
        except BaseException as error:  # too late, or the user ends this: the run ends too
            process.terminate()
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            status = None
    results = folder / "results.json"
    found = json.loads(results.read_text()) if results.is_file() else {}
    lines = log.read_text().strip().splitlines()
    shown = [Path(o).name if os.sep in o else o for o in wanted.options]  # no machine's folders
    return {
        "row": wanted.name,
        "command": " ".join(["./run_all.sh", wanted.task, *shown, "--quick"]),
        **({"weights": wanted.weights} if wanted.weights else {}),
        "expected_status": wanted.expected,
        "exit_status": status,
        "last_line": "" if status == 0 or not lines else lines[-1],
        "seconds": round(time.monotonic() - began, 1),
        "stages": {s.name: [s.status, round(s.seconds, 1)] for s in read_stages(folder)},
        "encoder": found.get("encoder"),
        "episodes_evaluated": found.get("success", {}).get("final_episodes"),
        "commit": begun_at,
    }
