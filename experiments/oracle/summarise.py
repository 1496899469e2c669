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
FRANKA_GROUP = HERE.parent / "franka_group" / "results"
"""Has runs of the same learner with r*, without an early end."""
PAPER = {
    "xmagical_avoid": 0.8, "xmagical_group": 0.6, "xmagical_group_mediumstick": 0.8,
    "franka_group": 0.7, "franka_clutter": 0.65,
}  # fmt: skip
"""Success that the paper names: of its oracle, with the medium stick of RAPL."""
COLUMNS = 3
PLAIN = "\\* Learnt before critics were normalised, which takes more steps.\n\n"

Run = dict[str, Any]


def load() -> dict[str, list[Run]]:
    """Return the finished runs of each task, by seed."""
    found: dict[str, list[Run]] = defaultdict(list)
    paths = sorted((HERE / "results").glob("*.json"))
    for path in [*paths, *sorted(FRANKA_GROUP.glob("ground_truth-*.json"))]:
        run = json.loads(path.read_text())
        found[run.get("task", "franka_group")].append(run)
    return dict(sorted(found.items()))


def table(runs: dict[str, list[Run]]) -> str:
    """Return the table in Markdown."""
    lines = [
        "| task | success, mean | by seed | steps | minutes | paper |",
        "|---|---|---|---|---|---|",
    ]
    for task, group in runs.items():
        success = [run["success_last_three"] for run in group]
        cells = [
            task,
            f"{np.mean(success):.2f}",
            ", ".join(f"{rate:.2f}" for rate in success) + ("" if _is_normalised(group) else " *"),
            ", ".join(f"{run['steps']:,}" for run in group),
            ", ".join(f"{run['wall_s'] / 60:.0f}" for run in group),
            f"{PAPER[task]:.2f}" if task in PAPER else "-",
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def _is_normalised(group: list[Run]) -> bool:
    return all(run["sac"].get("critic_layer_norm", False) for run in group)


def picture(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw success by step, a panel for each task and a line for each seed."""
    rows = -(-len(runs) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(8.4, 2.1 * rows), sharex=True, sharey=True, squeeze=False
    )
    for axis in axes.flat[len(runs) :]:
        axis.set_axis_off()
    for axis, (task, group) in zip(axes.flat, runs.items(), strict=False):
        for run in group:
            steps = [point["steps"] / 1000 for point in run["curve"]]
            success = [point["success_rate"] for point in run["curve"]]
            axis.plot(steps, success, linewidth=1, label=f"seed {run['seed']}")
        if task in PAPER:
            axis.axhline(PAPER[task], color="grey", linewidth=0.8, linestyle="--")
        axis.set_title(task, fontsize=9)
        axis.tick_params(labelbottom=True, labelsize=8)
        axis.set_ylim(-0.02, 1.02)
        axis.legend(frameon=False, fontsize=6, loc="lower right")
        axis.spines[["top", "right"]].set_visible(False)
    figure.supxlabel("thousand world steps", fontsize=9)
    figure.supylabel("success, 50 episodes", fontsize=9)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def page(runs: dict[str, list[Run]]) -> str:
    """Return docs/results/oracle.md."""
    return (
        "# What SAC reaches with the human's own reward\n\n"
        "Success is the mean of the last three evaluations of 50 episodes each; at most 200,000 "
        "world steps, stopped early at a plateau or at 97 %; franka_group 40,000 steps. Minutes "
        "are those of a machine that did other things as well. The paper's figures are its "
        "oracle's, but with the medium stick RAPL's.\n\n"
        f"{table(runs)}\n\n"
        f"{PLAIN if not all(map(_is_normalised, runs.values())) else ''}"
        "![Success by step of each task; dashed: the paper](oracle.png)\n\n"
        "`experiments/oracle/learn.py` makes a run, `experiments/oracle/summarise.py` this page; "
        "what was expected and what was chosen: [paper notes](../paper_notes.md).\n"
    )


def main() -> None:
    """Write table and picture."""
    runs = load()
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "oracle.md").write_text(page(runs))
    picture(runs, OUT / "oracle.png")
    print(table(runs))


if __name__ == "__main__":
    main()
