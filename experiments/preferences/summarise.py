"""The tables and the picture of what ``sample_efficiency.py`` found.

    python experiments/preferences/summarise.py

Writes ``sample_efficiency.md`` and ``sample_efficiency.png`` beside the results. Means over seeds
with a 95 % interval; differences are paired by seed.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from scipy import stats

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

HERE = Path(__file__).parent
RESULTS = HERE / "results"
MEASURES = {
    "triplets": "held-out triplets in the right order (chance: .17)",
    "episode": "Spearman of the sums, per video",
    "step": "Spearman per step (the paper's)",
}
STRATEGIES = ("uniform", "uncertainty", "information", "coverage", "transport", "contest")
COLORS = dict(zip(STRATEGIES, plt.cm.tab10.colors, strict=False))

Unit = dict[str, Any]


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Mean and half the width of its 95 % interval; NaN with one value."""
    values = np.asarray(values)
    if len(values) < 2:
        return float(values.mean()), float("nan")
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean()), float(half)


def shown(values: Sequence[float], sign: bool = False) -> str:
    """Return ``.71 ± .03``; a dash for nothing."""
    if not len(values):
        return "-"
    mean, half = interval(values)
    text = f"{mean:+.2f}" if sign else f"{mean:.2f}"
    return text if np.isnan(half) else f"{text} ± {half:.2f}"


class Found:
    """Results to choose from."""

    def __init__(self, units: Sequence[Unit]) -> None:
        self.units = units

    def of(self, measure: str, **what: Any) -> dict[int, float]:
        """A measure by seed."""
        return {
            unit["seed"]: unit[measure]
            for unit in self.units
            if all(unit.get(key) == value for key, value in what.items())
        }

    def values(self, key: str, study: str) -> list[Any]:
        """What there is under a key, in the order found."""
        return list(dict.fromkeys(u[key] for u in self.units if u["study"] == study and key in u))


def paired(one: dict[int, float], other: dict[int, float]) -> list[float]:
    """Differences at the seeds that both have."""
    return [one[seed] - other[seed] for seed in sorted(one) if seed in other]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def strategies(found: Found) -> str:
    """Each strategy at each budget, and how it differs from uniform."""
    budgets = sorted(found.values("budget", "strategies"))
    parts = []
    for measure, title in MEASURES.items():
        rows = []
        for strategy in STRATEGIES:
            by = [found.of(measure, strategy=strategy, budget=b) for b in budgets]
            if not any(by):
                continue
            rows.append([strategy, *(shown(list(values.values())) for values in by)])
            if strategy != "uniform":
                base = [found.of(measure, strategy="uniform", budget=b) for b in budgets]
                gains = [paired(a, b) for a, b in zip(by, base, strict=True)]
                rows.append(["... minus uniform", *(shown(gain, sign=True) for gain in gains)])
        head = ["strategy", *(f"{b} answers" for b in budgets)]
        parts.append(f"**{title}**\n\n{table(head, rows)}")
    return "\n\n".join(parts)


def noise(found: Found) -> str:
    """Plain against robust, at each share of wrong answers."""
    rows = []
    for wrong in found.values("wrong", "noise"):
        for kind in ("plain", "smoothing", "estimated"):
            by = {m: found.of(m, study="noise", wrong=wrong, noise=kind) for m in MEASURES}
            base = found.of("triplets", study="noise", wrong=wrong, noise="plain")
            gain = shown(paired(by["triplets"], base), sign=True) if kind != "plain" else ""
            cells = [shown(list(values.values())) for values in by.values()]
            rows.append([wrong, kind, *cells, gain])
    head = ["wrong answers", "noise", "triplets", "per video", "per step", "triplets - plain"]
    return table(head, rows)


def rates(found: Found) -> str:
    """The shares of wrong comparisons: what they were and what was estimated."""
    rows = []
    for wrong in found.values("wrong", "noise"):
        units = [
            u for u in found.units if u.get("wrong") == wrong and u.get("noise") == "estimated"
        ]
        for name in sorted({name for unit in units for name in unit["estimate"]}):
            real = [unit["really_wrong"][name] for unit in units]
            guess = [unit["estimate"][name] for unit in units]
            rows.append([wrong, name, shown(real), shown(guess)])
    return table(["wrong answers", "annotator", "wrong comparisons", "estimated"], rows)


def groups(found: Found) -> str:
    """One representation for all, or one a group."""
    rows = []
    for learnt in found.values("learnt", "groups"):
        units = [u for u in found.units if u.get("learnt") == learnt]
        right = [
            sorted(map(sorted, u["groups"])) == [["ann", "ben"], ["cyd", "dot"]] for u in units
        ]
        cells = [
            shown([u[f"{wish}_{measure}"] for u in units])
            for wish in ("task", "opposite")
            for measure in ("triplets", "episode")
        ]
        split = f"{sum(right)} of {len(right)}" if learnt == "one a group" else ""
        rows.append([learnt, *cells, split])
    head = ["learnt", "task: triplets", "task: per video", "opposite: triplets",
            "opposite: per video", "groups found right"]  # fmt: skip
    return table(head, rows)


def page(found: Found) -> str:
    """Return everything in Markdown."""
    seeds = sorted({unit["seed"] for unit in found.units})
    commits = sorted({str(unit["commit"]) for unit in found.units})
    presets = sorted({unit["preset"] for unit in found.units})
    sections: list[tuple[str, str, Callable[[Found], str]]] = [
        ("strategies", "Who is asked what", strategies),
        ("noise", "Wrong answers", noise),
        ("noise", "Estimated shares of wrong comparisons", rates),
        ("groups", "Two people who want the task and two who want its opposite", groups),
    ]
    parts = [
        "# What rankings teach RAPL on franka_group",
        f"Preset {', '.join(presets)}; seeds {', '.join(map(str, seeds))}; pool of 300 videos, "
        "judged on 100 videos that nobody was asked about; mean with its 95 % interval over seeds, "
        f"differences paired by seed. Commit {', '.join(commits)}. Made by "
        "`sample_efficiency.py` and `summarise.py` in `experiments/preferences`.",
    ]
    for study, title, make in sections:
        units = [unit for unit in found.units if unit["study"] == study]
        if units:
            count = len({unit["seed"] for unit in units})
            parts.append(f"## {title} ({count} seeds)\n\n{make(Found(units))}")
    return "\n\n".join(parts) + "\n"


def picture(found: Found, path: Path) -> None:
    """Draw triplets and Spearman by answers, and triplets by wrong answers."""
    figure, axes = plt.subplots(1, 3, figsize=(11.5, 3.5))
    budgets = sorted(found.values("budget", "strategies"))
    for axis, measure in zip(axes, ("triplets", "episode"), strict=False):
        for place, strategy in enumerate(STRATEGIES):
            by = [list(found.of(measure, strategy=strategy, budget=b).values()) for b in budgets]
            if not all(by):
                continue
            means, halves = zip(*(interval(values) for values in by), strict=True)
            x = np.array(budgets) * (1 + 0.02 * (place - 2))
            axis.errorbar(
                x, means, np.nan_to_num(halves), color=COLORS[strategy], label=strategy,
                linewidth=2.2 if strategy == "uniform" else 1.3, elinewidth=0.8,
            )  # fmt: skip
        axis.set_xscale("log")
        axis.set_xticks(budgets, [str(b) for b in budgets])
        axis.minorticks_off()
        axis.set_xlabel("answers")
        axis.set_ylim(0, 1)
        axis.set_title(MEASURES[measure].replace(" (chance: .17)", ""), fontsize=9)
    wrongs = found.values("wrong", "noise")
    for place, kind in enumerate(("plain", "smoothing", "estimated")):
        by = [list(found.of("triplets", wrong=w, noise=kind).values()) for w in wrongs]
        if not by or not all(by):
            continue
        means, halves = zip(*(interval(values) for values in by), strict=True)
        x = np.arange(len(wrongs)) + 0.25 * (place - 1)
        axes[2].bar(x, means, 0.22, yerr=np.nan_to_num(halves), label=kind,
                    color=plt.cm.Set2.colors[place], error_kw={"elinewidth": 0.8})  # fmt: skip
    axes[2].set_xticks(range(len(wrongs)), wrongs)
    axes[2].set_xlabel("wrong answers of 150")
    axes[2].set_title("held-out triplets, plain against robust", fontsize=9)
    axes[2].set_ylim(0, 0.9)  # the legend stands above the bars
    for axis, place in zip(axes, ("upper left", "lower right", "upper right"), strict=True):
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
        axis.legend(frameon=False, fontsize=7, loc=place)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Write tables and picture."""
    found = Found(json.loads((RESULTS / "sample_efficiency.json").read_text())["units"])
    text = page(found)
    (RESULTS / "sample_efficiency.md").write_text(text)
    picture(found, RESULTS / "sample_efficiency.png")
    print(text)


if __name__ == "__main__":
    main()
