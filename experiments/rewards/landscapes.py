"""The landscape of every reward side by side: small multiples of one seed."""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from summary import ORACLE, Result, Results, title

from rapl_core.analysis.scenes import ALONE, ARM, GAP, TOGETHER

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

STYLES = {
    TOGETHER[0]: ("tab:green", "-"),
    TOGETHER[1]: ("tab:green", "--"),
    ALONE[0]: ("tab:red", "-"),
    ALONE[1]: ("tab:red", "--"),
    "green fetched, red in the goal": ("tab:blue", "-"),
    GAP: ("tab:purple", "-"),
    ARM: ("black", "-"),
}
WIDTH = 24
"""Characters of a title's line."""


def picture(results: Results, path: Path) -> None:
    """Draw a panel for each reward of the first seed that has most of them.

    A panel's zero is the arm at rest and its unit the reward's range over all ways.
    """
    seeds = [seed for by_seed in results.values() for seed in by_seed]
    if not seeds:
        return
    seed = max(sorted(set(seeds)), key=seeds.count)
    shown = {row: by_seed[seed] for row, by_seed in results.items() if seed in by_seed}
    presets = sorted({preset for preset, _ in shown if preset})
    rewards = list(dict.fromkeys(reward for preset, reward in shown if preset))
    truth = shown.get(("", ORACLE))
    columns = len(rewards) + (truth is not None)
    rows = max(1, len(presets))
    figure, axes = plt.subplots(
        rows, columns, figsize=(1.75 * columns, 1.85 * rows + 0.9), squeeze=False, sharey=True
    )
    for line, row in zip(presets or [""], axes, strict=True):
        contents = [truth] if truth is not None else []
        contents += [shown.get((line, reward)) for reward in rewards]
        for axis, content in zip(row, contents, strict=True):
            _panel(axis, content)
        row[0].set_ylabel(line, fontsize=11)
    handles, labels = next(a for a in axes.flat if a.lines).get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False, fontsize=8)
    figure.suptitle(
        f"Reward along scenes placed by hand, seed {seed}: 0 at rest, in shares of its range",
        fontsize=10,
    )
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _panel(axis: plt.Axes, content: Result | None) -> None:
    axis.set_xticks([])
    axis.tick_params(labelsize=7)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    if content is None:
        axis.text(0.5, 0.5, "no result", ha="center", transform=axis.transAxes, fontsize=8)
        return
    for name, values in scaled(content["measures"]["landscape"]["ways"]).items():
        color, line = STYLES[name]
        axis.plot(np.linspace(0, 1, len(values)), values, line, color=color, label=name, lw=1.2)
    axis.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    axis.set_ylim(-1.05, 1.05)
    axis.set_title(_folded(title(content)), fontsize=7)


def scaled(ways: dict[str, list[float]]) -> dict[str, NDArray[np.float64]]:
    """The ways, 0 with the arm at rest, in shares of the range of all of them."""
    values = {name: np.array(way, dtype=np.float64) for name, way in ways.items()}
    unit = float(np.ptp(np.concatenate(list(values.values())))) or 1.0
    return {name: (way - values[ARM][0]) / unit for name, way in values.items()}


def _folded(text: str) -> str:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= WIDTH:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)
