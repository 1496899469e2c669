"""``./run_all.sh TASK --quick`` for every task, one after another.

    python experiments/every_task.py                             # all tasks
    python experiments/every_task.py --tasks kuka_group          # these

Writes ``results/every_task.json``: for each task its command, exit status, seconds and stages. What
is there and ended as it should is not run again; ``--again`` forgets it.
"""

import argparse
from pathlib import Path

from quick_runs import QuickRun, add_options, run_all

from rapl_core.tasks import task_names


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tasks", nargs="+", default=task_names(), choices=task_names())
    results = Path(__file__).parent / "results" / "every_task.json"
    add_options(parser, Path("runs/every_task"), results)
    options = parser.parse_args()
    run_all(options.tasks, lambda name: QuickRun(name, name), options)


if __name__ == "__main__":
    main()
