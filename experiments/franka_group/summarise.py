"""The table and the picture of what ``learn.py`` found; the README's table is this one.

    python experiments/franka_group/summarise.py

Writes ``success.png`` and ``table.md`` beside the results, and the table into README.md.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from scipy import stats

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

HERE = Path(__file__).parent
RESULTS = HERE / "results"
README = HERE.parents[1] / "README.md"
MARKS = ("<!-- results:start -->", "<!-- results:end -->")
NAMES = {
    ("ground_truth", ""): "ground truth, the oracle",
    ("rapl", "tuned"): "RAPL tuned",
    ("rapl", "paper"): "RAPL paper",
    ("rapl", "authors_code"): "RAPL authors' code",
    ("rlhf", "tuned"): "RLHF tuned",
    ("imagenet", ""): "raw ImageNet features, OT",
}

Run = dict[str, Any]


def load(folder: Path = RESULTS) -> dict[str, list[Run]]:
    """Return the finished runs by name of the reward, in the order of NAMES."""
    found: dict[str, list[Run]] = defaultdict(list)
    for path in sorted(folder.glob("*-[0-9]*.json")):
        run = json.loads(path.read_text())
        found[_label(run)].append(run)
    order = [*NAMES.values()]
    return dict(
        sorted(found.items(), key=lambda one: order.index(one[0].split(" (")[0].rstrip(" *")))
    )


def _label(run: Run) -> str:
    """How a kind of run is called; with a star if its learner's critics were not normalised."""
    name, rounds = NAMES[run["reward"], run["preset"]], run.get("online", 0)
    if rounds:
        name += f" ({rounds} rounds while it learns)"
    elif run["preset"] == "tuned":
        name += " (aligned once)"
    return name if run["sac"].get("critic_layer_norm", False) else f"{name} *"


def mean_and_range(values: list[float], digits: int = 2) -> str:
    """Return the mean and, of several seeds, the lowest and highest."""
    text = f"{np.mean(values):.{digits}f}"
    if len(values) > 1:
        text += f" ({min(values):.{digits}f} to {max(values):.{digits}f})"
    return text


def table(runs: dict[str, list[Run]]) -> str:
    """Return the table in Markdown: success is the mean of the last three evaluations."""
    lines = [
        "| reward | success | seeds | world steps | step | concordance | episode |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, group in runs.items():
        success = mean_and_range([run["success_last_three"] for run in group])
        offline = [run.get("offline_last", run["offline"]) for run in group if "offline" in run]
        cells = [
            mean_and_range([o[key] for o in offline]) if offline else "-"
            for key in ("step", "concordance", "episode")
        ]
        steps = " and ".join(f"{s:,}" for s in sorted({run["steps"] for run in group}))
        lines.append(f"| {name} | {success} | {len(group)} | {steps} | {' | '.join(cells)} |")
    lines += [
        "",
        "One gradient step a world step, 4 worlds, 50 evaluation episodes; success is the mean of "
        "the last three evaluations; in brackets the lowest and the highest seed. Step, "
        "concordance and episode hold the reward against r* on 100 held-out videos of scripts "
        "(docs/paper_notes.md), after the last alignment where there were several.",
    ]
    lines += _beside(
        runs, "RAPL tuned (9 rounds while it learns)", "RLHF tuned (9 rounds while it learns)"
    )
    if any(name.endswith("*") for name in runs):
        lines += ["", "\\* Learnt before critics were normalised, which takes more steps."]
    return "\n".join(lines)


def _beside(runs: dict[str, list[Run]], one: str, other: str) -> list[str]:
    """By how much ``one`` is ahead of ``other`` on the seeds that both have: the mean, +- the half
    width of its 95 % interval (Student's t).
    """
    success = [
        {run["seed"]: run["success_last_three"] for run in runs.get(name, [])}
        for name in (one, other)
    ]
    seeds = sorted(set(success[0]) & set(success[1]))
    if len(seeds) < 2:
        return []
    ahead = np.array([success[0][seed] - success[1][seed] for seed in seeds])
    half = stats.t.ppf(0.975, len(ahead) - 1) * stats.sem(ahead)
    return [
        "",
        f"Seed by seed {one} is {ahead.mean():.2f} ± {half:.2f} ahead of {other} in success (95 % "
        f"interval, {len(seeds)} pairs).",
    ]


def picture(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw success by step: the mean of the seeds, each seed thin behind it."""
    figure, axis = plt.subplots(figsize=(8.4, 3.6))
    for color, (name, group) in zip(plt.cm.tab10.colors, runs.items(), strict=False):
        curves = []
        for run in group:
            steps = [point["steps"] / 1000 for point in run["curve"]]
            curves.append([point["success_rate"] for point in run["curve"]])
            axis.plot(steps, curves[-1], color=color, alpha=0.3, linewidth=0.9)
        length = min(map(len, curves))
        mean = np.mean([curve[:length] for curve in curves], axis=0)
        axis.plot(steps[:length], mean, color=color, linewidth=2, label=f"{name} ({len(group)})")
    axis.set_xlabel("thousand world steps")
    axis.set_ylabel("success, 50 episodes")
    axis.set_ylim(-0.02, 1.02)
    axis.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def put_into_readme(text: str, readme: Path = README) -> None:
    """Replace what stands between the marks."""
    before, rest = readme.read_text().split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    readme.write_text(f"{before}{MARKS[0]}\n{text}\n{MARKS[1]}{after}")


def main() -> None:
    """Write table and picture."""
    runs = load()
    text = table(runs)
    (RESULTS / "table.md").write_text(text + "\n")
    picture(runs, RESULTS / "success.png")
    if README.is_file() and MARKS[0] in README.read_text():
        put_into_readme(text)
    print(text)


if __name__ == "__main__":
    main()
