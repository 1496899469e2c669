"""The table and the curves of what ``learn.py`` found.

python experiments/oracle/summarise.py      # writes docs/results/oracle.md and oracle.png
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

HERE = Path(__file__).parent
OUT = HERE.parents[1] / "docs" / "results"
PAPER = {
    "xmagical_avoid": "80 %", "xmagical_group": "60 %", "xmagical_group_mediumstick": "80 % (RAPL)",
    "franka_clutter": "65 %",
}  # fmt: skip

Run = dict[str, Any]


def load(folder: Path = HERE / "results") -> dict[str, list[Run]]:
    """Return the finished runs of each task, by seed."""
    found: dict[str, list[Run]] = defaultdict(list)
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        found[run["task"]].append(run)
    return dict(found)


def table(runs: dict[str, list[Run]]) -> str:
    """Return the table in Markdown."""
    lines = [
        "| task | success, mean (lowest to highest seed) | seeds | steps | minutes | paper |",
        "|---|---|---|---|---|---|",
    ]
    for task, group in runs.items():
        success = [run["success_last_three"] for run in group]
        spread = f"{np.mean(success):.2f} ({min(success):.2f} to {max(success):.2f})"
        steps = ", ".join(f"{run['steps']:,}" for run in group)
        minutes = ", ".join(f"{run['wall_s'] / 60:.0f}" for run in group)
        cells = [task, spread, len(group), steps, minutes, PAPER.get(task, "-")]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def picture(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw success by step, one line a seed."""
    figure, axis = plt.subplots(figsize=(6.4, 3.6))
    for color, (task, group) in zip(plt.cm.tab20.colors, runs.items(), strict=False):
        for index, run in enumerate(group):
            steps = [point["steps"] / 1000 for point in run["curve"]]
            success = [point["success_rate"] for point in run["curve"]]
            axis.plot(steps, success, color=color, label=None if index else task)
    axis.set_xlabel("thousand world steps")
    axis.set_ylabel("success, 50 episodes")
    axis.set_ylim(-0.02, 1.02)
    axis.legend(frameon=False, fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Write table and picture."""
    runs = load()
    OUT.mkdir(parents=True, exist_ok=True)
    text = (
        "# What SAC reaches with the human's own reward\n\n"
        "Success is the mean of the last three evaluations of 50 episodes each; at most 200,000 "
        "world steps, stopped early at a plateau. `experiments/oracle/learn.py` made the runs, "
        "`experiments/oracle/summarise.py` this page.\n\n"
        f"{table(runs)}\n\n![Success by step](oracle.png)\n"
    )
    (OUT / "oracle.md").write_text(text)
    picture(runs, OUT / "oracle.png")
    print(text)


if __name__ == "__main__":
    main()
